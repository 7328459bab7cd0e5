"""From files to machines: planned changes, installation, rollback, and what an interruption leaves."""

import json
import os
import shlex
from hashlib import sha256
from pathlib import Path

import pytest
from esslingen import GO2, program
from example_machines import write_example

from sfglab.deploy.bundle import MANIFEST, Bundle, pack, unpack
from sfglab.deploy.errors import DeployError
from sfglab.deploy.files import BundleFile
from sfglab.deploy.rollout import (
    KEPT,
    Change,
    Prospect,
    install,
    look,
    plan_changes,
    released,
    releases,
    render_prospects,
)
from sfglab.deploy.transport import Transport, accelerator_of, is_here
from sfglab.fleet.fleet_file import Accelerator

FOLDER = "/opt/sfglab/go2"


def bundle_of(files, tag="1-a"):
    entries = {path: {"sha256": sha256(data).hexdigest()} for path, data in files.items()}
    manifest = json.dumps({"tag": tag, "files": entries}).encode()
    members = {path: BundleFile(data=data) for path, data in (files | {MANIFEST: manifest}).items()}
    return Bundle(agent="go2", tag=tag, image=f"x/go2:{tag}", members=members)


def changes(plan):
    return {file.path: file.change for file in plan.files if file.path != MANIFEST}


def test_a_plan_has_each_file_but_the_users_own_its_change_and_a_remark_on_a_touched_one():
    there = dict(bundle_of({"gone": b"1", "same": b"1", "changed": b"1"}).members)
    there |= {"changed": BundleFile(data=b"by hand\n"), "mine.sh": BundleFile(data=b"x")}
    plan = plan_changes(bundle_of({"new": b"1", "same": b"1", "changed": b"2"}, "2"), there)
    assert changes(plan) == {change.value: change for change in Change}
    assert [file.path for file in plan.files if file.touched] == ["changed"]


@pytest.mark.parametrize("junk", [b"", b"{", b"[]", b'{"tag": 1}', b"\xff"])
def test_a_manifest_that_was_cut_off_counts_as_none(junk):
    plan = plan_changes(bundle_of({"a": b"1"}), {MANIFEST: BundleFile(data=junk)})
    assert plan.before == ""
    assert changes(plan) == {"a": Change.NEW}
    said = render_prospects([Prospect(agent="go2", machine="m", plan=plan)])
    assert ["changed", MANIFEST] in [line.split() for line in said.splitlines()]


def test_a_bundle_survives_its_archive_equal_ones_are_equal_bytes_and_change_nothing():
    files = {"hooks/a.sh": b"#!/bin/sh\n", "image/x.whl": bytes(range(256)), "b c.txt": b""}
    there = bundle_of(files)
    assert not plan_changes(there, there.members).changed
    assert unpack(pack(there)) == there.members
    assert pack(there) == pack(bundle_of(files))


@pytest.mark.parametrize("path", ["../b", "/b", ".//b", "a/../../b"])
def test_an_archive_that_leads_out_of_its_folder_is_refused(path):
    archive = pack(Bundle(agent="a", tag="t", image="i", members={path: BundleFile(data=b"x")}))
    with pytest.raises(DeployError, match="larger than the archive or outside its folder"):
        unpack(archive)


@pytest.fixture
def machine(tmp_path):
    return Transport(folder=tmp_path)


@pytest.fixture
def folder(tmp_path):
    return tmp_path / FOLDER.lstrip("/")


def test_a_link_names_the_new_release_and_what_the_user_keeps_stays(machine, folder):
    assert look(machine, FOLDER) == {}
    readme = {"hooks/custom.d/README": b"yours"}
    install(bundle_of({"a": b"1", "sub/b": b"2", **readme}, "1"), FOLDER, machine)
    own = {"hooks/custom.d/mine.sh": "mine", ".env": "SFGLAB_TAG=1\n"}
    for path, text in own.items():
        (folder / path).write_text(text)
    (folder / "hooks/custom.d/gone.sh").symlink_to("nowhere")
    files = {"a": b"changed", "hooks/custom.d/README": b"yours, in other words"}
    new = bundle_of(files, "2")
    install(new, FOLDER, machine)
    assert (folder / "current").readlink() == Path(".releases/2")
    for path, text in own.items():
        assert (folder / path).read_text() == (folder / "current" / path).read_text() == text
    there = look(machine, FOLDER)
    assert {path: file.data for path, file in there.items() if path != MANIFEST} == files
    assert not plan_changes(new, there).changed
    assert set(released(machine, GO2, "1").members) == {"a", "sub/b", *readme, MANIFEST}


def test_a_machine_keeps_its_latest_releases_and_no_more(machine, folder):
    for number in range(KEPT + 3):
        install(bundle_of({"a": b"%d" % number}, f"{number}"), FOLDER, machine)
        os.utime(folder / f".releases/{number}", (number, number))
    assert releases(machine, FOLDER) == tuple(str(n) for n in range(KEPT + 2, 2, -1))


def test_an_installation_that_was_cut_off_changes_nothing_and_the_next_one_completes_it(machine):
    old, new = bundle_of({"a": b"1"}, "1"), bundle_of({"a": b"2"}, "2")
    install(old, FOLDER, machine)
    cut = Bundle(agent="go2", tag="2", image="", members={"/": BundleFile(data=b"", mode=0)})
    with pytest.raises(DeployError, match="status"):
        install(cut, FOLDER, machine)
    assert not plan_changes(old, look(machine, FOLDER)).changed
    assert releases(machine, FOLDER) == ("1",)
    install(new, FOLDER, machine)
    assert not plan_changes(new, look(machine, FOLDER)).changed


def test_a_release_that_was_changed_on_its_machine_is_not_rolled_back_to(machine, folder):
    install(bundle_of({"a": b"1"}, "1"), FOLDER, machine)
    place = folder / ".releases/1"
    (place / "a").write_bytes(b"by hand")
    with pytest.raises(DeployError, match="a is missing or was changed there"):
        released(machine, GO2, "1")
    (place / MANIFEST).unlink()
    with pytest.raises(DeployError, match="has no manifest"):
        released(machine, GO2, "1")


@pytest.fixture
def ssh(tmp_path):
    """A program in ssh's place that runs the remote command here, as sshd would by the user's shell."""
    command = f'shift; done\nshift 2\nPATH={tmp_path}:$PATH exec sh -c "$*"'
    noted = f'printf "%s\\n" "$@" > {tmp_path}/arguments'
    client = program(tmp_path / "ssh", f'{noted}\nwhile [ "$1" != -- ]; do {command}')
    program(tmp_path / "sudo", '[ "$1" = -n ] || exit 9\nshift\nexec "$@"')
    return Transport(address="sfg@go2.local", client=str(client))


def test_over_ssh_scripts_and_data_arrive_as_they_are(ssh, tmp_path):
    text = "two words, quote ' and \" and $HOME and \\, new\nline"
    said = ssh.run(f"printf %s {shlex.quote(text)}; cat", data=b"\x00data")
    assert said == text.encode() + b"\x00data"
    options = ["-o", "BatchMode=yes", "-o", "ConnectTimeout=10", "--", "sfg@go2.local"]
    assert (tmp_path / "arguments").read_text().splitlines()[:6] == options


def test_a_script_that_fails_is_one_sentence_and_a_long_one_prints_while_it_runs(ssh):
    with pytest.raises(DeployError, match=r"^sfg@go2.local: .*ended with status 3 \(second\)"):
        ssh.run("echo first >&2; echo second >&2; exit 3")
    with pytest.raises(DeployError, match="ended with status 1"):
        ssh.run("false; echo never reached")
    with pytest.raises(DeployError, match="no answer within 0 s"):
        ssh.run("sleep 10", timeout_s=0.2)
    lines = []
    ends = r"sfg@go2.local: ended with status 4; its last lines:\none\ntwo"
    with pytest.raises(DeployError, match=ends):
        ssh.stream("echo one; echo two >&2; exit 4", lines.append)
    assert lines == ["one", "two"]


def test_a_machine_is_detected_over_ssh_and_another_jetpack_than_the_images_is_refused(
    tmp_path, ssh
):
    assert isinstance(accelerator_of(ssh), Accelerator)
    new, old = (
        Transport(folder=write_example(f"jetson_{name}", tmp_path / name))
        for name in ("orin_nx", "xavier_nx")
    )
    assert accelerator_of(new) is Accelerator.JETSON
    with pytest.raises(DeployError, match="given JetPack 4, allowed: 6"):
        accelerator_of(old)


def test_this_machine_under_its_own_name_is_no_other_machine():
    assert is_here(f"me@{os.uname().nodename}")
