"""The hooks, run for real: on another root, and on this system with its folders and commands exchanged."""

import contextlib
import functools
import os
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from esslingen import deployed, program, write_files

from sfglab.deploy.host import host_files

UNIT = "etc/systemd/system/sfglab-go2.service"
WANTED = "etc/systemd/system/multi-user.target.wants/sfglab-go2.service"
CHRONY = "etc/chrony/conf.d/sfglab.conf"
RULES = "etc/sfglab/go2.nft"
NUMBERS = "opt/sfglab/go2/.env"
GROUPS = "root:x:0:\nvideo:x:44:\nrender:x:993:\n"


@functools.cache
def files_of(agent, *, servers=True, firewall=True):
    deployment = deployed(agent) if servers else deployed(agent, time_servers=())
    if not firewall:
        network = replace(deployment.network, global_interface=None, bridge="")
        deployment = replace(deployment, network=network)
    return host_files(deployment)


def machine(root, agent="go2", **options):
    """Make a root with chrony, nft and an agent's folder; return its initialize.sh."""
    write_files(files_of(agent, **options), root / "opt/sfglab" / agent)
    for name in ("chronyd", "nft"):
        program(root / "usr/sbin" / name)
    (root / "etc/chrony/conf.d").mkdir(parents=True, exist_ok=True)
    (root / "etc/group").write_text(GROUPS, encoding="utf-8")
    (root / "opt/sfglab" / agent / "release.env").write_text("SFGLAB_TAG=1-a\n", encoding="utf-8")
    return root / "opt/sfglab" / agent / "hooks/initialize.sh"


def run(script, *options, root=None, path=None, status=0):
    """Run the hooks; return what they say."""
    environment = {
        "PATH": f"{path}:{os.environ['PATH']}" if path else os.environ["PATH"],
        "LC_ALL": "C",
    }
    if root is not None:
        environment["SFGLAB_ROOT"] = str(root)
    return said_by(["bash", str(script), *options], environment, status)


def said_by(command, environment, status):
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout + done.stderr


def words(said):
    return {line.split(":")[0] for line in said.splitlines()}


def tree(root, *, times=True):
    """Everything below a folder: kinds, modes, texts or targets, and when they were last written."""
    found = {}
    for path in sorted(root.rglob("*")):
        state = path.lstat()
        content = (
            str(path.readlink())
            if path.is_symlink()
            else path.read_bytes()
            if path.is_file()
            else None
        )
        found[str(path.relative_to(root))] = (
            state.st_mode,
            content,
            state.st_mtime_ns if times else 0,
        )
    return found


def test_another_root_gets_what_a_dry_run_shows_undo_takes_it_back_and_nothing_that_runs_is_touched(
    tmp_path,
):
    script = machine(tmp_path)
    before = tree(tmp_path)
    said = run(script, "--dry-run", root=tmp_path)
    assert tree(tmp_path) == before
    for path in (CHRONY, RULES, UNIT, NUMBERS):
        assert f"would change: /{path}\n--- /{path}\n+++ /{path}\n" in said
    assert "+server workstation.local iburst prefer" in said
    assert not re.search("^changed", said, re.MULTILINE)
    given = {name for name, (_, text, _) in before.items() if text is not None}
    said = run(script, root=tmp_path)
    assert (
        (tmp_path / CHRONY)
        .read_text(encoding="utf-8")
        .endswith("server workstation.local iburst prefer\n")
    )
    assert "table inet sfglab_go2 {" in (tmp_path / RULES).read_text(encoding="utf-8")
    folder = script.parents[1]
    assert (tmp_path / UNIT).read_text() == (folder / "systemd/sfglab-go2.service").read_text()
    assert str((tmp_path / WANTED).readlink()) == f"/{UNIT}"
    numbers = (tmp_path / NUMBERS).read_text(encoding="utf-8").splitlines()[1:]
    assert numbers == ["SFGLAB_TAG=1-a", "SFGLAB_VIDEO_GID=44", "SFGLAB_RENDER_GID=993"]
    for what in ("restart of chrony", "table inet sfglab_go2", "reload of systemd"):
        assert f"skipped: {what} (SFGLAB_ROOT is not the running system)" in said
    assert words(said) == {"changed", "skipped"}
    before = tree(tmp_path)
    assert words(run(script, root=tmp_path)) == {"unchanged", "skipped"}
    assert tree(tmp_path) == before, "a second run changes nothing, not even a time"
    run(script, "--undo", "--dry-run", root=tmp_path)
    assert tree(tmp_path) == before
    (tmp_path / CHRONY).write_text("server old\n", encoding="utf-8")
    assert "-server old\n" in run(script, "--dry-run", root=tmp_path)
    run(script, "--undo", root=tmp_path)
    assert {name for name, (_, text, _) in tree(tmp_path).items() if text is not None} == given
    assert words(run(script, "--undo", root=tmp_path)) == {"unchanged", "skipped"}


@pytest.mark.parametrize(("number", "step"), [(1, "before"), (4, "after"), (5, "before")])
def test_a_run_that_was_killed_is_made_good_by_the_next(number, step, tmp_path):
    whole, cut, tools = tmp_path / "whole", tmp_path / "cut", tmp_path / "tools"
    run(machine(whole), root=whole)
    script = machine(cut)
    real = shutil.which("mv")
    moves = f'{real} "$@"' if step == "after" else ":"
    count = f'n=$(($(cat {tools}/n) + 1)); echo "$n" >{tools}/n'
    program(
        tools / "mv", f'{count}; [ "$n" = {number} ] || exec {real} "$@"; {moves}; kill -KILL $PPID'
    )
    (tools / "n").write_text("0", encoding="utf-8")
    run(script, root=cut, path=tools, status=137)
    assert tree(cut, times=False) != tree(whole, times=False)
    run(script, root=cut)
    assert tree(cut, times=False) == tree(whole, times=False)


def test_scripts_of_the_user_run_last_in_order_with_our_helpers_and_are_left_out_of_a_dry_run(
    tmp_path,
):
    script = machine(tmp_path)
    custom = script.parent / "custom.d"
    mine = '. "$SFGLAB_HOOKS/lib.sh"\nput_file /etc/mine.conf 600 "of $SFGLAB_AGENT"'
    (custom / "50-b.sh").write_text(mine, encoding="utf-8")
    (custom / "10-a.sh").write_text('echo "first in $SFGLAB_ROOT"', encoding="utf-8")
    (custom / "note.txt").write_text("exit 1", encoding="utf-8")
    before = tree(tmp_path)
    said = run(script, "--dry-run", root=tmp_path)
    assert said.endswith("skipped: custom.d/50-b.sh (scripts of yours are not run by --dry-run)\n")
    assert tree(tmp_path) == before
    said = run(script, root=tmp_path)
    ours, _, theirs = said.partition(f"first in {tmp_path}\n")
    assert "reload of systemd" in ours
    assert theirs == "ran: custom.d/10-a.sh\nchanged: /etc/mine.conf\nran: custom.d/50-b.sh\n"
    assert (tmp_path / "etc/mine.conf").read_text(encoding="utf-8") == "of go2\n"
    assert (tmp_path / "etc/mine.conf").stat().st_mode & 0o777 == 0o600
    (custom / "60-c.sh").write_text("exit 7", encoding="utf-8")
    assert run(script, root=tmp_path, status=1).endswith(
        "sfglab: custom.d/60-c.sh: has failed with status 7\n"
    )


def test_without_root_the_machine_is_refused_in_one_sentence(tmp_path):
    script = machine(tmp_path)
    program(tmp_path / "tools/id", "echo 1000")
    said = run(script, path=tmp_path / "tools", status=1)
    allowed = "run it with sudo, or set SFGLAB_ROOT to another root"
    assert said == f"sfglab: the machine can be changed by root only: {allowed}\n"


@pytest.mark.parametrize(
    ("options", "root", "status", "says"),
    [
        ((), "relative", 1, "sfglab: SFGLAB_ROOT: given 'relative'.*the absolute path.*\n"),
        ((), "/no/such", 1, "sfglab: SFGLAB_ROOT: given '/no/such'.*is no folder.*\n"),
        (("--dry",), "", 2, "sfglab: given '--dry', allowed: --dry-run, --undo, --development\n"),
    ],
)
def test_another_root_or_an_option_that_is_none_is_refused(options, root, status, says, tmp_path):
    assert re.fullmatch(
        says, run(machine(tmp_path), *options, root=root or tmp_path, status=status)
    )


def test_a_link_that_leads_out_of_the_other_root_is_not_followed(tmp_path):
    root, outside = tmp_path / "root", tmp_path / "outside"
    outside.mkdir()
    script = machine(root)
    (root / "etc/sfglab").symlink_to(outside)
    assert "leads out of SFGLAB_ROOT" in run(script, root=root, status=1)
    assert list(outside.iterdir()) == []


def test_what_stands_in_the_way_of_a_file_and_a_release_that_is_missing_end_the_run_by_name(
    tmp_path,
):
    script = machine(tmp_path)
    (tmp_path / RULES).mkdir(parents=True)
    said = run(script, root=tmp_path, status=1)
    assert said.endswith(f"sfglab: /{RULES}: is a folder, where a file belongs\n")
    (tmp_path / RULES).rmdir()
    (script.parents[1] / "release.env").unlink()
    says = "sfglab: release.env: missing, so that no release could start"
    assert says in run(script, root=tmp_path, status=1)


def test_a_developer_without_root_gets_what_the_containers_need_and_is_told_of_the_rest(tmp_path):
    script = machine(tmp_path)
    program(tmp_path / "tools/id", "echo 1000")
    before = tree(tmp_path, times=False)
    said = run(script, "--development", path=tmp_path / "tools")
    assert "skipped: time, firewall and service (they need root" in said
    file = script.parents[1] / ".env"
    assert file.read_text().splitlines()[1] == "SFGLAB_TAG=1-a"
    file.unlink()
    assert tree(tmp_path, times=False) == before


def test_timesyncd_is_asked_where_there_is_no_chrony_and_cannot_serve(tmp_path):
    client, server = tmp_path / "go2", tmp_path / "workstation"
    for root in (client, server):
        script = machine(root, agent=root.name)
        (root / "usr/sbin/chronyd").unlink()
        program(root / "usr/lib/systemd/systemd-timesyncd")
        said = run(script, root=root)
        drop_in = root / "etc/systemd/timesyncd.conf.d/sfglab.conf"
        serves = "skipped: serving time (systemd-timesyncd cannot: install chrony)" in said
        assert serves is (root is server)
        assert drop_in.exists() is (root is client)
    text = (client / "etc/systemd/timesyncd.conf.d/sfglab.conf").read_text(encoding="utf-8")
    assert text.endswith("[Time]\nNTP=\nNTP=workstation.local\n")


def test_what_a_machine_or_fleet_does_not_have_is_said_and_no_error(tmp_path):
    script = machine(tmp_path, servers=False)
    (tmp_path / "usr/sbin/nft").unlink()
    (tmp_path / "etc/group").write_text("root:x:0:\nvideo:x:44:\n", encoding="utf-8")
    (tmp_path / UNIT).parent.mkdir(parents=True)
    (tmp_path / UNIT).symlink_to("/dev/null")
    said = run(script, root=tmp_path)
    assert "skipped: time servers (the fleet file names none)" in said
    assert "skipped: loading the firewall (nft is not installed: install nftables)" in said
    assert (
        "skipped: group render (this machine has none: 10001, the containers' own, stands for it)"
        in said
    )
    assert f"skipped: /{UNIT} (it is masked: systemctl unmask sfglab-go2.service)" in said
    assert (tmp_path / NUMBERS).read_text(encoding="utf-8").endswith("SFGLAB_RENDER_GID=10001\n")
    assert str((tmp_path / UNIT).readlink()) == "/dev/null"


def test_what_an_earlier_release_set_and_this_one_does_not_is_taken_back(tmp_path):
    bare = tmp_path / "bare"
    said = run(machine(bare, servers=False, firewall=False), root=bare)
    assert "skipped: firewall of the domain (the fleet file names no global interface)" in said
    assert "skipped: firewall (there is nothing to close)" in said
    root = tmp_path / "root"
    run(machine(root), root=root)
    script = machine(root, servers=False, firewall=False)
    (script.parent / "firewall.nft").unlink()
    said = run(script, root=root)
    assert f"changed: /{CHRONY} (removed)" in said
    assert f"changed: /{RULES} (removed)" in said
    (root / "etc/sfglab").rmdir()
    assert tree(root, times=False) == tree(bare, times=False)


def test_chrony_without_a_folder_for_settings_ends_the_run_and_says_which_it_needs(tmp_path):
    script = machine(tmp_path)
    (tmp_path / "etc/chrony/conf.d").rmdir()
    assert "has neither /etc/chrony/conf.d nor /etc/chrony.d" in run(
        script, root=tmp_path, status=1
    )
    (tmp_path / "etc/chrony.d").mkdir()
    run(script, root=tmp_path)
    assert (tmp_path / "etc/chrony.d/sfglab.conf").exists()


# On this system, with folders and commands exchanged

EXCHANGED = ("etc", "run", "opt", "var/lib")
OWN_MOUNTS = (
    ["unshare", "--mount"] if os.geteuid() == 0 else ["unshare", "--mount", "--map-root-user"]
)


def can_mount() -> bool:
    if not shutil.which("unshare"):
        return False
    command = [*OWN_MOUNTS, "mount", "-t", "tmpfs", "none", "/mnt"]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


needs_mounts = pytest.mark.skipif(
    not can_mount(), reason="needs mounts of its own: root, or user namespaces"
)


class System:
    """This system with other folders, and commands that write down how they were called."""

    def __init__(self, root, agent="go2"):
        self.root, self.tools, self.agent = root / "root", root / "tools", agent
        machine(self.root, agent)
        for name in ("var/lib", "run/systemd/system"):
            (self.root / name).mkdir(parents=True)
        # Commands that are chosen there, such as awk, are asked for through it.
        (self.root / "etc/alternatives").mkdir()
        for name in ("awk", "nawk"):
            with contextlib.suppress(FileNotFoundError):
                (self.root / "etc/alternatives" / name).symlink_to(
                    Path("/etc/alternatives", name).readlink()
                )
        log = f'echo "${{0##*/}} $*" >>{self.tools}/calls'
        program(self.tools / "systemctl", log)
        program(self.tools / "chronyd")
        loaded = f"{self.tools}/loaded"
        listed = f"[ $1 != list ] || exec test -e {loaded}"
        program(self.tools / "nft", f"{listed}; {log}\n[ $1 != -f ] || touch {loaded}")
        program(self.tools / "ip", '[ "$1" = -6 ] || echo "10.7.0.0/16 scope link src 10.7.0.4"')

    def run(self, *options, script="initialize.sh", status=0):
        """Run a hook there; return what it says and the commands that it ran."""
        (self.tools / "calls").write_text("", encoding="utf-8")
        mounts = " && ".join(f"mount --bind {self.root}/{name} /{name}" for name in EXCHANGED)
        hook = f"/opt/sfglab/{self.agent}/hooks/{script}"
        environment = {"PATH": f"{self.tools}:{os.environ['PATH']}", "LC_ALL": "C"}
        command = [*OWN_MOUNTS, "bash", "-c", f'{mounts} && exec bash {hook} "$@"', "-", *options]
        said = said_by(command, environment, status)
        return said, (self.tools / "calls").read_text(encoding="utf-8").splitlines()


APPLIED = [
    "systemctl enable --quiet chronyd.service",
    "systemctl restart chronyd.service",
    "nft -f /etc/sfglab/go2.nft",
    "systemctl daemon-reload",
]


@needs_mounts
def test_the_running_system_is_told_once_and_of_an_undo(tmp_path):
    system = System(tmp_path)
    said, calls = system.run("--dry-run")
    assert calls == []
    assert "would change: restart of chrony\n" in said
    assert not (system.root / UNIT).exists()
    said, calls = system.run()
    assert words(said) == {"changed"}
    assert calls == APPLIED
    before = tree(system.root)
    said, calls = system.run()
    assert (words(said), calls) == ({"unchanged"}, [])
    assert tree(system.root) == before
    _, calls = system.run("--undo")
    assert calls == [
        "systemctl stop sfglab-go2.service",
        "systemctl daemon-reload",
        "nft delete table inet sfglab_go2",
        "systemctl try-restart chronyd.service",
    ]
    (system.tools / "loaded").unlink()
    said, calls = system.run("--undo")
    assert (words(said), calls) == ({"unchanged"}, [])


@needs_mounts
@pytest.mark.parametrize("number", [1, 3])
def test_what_was_owed_when_a_command_failed_is_done_by_the_next_run(number, tmp_path):
    system = System(tmp_path)
    name = APPLIED[number].partition(" ")[0]
    whole = (system.tools / name).read_text(encoding="utf-8")
    program(system.tools / name, f'[ "{name} $*" != "{APPLIED[number]}" ] || exit 1\n{whole}')
    said, calls = system.run(status=1)
    assert said.endswith("has failed\n")
    assert calls == APPLIED[:number]
    program(system.tools / name, whole)
    said, calls = system.run()
    assert calls[-1] == APPLIED[-1]
    assert APPLIED[number] in calls
    assert list((system.root / "var/lib/sfglab").rglob("*")) == [system.root / "var/lib/sfglab/go2"]
    assert system.run()[1] == []


@needs_mounts
def test_a_time_server_serves_the_network_of_the_global_interface_only(tmp_path):
    system = System(tmp_path, "workstation")
    said, _ = system.run()
    settings = (system.root / CHRONY).read_text(encoding="utf-8").splitlines()
    assert settings[1:] == ["local stratum 10", "allow 10.7.0.0/16"]
    program(system.tools / "ip", "exit 1")
    said, _ = system.run()
    assert "skipped: serving time (eth0 has no network yet: run it again when it has)" in said


@needs_mounts
def test_the_service_loads_the_firewall_each_time_and_fails_with_it(tmp_path):
    system = System(tmp_path)
    load = functools.partial(system.run, "load", script="20-firewall.sh")
    assert load()[0].startswith("skipped: loading the firewall (this agent")
    system.run()
    for _ in range(2):
        assert load()[1] == ["nft -f /etc/sfglab/go2.nft"]
    program(system.tools / "nft", "exit 1")
    load(status=1)


@needs_mounts
def test_without_systemd_nothing_is_owed(tmp_path):
    system = System(tmp_path)
    (system.root / "run/systemd/system").rmdir()
    said, calls = system.run()
    assert "skipped: reload of systemd (systemd does not run here)" in said
    assert calls == ["nft -f /etc/sfglab/go2.nft"]
    assert system.run()[1] == []
