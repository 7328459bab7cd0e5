"""The hooks, run for real: on another root, and on this system with its folders and commands exchanged."""

import os
import shutil
import subprocess
from functools import partial

import pytest
from esslingen import GO2, deployed, program

from sfglab.deploy.bundle import Bundle, write_bundle
from sfglab.deploy.host import host_files, service_unit
from sfglab.fleet.fleet_file import ContainerNetwork

UNIT = "etc/systemd/system/sfglab-go2.service"
WANTED = "etc/systemd/system/multi-user.target.wants/sfglab-go2.service"
CHRONY = "etc/chrony/conf.d/sfglab.conf"
RULES = "etc/sfglab/go2.nft"
NUMBERS = "opt/sfglab/go2/.env"


BARE = deployed(
    time_servers=(),
    host={"network": ContainerNetwork.HOST},
    agent={"global_interface": None},
)
"""The Go2 without time servers and anything to close."""


def machine(root, deployment=GO2):
    """Make a root with chrony, nft and an agent's folder; return its initialize.sh."""
    folder = root / deployment.folder.lstrip("/")
    write_bundle(Bundle(agent="", tag="", image="", members=host_files(deployment)), folder)
    for name in ("chronyd", "nft"):
        program(root / "usr/sbin" / name)
    (root / "etc/chrony/conf.d").mkdir(parents=True, exist_ok=True)
    (root / "etc/group").write_text("root:x:0:\nvideo:x:44:\nrender:x:993:\n")
    (folder / "release.env").write_text("SFGLAB_TAG=1-a\n")
    return folder / "hooks/initialize.sh"


def run(script, *options, root=None, path="/bin", status=0):
    """Run the hooks; return what they print."""
    other = {"SFGLAB_ROOT": str(root)} if root else {}
    return printed(["bash", script, *options], path, status, **other)


def printed(command, path, status, **variables):
    environment = {"PATH": f"{path}:{os.environ['PATH']}", "LC_ALL": "C", **variables}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout + done.stderr


def words(text):
    return {line.split(":")[0] for line in text.splitlines()}


def tree(root, *, times=True):
    """Return kind and mode, content or target, and time of everything below a folder."""
    found = {}
    for path in root.rglob("*"):
        state = path.lstat()
        content = None
        if path.is_symlink():
            content = path.readlink()
        elif path.is_file():
            content = path.read_bytes()
        changed_ns = state.st_mtime_ns if times else 0
        found[path.relative_to(root)] = (state.st_mode, content, changed_ns)
    return found


def files_in(root):
    return {path for path, (_, content, _) in tree(root).items() if content is not None}


def test_another_root_gets_what_a_dry_run_shows_undo_takes_it_back_and_nothing_that_runs_is_touched(
    tmp_path,
):
    script = machine(tmp_path)
    before, given = tree(tmp_path), files_in(tmp_path)
    said = run(script, "--dry-run", root=tmp_path)
    assert tree(tmp_path) == before
    for path in (CHRONY, RULES, UNIT, NUMBERS):
        assert f"would change: /{path}\n--- /{path}\n+++ /{path}\n" in said
    assert "+server workstation.local iburst prefer" in said
    assert "\nchanged" not in said
    said = run(script, root=tmp_path)
    assert (tmp_path / CHRONY).read_text().endswith("server workstation.local iburst prefer\n")
    assert "table inet sfglab_go2 {" in (tmp_path / RULES).read_text()
    assert (tmp_path / UNIT).read_text() == service_unit(GO2)
    assert str((tmp_path / WANTED).readlink()) == f"/{UNIT}"
    numbers = "\nSFGLAB_TAG=1-a\nSFGLAB_VIDEO_GID=44\nSFGLAB_RENDER_GID=993\n"
    assert (tmp_path / NUMBERS).read_text().endswith(numbers)
    for what in ("restart of chrony", "table inet sfglab_go2", "reload of systemd"):
        assert f"skipped: {what} (SFGLAB_ROOT is not the running system)" in said
    assert words(said) == {"changed", "skipped"}
    before = tree(tmp_path)
    assert words(run(script, root=tmp_path)) == {"unchanged", "skipped"}
    run(script, "--undo", "--dry-run", root=tmp_path)
    assert tree(tmp_path) == before, "neither changes anything, not even a time"
    run(script, "--undo", root=tmp_path)
    assert files_in(tmp_path) == given
    assert words(run(script, "--undo", root=tmp_path)) == {"unchanged", "skipped"}


@pytest.mark.parametrize(("number", "step"), [(1, ":"), (4, '{mv} "$@"')], ids=["before", "after"])
def test_a_run_that_was_killed_is_completed_by_the_next(number, step, tmp_path):
    whole, cut, tools = tmp_path / "whole", tmp_path / "cut", tmp_path / "tools"
    run(machine(whole), root=whole)
    script = machine(cut)
    mv = shutil.which("mv")
    kill = f'[ "$(wc -l <{tools}/n)" = {number} ] || exec {mv} "$@"; {step.format(mv=mv)}'
    program(tools / "mv", f"echo >>{tools}/n; {kill}; kill -KILL $PPID")
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
    (custom / "50-b.sh").write_text(mine)
    (custom / "10-a.sh").write_text('echo "first in $SFGLAB_ROOT"')
    (custom / "note.txt").write_text("exit 1")
    before = tree(tmp_path)
    said = run(script, "--dry-run", root=tmp_path)
    assert said.endswith("skipped: custom.d/50-b.sh (scripts of yours are not run by --dry-run)\n")
    assert tree(tmp_path) == before
    ours, _, theirs = run(script, root=tmp_path).partition(f"first in {tmp_path}\n")
    assert "reload of systemd" in ours
    assert theirs == "ran: custom.d/10-a.sh\nchanged: /etc/mine.conf\nran: custom.d/50-b.sh\n"
    assert (tmp_path / "etc/mine.conf").stat().st_mode & 0o777 == 0o600
    (custom / "60-c.sh").write_text("exit 7")
    said = run(script, root=tmp_path, status=1)
    assert said.endswith("sfglab: custom.d/60-c.sh: has failed with status 7\n")


def test_without_root_the_machine_is_refused_and_a_developer_gets_what_the_containers_need(
    tmp_path,
):
    script = machine(tmp_path)
    program(tmp_path / "tools/id", "echo 1000")
    said = run(script, path=tmp_path / "tools", status=1)
    allowed = "run it with sudo, or set SFGLAB_ROOT to another root"
    assert said == f"sfglab: the machine can be changed by root only: {allowed}\n"
    before = tree(tmp_path, times=False)
    said = run(script, "--development", path=tmp_path / "tools")
    assert "skipped: time, firewall and service (they need root" in said
    file = script.parents[1] / ".env"
    assert file.read_text().splitlines()[1] == "SFGLAB_TAG=1-a"
    file.unlink()
    assert tree(tmp_path, times=False) == before


def test_a_link_that_leads_out_of_the_other_root_is_not_followed_and_a_missing_release_ends_the_run(
    tmp_path,
):
    root, outside = tmp_path / "root", tmp_path / "outside"
    outside.mkdir()
    script = machine(root)
    rules = root / "etc/sfglab"
    rules.symlink_to(outside)
    assert "leads out of SFGLAB_ROOT" in run(script, root=root, status=1)
    assert list(outside.iterdir()) == []
    rules.unlink()
    (script.parents[1] / "release.env").unlink()
    says = "sfglab: release.env: missing, so that no release could start"
    assert says in run(script, root=root, status=1)


@pytest.mark.parametrize("name", ["go2", "workstation"])
def test_timesyncd_is_asked_where_there_is_no_chrony_and_cannot_serve(name, tmp_path):
    script = machine(tmp_path, deployed(name))
    (tmp_path / "usr/sbin/chronyd").unlink()
    program(tmp_path / "usr/lib/systemd/systemd-timesyncd")
    said = run(script, root=tmp_path)
    drop_in = tmp_path / "etc/systemd/timesyncd.conf.d/sfglab.conf"
    if name == "go2":
        assert drop_in.read_text().endswith("[Time]\nNTP=\nNTP=workstation.local\n")
    else:
        assert "skipped: serving time (systemd-timesyncd cannot: install chrony)" in said
        assert not drop_in.exists()


def test_what_a_machine_or_fleet_does_not_have_is_reported_and_no_error(tmp_path):
    script = machine(tmp_path, BARE)
    (tmp_path / "etc/group").write_text("root:x:0:\nvideo:x:44:\n")
    (tmp_path / UNIT).parent.mkdir(parents=True)
    (tmp_path / UNIT).symlink_to("/dev/null")
    said = run(script, root=tmp_path)
    for line in (
        "skipped: time servers (the fleet file names none)",
        "skipped: firewall of the domain (the fleet file names no global interface)",
        "skipped: firewall (there is nothing to close)",
        "skipped: group render (this machine has none: 10001, the containers' own, stands for it)",
        f"skipped: /{UNIT} (it is masked: systemctl unmask sfglab-go2.service)",
    ):
        assert line in said
    assert (tmp_path / NUMBERS).read_text().endswith("SFGLAB_RENDER_GID=10001\n")
    assert str((tmp_path / UNIT).readlink()) == "/dev/null"


def test_what_an_earlier_release_set_and_this_one_does_not_is_taken_back(tmp_path):
    bare, root = tmp_path / "bare", tmp_path / "root"
    run(machine(bare, BARE), root=bare)
    run(machine(root), root=root)
    script = machine(root, BARE)
    (script.parent / "firewall.nft").unlink()
    said = run(script, root=root)
    assert f"changed: /{CHRONY} (removed)" in said
    assert f"changed: /{RULES} (removed)" in said
    (root / "etc/sfglab").rmdir()
    assert tree(root, times=False) == tree(bare, times=False)


# On this system, with folders and commands exchanged

EXCHANGED = ("etc", "run", "opt", "var/lib")
OWN_MOUNTS = ["unshare", "--mount"]
if os.geteuid() != 0:
    OWN_MOUNTS.append("--map-root-user")


MOUNT = [*OWN_MOUNTS, "mount", "-t", "tmpfs", "none", "/mnt"]
needs_mounts = pytest.mark.skipif(
    not shutil.which("unshare") or subprocess.call(MOUNT, stderr=subprocess.DEVNULL) != 0,
    reason="needs mounts of its own: root, or user namespaces",
)


class System:
    """This system with other folders, and commands that write down how they were called."""

    def __init__(self, root, deployment=GO2):
        self.root, self.tools = root / "root", root / "tools"
        self.hooks = machine(self.root, deployment).parent
        for name in ("var/lib", "run/systemd/system"):
            (self.root / name).mkdir(parents=True)
        # Commands that are chosen there, such as awk, are found through it.
        shutil.copytree("/etc/alternatives", self.root / "etc/alternatives", symlinks=True)
        log = f'! grep -qsx "${{0##*/}} $*" {self.tools}/broken || exit 1'
        log += f'\necho "${{0##*/}} $*" >>{self.tools}/calls'
        program(self.tools / "systemctl", log)
        program(self.tools / "chronyd")
        loaded = f"{self.tools}/loaded"
        listed = f"[ $1 != list ] || exec test -e {loaded}"
        program(self.tools / "nft", f"{listed}; {log}\n[ $1 != -f ] || touch {loaded}")
        program(self.tools / "ip", '[ "$1" = -6 ] || echo "10.7.0.0/16 scope link src 10.7.0.4"')

    def run(self, *options, script="initialize.sh", status=0):
        """Run a hook there; return what it prints and the commands that it ran."""
        (self.tools / "calls").write_text("")
        mounts = " && ".join(f"mount --bind {self.root}/{name} /{name}" for name in EXCHANGED)
        hook = f"/{self.hooks.relative_to(self.root)}/{script}"
        command = [*OWN_MOUNTS, "bash", "-c", f'{mounts} && exec bash {hook} "$@"', "-", *options]
        said = printed(command, self.tools, status)
        return said, (self.tools / "calls").read_text().splitlines()


APPLIED = [
    "systemctl enable --quiet chronyd.service",
    "systemctl restart chronyd.service",
    "nft -f /etc/sfglab/go2.nft",
    "systemctl daemon-reload",
]
UNDONE = [
    "systemctl stop sfglab-go2.service",
    "systemctl daemon-reload",
    "nft delete table inet sfglab_go2",
    "systemctl try-restart chronyd.service",
]


@needs_mounts
def test_the_running_system_is_changed_once_and_changed_back(tmp_path):
    system = System(tmp_path)
    said, calls = system.run("--dry-run")
    assert calls == []
    assert "would change: restart of chrony\n" in said
    assert not (system.root / UNIT).exists()
    said, calls = system.run()
    assert (words(said), calls) == ({"changed"}, APPLIED)
    before = tree(system.root)
    said, calls = system.run()
    assert (words(said), calls) == ({"unchanged"}, [])
    assert tree(system.root) == before
    assert system.run("--undo")[1] == UNDONE
    (system.tools / "loaded").unlink()
    said, calls = system.run("--undo")
    assert (words(said), calls) == ({"unchanged"}, [])


@needs_mounts
@pytest.mark.parametrize("number", [1, 3])
def test_what_was_owed_when_a_command_failed_is_done_by_the_next_run(number, tmp_path):
    system = System(tmp_path)
    (system.tools / "broken").write_text(APPLIED[number])
    said, calls = system.run(status=1)
    assert said.endswith("has failed\n")
    assert calls == APPLIED[:number]
    (system.tools / "broken").unlink()
    _, calls = system.run()
    assert calls[-1] == APPLIED[-1]
    assert APPLIED[number] in calls
    state = system.root / "var/lib/sfglab"
    assert list(state.rglob("*")) == [state / "go2"]
    assert system.run()[1] == []


@needs_mounts
def test_a_time_server_serves_the_network_of_the_global_interface_only(tmp_path):
    system = System(tmp_path, deployed("workstation"))
    system.run()
    settings = (system.root / CHRONY).read_text().splitlines()
    assert settings[1:] == ["local stratum 10", "allow 10.7.0.0/16"]
    program(system.tools / "ip", "exit 1")
    said, _ = system.run()
    assert "skipped: serving time (eth0 has no network yet: run it again when it has)" in said


@needs_mounts
def test_the_service_loads_the_firewall_each_time_and_fails_with_it_also_without_systemd(tmp_path):
    system = System(tmp_path)
    (system.root / "run/systemd/system").rmdir()
    load = partial(system.run, "load", script="20-firewall.sh")
    assert load()[0].startswith("skipped: loading the firewall (this agent")
    said, calls = system.run()
    assert "skipped: reload of systemd (systemd does not run here)" in said
    assert calls == ["nft -f /etc/sfglab/go2.nft"]
    assert system.run()[1] == []
    for _ in range(2):
        assert load()[1] == ["nft -f /etc/sfglab/go2.nft"]
    program(system.tools / "nft", "exit 1")
    load(status=1)
