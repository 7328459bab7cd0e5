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
FLEET, QOS, GRAPH = (
    DATA / "fleets/lab.yaml",
    DATA / "qos/paper_b.yaml",
    DATA / "graphs/figure_8.yaml",
)
SCENE, MOCAP, LOG = (
    DATA / "scenes/hall.yaml",
    DATA / "mocap/two_agents.yaml",
    DATA / "reference/mocap.mcap",
)
LIMIT_S = 60

DOCUMENTS = {  # a command, BAD where the file stands, and a good one
    "fleet lint BAD": FLEET,
    "fleet router BAD --agent go2": FLEET,
    "agent up --fleet BAD --agent go2": FLEET,
    "router --fleet BAD --agent go2": FLEET,
    "deploy plan BAD": FLEET,
    "deploy render BAD -o OUT": FLEET,
    "deploy check BAD": FLEET,
    "deploy apply BAD": FLEET,
    "deploy releases BAD": FLEET,
    f"view {LOG} --fleet BAD --to OUT.rrd": FLEET,
    "qos BAD": QOS,
    "map BAD": GRAPH,
    "plan BAD --no-browser --port 0": SCENE,
    "follow serve --agent go2 --interface lo --scene BAD": SCENE,
    "follow run BAD --interface lo": SCENE,
    "mocap run BAD --domain 99 --interface lo --synthetic": MOCAP,
}
LOGS = [
    "log info BAD",
    "view BAD --to OUT.rrd",
    "frames lint BAD",
    f"mocap run {MOCAP} --log BAD --topic agent_x=/p --domain 99 --interface lo",
    "map BAD",
    "camera /global/go2/camera_front/color/ffmpeg --interface lo --source bag:BAD#/image",
    "camera /global/go2/camera_front/color/ffmpeg --interface lo --source BAD",
    "try decode_once --profile smoke source=BAD",
]


TEXTS = {  # what stands in a user's file, in place of a good one's bytes
    "empty": lambda _: b"",
    "binary": lambda _: bytes(range(256)) * 8,
    "other text": lambda _: b"a line\nand another\n",
    "a list": lambda _: b"- 1\n- 2\n",
    "null": lambda _: b"null\n",
    "a number": lambda _: b"17\n",
    "an unknown key": lambda _: b"nonesuch: 1\n",
    "latin 1": lambda _: b"name: caf\xe9\n",
    "a tab": lambda _: b"a:\n\t- b\n",
    "unclosed": lambda _: b"a: [1, 2\n",
    "a key twice": lambda _: b"a: 1\na: 2\n",
    "an alias": lambda _: b"a: &x 1\nb: *x\n",
    "numbers as keys": lambda _: b"1: 2\n",
    "deep": lambda _: b"a: " + b"[" * 5000,
    "cut": lambda good: good[: len(good) // 3] + b"\n  x: [",
    "of lists": lambda good: re.sub(
        rb"(?m)^(\w+):.*$", rb"\1: [[]]", re.sub(rb"(?m)^[ #-].*\n", b"", good)
    ),
    "of words": lambda good: re.sub(rb"(?m): *[-\d.]+ *$", b": lots", good) + b"\nnonesuch: 1\n",
    "misspelt": lambda good: re.sub(rb"(?m)^(\w+)(\w):", rb"\1:", good),
}
LINKS = {"dangling": "none", "endless": "/dev/zero", "a device": "/dev/null"}
PATHS = ["missing", "a folder", "in no folder", "below a file", "too long", "a loop", *LINKS]


def _broken(name, folder, good, suffix):
    """Make what a user may give in place of a good file; return its path."""
    path = folder / f"bad{suffix}"
    match name:
        case "missing":
            pass
        case "a folder":
            path.mkdir()
        case "in no folder":
            return folder / "none" / path.name
        case "below a file":
            (folder / "file").write_text("")
            return folder / "file" / path.name
        case "too long":
            return folder / ("x" * 300 + suffix)
        case "a loop":
            path.symlink_to(path)
        case _ if name in LINKS:
            path.symlink_to(LINKS[name])
        case _:
            path.write_bytes(TEXTS[name](good.read_bytes()))
    return path


@pytest.fixture
def attempt(monkeypatch, capfd):
    """Give what runs a command as a process would; it must refuse in one sentence."""

    def overdue(*_):
        raise TimeoutError

    def run(*arguments):
        capfd.readouterr()
        monkeypatch.setattr(sys, "argv", ["sfglab", *map(str, arguments)])
        before = signal.signal(signal.SIGALRM, overdue)
        signal.alarm(LIMIT_S)
        try:
            with pytest.raises(SystemExit) as ended:
                cli.main()
        finally:
            signal.alarm(0)
            signal.signal(signal.SIGALRM, before)
        said = capfd.readouterr()
        lines = [line for line in (said.err or said.out).splitlines() if line.strip()]
        assert ended.value.code not in (0, None), lines
        assert len(lines) == 1, lines
        assert len(lines[0]) < 1500, lines
        assert not re.search(r"Traceback|Errno|PosixPath|Error\(|<class|object at", lines[0]), lines
        return lines[0]

    return run


def _wrong_files():
    """Yield all mistakes for one command of each format, and some for the others."""
    tried = set()
    for command, good in DOCUMENTS.items():
        for mistake in ("missing", "cut") if good in tried else (*PATHS, *TEXTS):
            yield command, good, mistake, ".yaml"
        tried.add(good)
    for command in LOGS:
        for mistake in ("missing", "a folder") if LOG in tried else PATHS:
            yield command, LOG, mistake, ".mcap"
        for suffix in (".mcap", ".db3", ".bag"):
            for mistake in ("empty",) if LOG in tried else ("empty", "binary", "other text"):
                yield command, LOG, mistake, suffix
        tried.add(LOG)


@pytest.mark.parametrize(("command", "good", "mistake", "suffix"), [*_wrong_files()])
def test_a_wrong_document_or_log(command, good, mistake, suffix, tmp_path, attempt):
    bad = _broken(mistake, tmp_path, good, suffix)
    out = tmp_path / "out"
    attempt(*(word.replace("BAD", str(bad)).replace("OUT", str(out)) for word in command.split()))
    assert not list(tmp_path.glob("out*"))


GOOD = {"qos": QOS, "map": GRAPH, "plan": SCENE, "mocap": MOCAP, "follow": SCENE}
GOOD |= {"domain": "99", "agent": "go2"}


def _needed(words, command):
    """Yield words with which a command would run, but for one more that is wrong."""
    for parameter in command.params:
        if parameter.required:
            is_option = hasattr(parameter, "is_flag")
            value = GOOD.get(parameter.name) or GOOD.get("" if is_option else words[0], "none.such")
            yield from [parameter.opts[0], value] if is_option else [value]


def _argument_mistakes():
    for words, command in commands():
        needed = [str(word) for word in _needed(words, command)]
        yield (*words, *needed, "--nonesuch")
        if not any(p.nargs == -1 for p in command.params):
            yield (*words, *needed, "one", "too", "many", "of", "these")
        if needed:
            yield words
        for option in (p for p in command.params if not getattr(p, "is_flag", True)):
            kind = option.type_descriptor.annotation
            if kind not in (str, Path, list[str], list[Path]):
                yield (*words, *needed, option.opts[0], "lots")
            if option.name in {"delay", "rate_max", "lut", "seed", "duration", "port"}:
                yield (*words, *needed, option.opts[0], "-1")
                yield (*words, *needed, option.opts[0], "nan")


@pytest.mark.parametrize("words", sorted(set(_argument_mistakes())), ids=" ".join)
def test_a_wrong_argument(words, attempt, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = attempt(*words)
    assert not list(tmp_path.iterdir())
    assert re.search(r"(?i)missing|one too many", said) or any(word in said for word in words[-2:])


@pytest.mark.parametrize(
    ("command", "says"),
    {
        f"view {LOG} --to OUT.rrd --domain 3 --interface lo": "--domain and --interface: no effect with a log",
        f"map {GRAPH} --figure OUT.gif": ".png, .svg or .pdf",
        f"map {GRAPH} --figure OUT/map.png": "out/map.png: no such file or directory",
        f"map {GRAPH} --lut 5": "no effect without --optimise-placement",
        f"map {DATA}/graphs/driving.yaml --optimise-placement --gateway-rule paper": "no effect with --optimise-placement",
        f"map {DATA}/graphs/driving.yaml --build-cfg OUT/build.cfg": "a file that can be written",
        f"qos {QOS} --pareto --out OUT": "--out: no effect with --pareto",
        f"qos {QOS} --method paper --latency-weight 2": "--latency-weight: no effect with --method paper",
        f"qos {QOS} --rmw fastrtps-sync --format cyclone": "--rmw chooses another middleware",
        f"qos {QOS} --latency-weight inf": "--latency-weight",
        f"qos {QOS} --format topics": f"--format topics: given {QOS}, allowed: a log",
        f"qos {DATA}/reference/latency.mcap": "no topic goes from one host to another",
        "plan OUT --no-browser --port 0": "--new begins one",
        f"plan {SCENE} --new --no-browser --port 0": "--new: given",
        f"deploy render {DATA}/fleets/esslingen.yaml -o OUT --agent go3": "did you mean 'go2'",
        f"frames lint {LOG} --listen 3": "--listen: no effect with a log",
        f"mocap run {MOCAP} --domain 99 --synthetic --type pose": "--type: no effect without",
        f"view {LOG} --to OUT.rrd --topic /typo": "the beginning of one of /",
        "topic pub /a std_msgs/msg/String '{datum: x}'": "datum",
        "topic pub /a std_msgs/Sting ''": "did you mean std_msgs/msg/String",
        "topic pub /a std_msgs/msg/String --once --qos-durability maybe": "not one of 'volatile', 'transient_local'",
        "topic list --domain 233": "less than or equal to 232",
        "topic hz /a --window 1": "greater than or equal to 2",
        "qos --fromat table": "Possible options: --domain, --format, --rmw",
        "router": "its own domain",
        "router --domain 233": "--domain",
        "router --domain 0": "domain on both sides: given 0, allowed: two",
        "router --domain 7 --agent torq": "torq",
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
    f"qos {QOS} --out OUT/q",
    f"map {GRAPH} --out OUT/g.yaml --figure OUT/g.png",
    "schema fleet --out OUT/s.json",
    "interfaces OUT",
    f"deploy render {DATA}/fleets/esslingen.yaml -o OUT/r",
    f"view {LOG} --to OUT/v.rrd",
]


@pytest.mark.parametrize("command", WRITERS)
@pytest.mark.parametrize("mistake", ["below a file", "too long"])
def test_an_output_that_cannot_be(command, mistake, tmp_path, attempt):
    (tmp_path / "file").write_text("kept")
    out = tmp_path / ("file" if mistake == "below a file" else "x" * 300)
    attempt(*command.replace("OUT", str(out)).split())
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_text() == "kept"


MOUNT = """mount -t tmpfs -o size=4k none {out} && {more} && {run}
code=$?; find {out} -mindepth 1 -name '[!f]*'; exit $code"""
FULL, READ_ONLY = "head -c 4096 /dev/zero > {out}/filler", "mount -o remount,ro {out}"


@pytest.mark.netns
@pytest.mark.parametrize(
    ("command", "more"), [*((w, FULL) for w in WRITERS), *((w, READ_ONLY) for w in WRITERS[:3])]
)
def test_a_disk_that_is_full_or_read_only(command, more, tmp_path):
    """In mounts of the process's own."""
    run = f"{sys.executable} -P -m sfglab {command.replace('OUT', str(tmp_path))} >/dev/null"
    script = MOUNT.format(out=tmp_path, more=more.format(out=tmp_path), run=run)
    done = subprocess.run(
        ["unshare", "-rm", "sh", "-c", script], capture_output=True, text=True, check=False
    )
    assert done.returncode in (1, 2)
    assert re.fullmatch(r"sfglab: [^\n]*\n", done.stderr), done.stderr
    assert not done.stdout, "something half is left"


@pytest.mark.live
@pytest.mark.parametrize("delay_s", [0.1, 2.0])
@pytest.mark.parametrize(
    "command", ["claims", f"qos {QOS} --pareto", "frames lint --domain 99 --listen 60"]
)
def test_ctrl_c_is_one_line(command, delay_s, tmp_path):
    """From when Python has begun with the package, which it tells: what its own start prints is not ours."""
    argv, told = (
        [sys.executable, "-X", "importtime", "-P", "-m", "sfglab", *command.split()],
        tmp_path / "told",
    )
    with (
        told.open("w") as out,
        subprocess.Popen(argv, stdout=subprocess.DEVNULL, stderr=out) as process,
    ):
        while "| sfglab\n" not in told.read_text():
            assert process.poll() is None
            time.sleep(0.01)
        time.sleep(delay_s)
        process.send_signal(signal.SIGINT)
        process.wait(LIMIT_S)
    said = [line for line in told.read_text().splitlines() if not line.startswith("import time:")]
    assert said in ([], ["sfglab: interrupted"])  # empty: it had ended
