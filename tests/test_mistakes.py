"""Mistakes made from every command's files and options: one sentence, no traceback, nothing half."""

import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from commands import commands

from sfglab import cli

ROOT = Path(__file__).parents[1]
DATA = ROOT / "data"
FLEET = DATA / "fleets/lab.yaml"
QOS = DATA / "qos/paper_b.yaml"
GRAPH = DATA / "graphs/figure_8.yaml"
SCENE = DATA / "scenes/hall.yaml"
MOCAP = DATA / "mocap/two_agents.yaml"
LOG = DATA / "reference/mocap.mcap"
LIMIT_S = 60
pytestmark = pytest.mark.timeout(2 * LIMIT_S)

# Commands with BAD where a file stands: one for each format, one that starts processes, and one that writes.
DOCUMENTS = [
    "fleet lint BAD",
    "agent up --fleet BAD --agent go2",
    "deploy render BAD -o OUT",
    "qos BAD",
    "map BAD",
    "plan BAD --no-browser --port 0",
    "mocap run BAD --domain 99 --interface lo --synthetic",
]
LOGS = [
    "log info BAD",
    "view BAD --to OUT.rrd",
    "frames lint BAD",
    f"mocap run {MOCAP} --log BAD --topic agent_x=/p --domain 99 --interface lo",
    "map BAD",
    "camera /global/go2/camera_front/color/ffmpeg --interface lo --source BAD",
    "try decode_once --profile smoke source=BAD",
]
# Contents of wrong files. tests/test_documents.py has the mistakes of YAML itself.
TEXTS = {
    "empty": b"",
    "binary": bytes(range(256)) * 8,
    "a list": b"- 1\n- 2\n",
    "an unknown key": b"nonesuch: 1\n",
    "latin 1": b"name: caf\xe9\n",
    "unclosed": b"a: [1, 2\n",
    "deep": b"a: " + b"[" * 5000,
}
PATHS = ["missing", "folder", "file/below", "x" * 300, "dangling", "endless", "loop"]


@pytest.fixture
def attempt(monkeypatch, capfd):
    """Give what runs a command as a process would; it must refuse in one sentence."""

    def run(*arguments):
        capfd.readouterr()
        monkeypatch.delenv("CI", raising=False)  # the Rerun SDK warns there of a viewer's start
        monkeypatch.setattr(sys, "argv", ["sfglab", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capfd.readouterr()
        lines = [line for line in (said.err or said.out).splitlines() if line.strip()]
        assert ended.value.code not in (0, None), lines
        assert len(lines) == 1, lines
        assert len(lines[0]) < 1500, lines
        assert not re.search(r"Traceback|Errno|PosixPath|Error\(|<class|object at", lines[0]), lines
        return lines[0]

    return run


@pytest.fixture
def refused(tmp_path, attempt):
    """Give what runs a command with a wrong file; it must leave nothing."""
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("")
    for link, target in {"dangling": "none", "endless": "/dev/zero", "loop": "loop"}.items():
        (tmp_path / link).symlink_to(target)

    def run(command, bad):
        words = command.replace("BAD", f"{tmp_path}/{bad}").replace("OUT", f"{tmp_path}/out")
        attempt(*words.split())
        assert not list(tmp_path.glob("out*"))

    return run


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("command", ["fleet lint BAD", "log info BAD", "frames lint BAD"])
def test_a_path_that_leads_to_no_file(command, path, refused):
    refused(command, path)


@pytest.mark.parametrize("mistake", TEXTS)
@pytest.mark.parametrize("command", DOCUMENTS)
def test_a_wrong_document(command, mistake, tmp_path, refused):
    """tests/test_schema.py has wrong values and keys in good documents."""
    (tmp_path / "bad.yaml").write_bytes(TEXTS[mistake])
    refused(command, "bad.yaml")


@pytest.mark.parametrize("suffix", [".mcap", ".db3", ".bag"])
@pytest.mark.parametrize("mistake", ["empty", "binary"])
@pytest.mark.parametrize("command", LOGS)
def test_a_wrong_log(command, mistake, suffix, tmp_path, refused):
    (tmp_path / f"bad{suffix}").write_bytes(TEXTS[mistake])
    refused(command, f"bad{suffix}")


WRONG_ARGUMENTS = [
    "fleet lint",
    "router --agent",
    "topic pub /a",
    "follow serve",
    "fleet router x.yaml",
    "schema none.such",
    "topic hz /a --window lots",
    "qos --duration lots",
    "log play a --rate lots",
    "topic hz /a --duration -1",
    "reproduce --seed -1",
    f"map {GRAPH} --lut -1",
    f"qos {QOS} --rate-max -1",
    f"follow run {SCENE} --delay -1",
    f"plan {SCENE} --port -1",
]
UNKNOWN_OPTIONS = [" ".join((*words, "--nonesuch")) for words, _ in commands()]


@pytest.mark.parametrize("command", [*WRONG_ARGUMENTS, *UNKNOWN_OPTIONS])
def test_a_wrong_argument(command, attempt, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = attempt(*command.split())
    assert not list(tmp_path.iterdir())
    assert re.search(r"(?i)missing|requires", said) or any(
        word in said for word in command.split()[-2:]
    )


@pytest.mark.parametrize(
    ("command", "says"),
    {
        f"view {LOG} --to OUT.rrd --domain 3 --interface lo": "--domain and --interface: no effect with a log",
        f"map {GRAPH} --figure OUT.gif": ".png, .svg or .pdf",
        f"map {DATA}/graphs/driving.yaml --build-cfg OUT/build.cfg": "a file that can be written",
        f"qos {QOS} --pareto --output OUT": "--output: no effect with --pareto",
        f"qos {QOS} --method paper --latency-weight 2": "--latency-weight: no effect with --method paper",
        f"plan {SCENE} --new --no-browser --port 0": "--new: given",
        f"frames lint {LOG} --duration 3": "--duration: no effect with a log",
        "router --domain 7 --agent torq": "torq",
        f"map {GRAPH} --lut 5": "no effect without --optimise-placement",
        f"map {DATA}/graphs/driving.yaml --optimise-placement --gateway-rule paper": "no effect with --optimise-placement",
        f"qos {QOS} --rmw fastrtps-sync --format cyclone": "--rmw chooses another middleware",
        f"qos {QOS} --format topics": f"--format topics: given {QOS}, allowed: a log",
        f"qos {DATA}/reference/latency.mcap": "no topic goes from one host to another",
        "plan OUT --no-browser --port 0": "or --new to begin one",
        f"deploy render {DATA}/fleets/esslingen.yaml -o OUT --agent go3": "did you mean 'go2'",
        f"mocap run {MOCAP} --domain 99 --synthetic --type pose": "--type: no effect without",
        f"view {LOG} --to OUT.rrd --topic /typo": "the beginning of one of /",
        "topic pub /a std_msgs/msg/String '{datum: x}'": "datum",
        "topic pub /a std_msgs/Sting ''": "did you mean std_msgs/msg/String",
        "topic list --domain 233": "given '233', allowed: less than or equal to 232; see sfglab topic list --help",
        f"log play {LOG} --topics /typo --domain 99 --interface lo": "no topic is selected; it has /table/check",
        f"view {LOG} --to viewer": "give --to FILE.rrd instead",
        f"view {LOG} --to OUT.mp4": "--to: given",
        "doctor extra": "(extra); see sfglab doctor --help",
        "try gateway": "did you mean 'gateways'?",
        "qos --fromat table": "Possible options: --domain, --format, --rmw",
        "router": "its own domain",
        "router --domain 0": "domain on both sides: given 0, allowed: two different DDS domains",
        f"router --fleet {FLEET} --agent pi9": "given 'pi9', allowed: go2, pi1",
        "router --domain 101 --agent go2 --interface nowhere0": "no network interface 'nowhere0'",
    }.items(),
)
def test_options_that_nothing_looks_at_and_what_one_command_refuses(
    command, says, attempt, tmp_path
):
    assert says in attempt(
        *(word.replace("OUT", str(tmp_path / "out")) for word in shlex.split(command))
    )
    assert not list(tmp_path.iterdir())


WRITERS = [
    f"fleet router {FLEET} --agent go2 -o OUT/a.yaml",
    f"fleet certificates {FLEET} -o OUT/keys",
    f"qos {QOS} --output OUT/q",
    f"map {GRAPH} --output OUT/g.yaml --figure OUT/g.png",
    "schema fleet --output OUT/s.json",
    "interfaces OUT",
    f"deploy render {DATA}/fleets/esslingen.yaml -o OUT/r",
    f"view {LOG} --to OUT/v.rrd",
]


@pytest.mark.parametrize("command", WRITERS)
@pytest.mark.parametrize("place", ["file", "x" * 300], ids=["below a file", "too long"])
def test_an_output_that_cannot_be(command, place, tmp_path, attempt):
    (tmp_path / "file").write_text("kept")
    attempt(*command.replace("OUT", f"{tmp_path}/{place}").split())
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_text() == "kept"


MOUNT = """mount -t tmpfs -o size=4k none {out} && {more} && {run}
code=$?; find {out} -mindepth 1 -name '[!f]*'; exit $code"""
FULL, READ_ONLY = "head -c 4096 /dev/zero > {out}/filler", "mount -o remount,ro {out}"


@pytest.mark.netns
@pytest.mark.parametrize("command", WRITERS)
@pytest.mark.parametrize("more", [FULL, READ_ONLY], ids=["full", "read-only"])
def test_a_disk_that_is_full_or_read_only(command, more, tmp_path):
    """In mounts of the process's own."""
    run = f"{sys.executable} -P -m sfglab {command.replace('OUT', str(tmp_path))} >/dev/null"
    script = MOUNT.format(out=tmp_path, more=more.format(out=tmp_path), run=run)
    argv = ["unshare", "-rm", "sh", "-c", script]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert done.returncode in (1, 2)
    assert re.fullmatch(r"sfglab: [^\n]*\n", done.stderr), done.stderr
    assert not done.stdout, "something half is left"


@pytest.mark.live
@pytest.mark.parametrize("delay_s", [0.1, 2.0])
@pytest.mark.parametrize(
    "command", ["claims", f"qos {QOS} --pareto", "frames lint --domain 99 --duration 60"]
)
def test_ctrl_c_is_one_line(command, delay_s, tmp_path):
    """From when Python has begun with the package, which it tells: what its own start prints is not ours."""
    argv = [sys.executable, "-X", "importtime", "-P", "-m", "sfglab", *command.split()]
    told = tmp_path / "told"
    silent = {"stdout": subprocess.DEVNULL}
    with told.open("w") as out, subprocess.Popen(argv, stderr=out, **silent) as process:
        while "| sfglab\n" not in told.read_text():
            assert process.poll() is None
            time.sleep(0.01)
        time.sleep(delay_s)
        process.send_signal(signal.SIGINT)
        process.wait(LIMIT_S)
    said = [line for line in told.read_text().splitlines() if not line.startswith("import time:")]
    assert said in ([], ["sfglab: interrupted"])  # empty: it had ended
