"""From files to machines: what would change, what is done, going back, and what happens when it is cut off."""

import json
import os
import shlex
from hashlib import sha256
from pathlib import Path

import pytest
from esslingen import GO2, program
from example_machines import EXAMPLES, write_example
from hypothesis import given
from hypothesis import strategies as st

from sfglab.deploy.bundle import MANIFEST, Bundle, Member, pack, unpack
from sfglab.deploy.errors import DeployError
from sfglab.deploy.rollout import (
    KEPT,
    Change,
    install,
    look,
    look_and_plan,
    plan_changes,
    released,
    releases,
)
from sfglab.deploy.transport import Local, Ssh, accelerator_of, is_here, transport_to
from sfglab.fleet.fleet_file import Accelerator, HostSpec

FOLDER = "/opt/sfglab/go2"
JETSONS = ("orin_nx", "xavier_nx")
paths = st.sampled_from(
    ["compose.yaml", "release.env", "hooks/a.sh", "Dockerfile", "image/x.whl", "b c.txt"]
)
trees = st.dictionaries(paths, st.binary(max_size=40), max_size=6)


def bundle_of(files: dict[str, bytes], tag: str = "1-a") -> Bundle:
    members = {path: Member(data=data, mode=0o644) for path, data in files.items()}
    entries = {path: {"sha256": sha256(m.data).hexdigest()} for path, m in members.items()}
    members[MANIFEST] = Member(data=json.dumps({"tag": tag, "files": entries}).encode(), mode=0o644)
    return Bundle(agent="go2", tag=tag, image=f"x/go2:{tag}", members=members)


def changes(plan) -> dict[str, Change]:
    return {file.path: file.change for file in plan.files if file.path != MANIFEST}


@given(trees, trees)
def test_a_plan_says_of_every_file_what_happens_to_it(before, after):
    found = changes(plan_changes(bundle_of(after, "2"), bundle_of(before, "1").members))
    kinds = {kind: {path for path, change in found.items() if change is kind} for kind in Change}
    same = {path for path in before.keys() & after.keys() if before[path] == after[path]}
    assert kinds[Change.NEW] == after.keys() - before.keys()
    assert kinds[Change.GONE] == before.keys() - after.keys()
    assert kinds[Change.SAME] == same
    assert kinds[Change.CHANGED] == (before.keys() & after.keys()) - same


def test_a_users_own_file_is_left_out_and_a_touched_one_has_a_remark():
    there = dict(bundle_of({"a": b"1"}).members) | {
        "hooks/custom.d/mine.sh": Member(data=b"x", mode=0o755)
    }
    there["a"] = Member(data=b"by hand\n", mode=0o644)
    plan = plan_changes(bundle_of({"a": b"2\n"}, "2"), there)
    (touched,) = [file for file in plan.files if file.path == "a"]
    assert touched.remark == "changed on the machine since"
    assert "-by hand\n+2\n" in touched.diff
    assert "hooks/custom.d/mine.sh" not in changes(plan)


@pytest.mark.parametrize("junk", [b"", b"{", b"[]", b'{"tag": 1}', b"\xff"])
def test_a_manifest_that_was_cut_off_counts_as_none(junk):
    plan = plan_changes(bundle_of({"a": b"1"}), {MANIFEST: Member(data=junk, mode=0o644)})
    assert plan.before == ""
    assert changes(plan) == {"a": Change.NEW}


@pytest.mark.parametrize(
    ("path", "restarts"),
    [("compose.yaml", True), ("release.env", True), ("router/x.yaml", True), ("hooks/x.sh", False)],
)
def test_only_what_containers_read_at_their_start_restarts_them(path, restarts):
    old, new = bundle_of({path: b"1"}), bundle_of({path: b"2"})
    assert plan_changes(new, old.members).restart is restarts


@given(trees)
def test_a_bundle_survives_its_archive_equal_ones_are_equal_bytes_and_change_nothing(tree):
    there = bundle_of(tree)
    assert plan_changes(there, there.members).nothing
    assert unpack(pack(there)) == there.members
    assert pack(there) == pack(bundle_of(tree))


def test_a_link_names_the_new_release_and_what_the_user_keeps_stays(tmp_path):
    machine = Local(folder=tmp_path)
    folder = tmp_path / FOLDER.lstrip("/")
    assert look(machine, FOLDER) == {}
    readme = {"hooks/custom.d/README": b"yours"}
    install(bundle_of({"a": b"1", "sub/b": b"2", **readme}, "1"), FOLDER, machine)
    own = {
        "hooks/custom.d/mine.sh": "mine",
        ".env": "SFGLAB_TAG=1\n",
        "workspace/build/made": "built",
    }
    for path, text in own.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text)
    (folder / "hooks/custom.d/gone.sh").symlink_to("nowhere")
    readme = {"hooks/custom.d/README": b"yours, in other words"}
    new = bundle_of({"a": b"changed", **readme}, "2")
    install(new, FOLDER, machine)
    assert (folder / "current").readlink() == Path(".releases/2")
    assert {path: (folder / path).read_text() for path in own} == own
    current = folder / "current"
    assert (current / "hooks/custom.d/mine.sh").read_text() == "mine"
    assert (current / ".env").read_text() == "SFGLAB_TAG=1\n"
    there = look(machine, FOLDER)
    assert {path: there[path].data for path in ("a", *readme)} == {"a": b"changed", **readme}
    assert "sub/b" not in there
    assert look_and_plan(machine, FOLDER, new).nothing
    assert set(released(machine, GO2, "1").members) == {"a", "sub/b", *readme, MANIFEST}


def test_a_machine_keeps_its_latest_releases_and_no_more(tmp_path):
    machine = Local(folder=tmp_path)
    for number in range(KEPT + 3):
        install(bundle_of({"a": b"%d" % number}, f"{number}"), FOLDER, machine)
        os.utime(tmp_path / f"opt/sfglab/go2/.releases/{number}", (number, number))
    assert releases(machine, FOLDER) == tuple(str(n) for n in range(KEPT + 2, 2, -1))


def test_an_installation_that_was_cut_off_changes_nothing_and_the_next_one_completes_it(tmp_path):
    machine = Local(folder=tmp_path)
    old, new = bundle_of({"a": b"1"}, "1"), bundle_of({"a": b"2"}, "2")
    install(old, FOLDER, machine)
    cut = Bundle(agent="go2", tag="2", image="", members={"/": Member(data=b"", mode=0)})
    with pytest.raises(DeployError, match="status"):
        install(cut, FOLDER, machine)
    assert look_and_plan(machine, FOLDER, old).nothing
    assert releases(machine, FOLDER) == ("1",)
    install(new, FOLDER, machine)
    assert look_and_plan(machine, FOLDER, new).nothing


def test_a_release_that_was_changed_on_its_machine_is_not_rolled_back_to(tmp_path):
    machine = Local(folder=tmp_path)
    install(bundle_of({"a": b"1"}, "1"), FOLDER, machine)
    assert released(machine, GO2, "1").members["a"].data == b"1"
    place = tmp_path / "opt/sfglab/go2/.releases/1"
    (place / "a").write_bytes(b"by hand")
    with pytest.raises(DeployError, match="a is missing or was changed there"):
        released(machine, GO2, "1")
    (place / MANIFEST).unlink()
    with pytest.raises(DeployError, match="it has no manifest"):
        released(machine, GO2, "1")


@pytest.fixture
def ssh(tmp_path):
    """A program in ssh's place that runs the remote command here, as sshd would by the user's shell."""
    command = f'shift; done\nshift 2\nPATH={tmp_path}:$PATH exec sh -c "$*"'
    noted = f'printf "%s\\n" "$@" > {tmp_path}/arguments'
    client = program(tmp_path / "ssh", f'{noted}\nwhile [ "$1" != -- ]; do {command}')
    program(tmp_path / "sudo", '[ "$1" = -n ] || exit 9\nshift\nexec "$@"')
    return Ssh(address="sfg@go2.local", program=str(client))


@pytest.mark.parametrize(
    "text", ["plain", "two words", "quote ' and \" and $HOME and \\", "new\nline"]
)
def test_over_ssh_scripts_and_data_arrive_as_they_are(ssh, tmp_path, text):
    assert (
        ssh.run(f"printf %s {shlex.quote(text)}; cat", data=b"\x00data")
        == text.encode() + b"\x00data"
    )
    arguments = (tmp_path / "arguments").read_text().splitlines()
    assert arguments[:6] == [
        "-o",
        "BatchMode=yes",
        "-o",
        "ConnectTimeout=10",
        "--",
        "sfg@go2.local",
    ]


def test_a_script_that_fails_is_one_sentence_and_a_long_one_is_heard_while_it_works(ssh):
    with pytest.raises(DeployError, match=r"^sfg@go2.local: .*ended with status 3: second$"):
        ssh.run("echo first >&2; echo second >&2; exit 3")
    with pytest.raises(DeployError, match="ended with status 1"):
        ssh.run("false; echo never reached")
    heard = []
    ssh.stream("echo one; echo two >&2", heard.append)
    assert heard == ["one", "two"]
    with pytest.raises(
        DeployError, match=r"sfg@go2.local: ended with status 4; its last words:\nthree"
    ):
        ssh.stream("echo three; exit 4", heard.append)


def test_a_program_that_is_missing_and_a_machine_that_is_silent_are_errors_of_ours():
    with pytest.raises(DeployError, match="not installed"):
        Ssh(address="x", program="no-such-ssh").run("true")
    with pytest.raises(DeployError, match="no answer within 0 s"):
        Local().run("sleep 10", timeout_s=0.2)


def test_a_jetson_of_another_jetpack_than_the_images_is_refused(tmp_path):
    new, old = (
        Local(folder=write_example(EXAMPLES[f"jetson_{name}"], tmp_path / name)) for name in JETSONS
    )
    assert accelerator_of(new) is Accelerator.JETSON
    with pytest.raises(DeployError, match="given JetPack 4, allowed: 6"):
        accelerator_of(old)


def test_the_way_to_a_machine_follows_from_its_address(tmp_path):
    assert transport_to(HostSpec()) == Local()
    assert transport_to(HostSpec(address="deck@elsewhere.example")) == Ssh(
        address="deck@elsewhere.example"
    )
    assert transport_to(HostSpec(address="deck@elsewhere.example"), root=tmp_path) == Local(
        folder=tmp_path
    )
    assert is_here(f"me@{os.uname().nodename}")
    assert Path("/") == Local().folder


@pytest.mark.parametrize("path", ["../b", "/b", "a/../../b"])
def test_an_archive_that_leads_out_of_its_folder_is_refused(path):
    archive = pack(
        Bundle(agent="a", tag="t", image="i", members={path: Member(data=b"x", mode=0o644)})
    )
    with pytest.raises(DeployError, match="allowed: no more than the archive holds"):
        unpack(archive)
