"""Every command's help: an example, whole descriptions; and each example that can end is run."""

import inspect
import itertools
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from bags import write_bag
from commands import called, commands
from made_logs import share_findings
from waiting import program

from sfglab.domains import MAX_DOMAIN

ROOT = Path(__file__).parents[1]
# Two that listen for seconds are tried in test_recorded_topics.
LISTENING = "sfglab (qos|map) --domain"
LIVE = r"sfglab (topic|node|log (record|play)|frames lint --domain|mocap run)"
# Until Ctrl-C; `test_what_never_ends_ends_by_one_line` ends some.
ENDLESS = (
    "lab|router|hub|decoder|camera|plan |agent up|follow serve|view (bag/|--domain|--fleet .* --i)",
    r"topic echo (/chatter( --json.*)?$|/odom)|topic hz (/chatter$|/camera)",
    "topic pub (/chatter|-r)|log record (/chatter|-e)",
)
# Minutes, all figures, a fleet's machines, checkers of its files, cameras, robots, an editor's folder.
ELSEWHERE = (
    "reproduce|try|figures|deploy (plan|apply|releases|check|detect --root)",
    "mocap run .*(--vicon|--topic)|map .*--verilog|follow run|interfaces|log play run.mcap --rate",
)
TALKER = """
import asyncio
from sfglab.bus import Node
from sfglab.messages import default_message

async def main():
    kinds = {"/chatter": "std_msgs/msg/String", "/tf": "tf2_msgs/msg/TFMessage"}
    kinds |= {"/odom": "nav_msgs/msg/Odometry", "/camera/image_raw": "sensor_msgs/msg/Image"}
    async with Node("talker") as talker:
        publishers = [talker.create_publisher(kind, topic) for topic, kind in kinds.items()]
        listener = talker.create_subscription(kinds["/chatter"], "/chatter", lambda heard: None)
        print("ready", flush=True)
        while True:
            for publisher in publishers:
                publisher.publish(default_message(publisher.type_name))
            await asyncio.sleep(0.02)

asyncio.run(main())
"""

COMMANDS = {" ".join(words): command for words, command in commands()}
HELP = "\n".join(command.help for command in COMMANDS.values())
EXAMPLES = re.findall(r"^ *(sfglab .*)$", HELP, re.MULTILINE)


def ends(example):
    return not re.match(f"sfglab ({'|'.join((*ENDLESS, *ELSEWHERE))})", example)


def words_of(example):
    return shlex.split(example, comments=True)[1:]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with what examples name: data, a log, bags of both kinds."""
    (tmp_path / "data").symlink_to(ROOT / "data")
    share_findings(tmp_path)
    monkeypatch.chdir(tmp_path)
    log = "data/reference/mocap.mcap"
    shutil.copy(log, "run.mcap")
    write_bag(log, Path("bag"))
    called("fleet", "router", "data/fleets/lab.yaml", "--agent", "go2", "-o", "go2.yaml")
    return tmp_path


@pytest.fixture(scope="module")
def talker():
    """Return a domain in which a node publishes for the processes of this module."""
    from sfglab.lab.testbed import held_domains

    with held_domains(1) as (domain,), pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(domain))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        with program(sys.executable, "-c", TALKER) as process:
            assert process.stdout.readline() == "ready\n"
            yield domain


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_examples_that_its_parser_takes_and_the_list_of_commands_its_whole_description(
    name,
):
    *group, last = name.split()
    command, text = COMMANDS[name], inspect.cleandoc(COMMANDS[name].help)
    examples = re.findall(
        rf"^ +(?:\w+=\S+ +)*sfglab {name}\b(.*(?:\n    +\S.*)*)", text, re.MULTILINE
    )
    assert examples
    for example in examples:
        arguments = shlex.split(re.split(r" [|>] |;", example)[0], comments=True)
        command.make_parser(command.context_class(command)).parse_args(arguments)
    assert called(*group, last, "-h") == called(*group, last, "--help")
    words = command.help.partition("\n\n")[0].split()
    said = " ".join(called(*group, last, "-h").split())
    assert " ".join(words) in " ".join(called(*group, "-h").split())
    for option in command.params:
        if option.name in ("domain", "remote_domain", "global_domain"):
            text = said.partition(f"{option.opts[0]} <")[2].partition(" --")[0]
            assert f"0<=x<={MAX_DOMAIN}]" in text


def words_in(domain, example):
    """Return an example's words, with another domain."""
    pairs = itertools.pairwise(["", *words_of(example)])
    return [str(domain) if before == "--domain" else word for before, word in pairs]


REPORTS = (
    "doctor",
    "claims",
    "deploy detect",
    "log info data/reference/mocap.mcap",
    "fleet lint data/fleets/lab.yaml",
    "frames lint run.mcap",
    "qos data/qos/paper_b.yaml",
    "map data/graphs/figure_8.yaml",
    "deploy plan data/fleets/lab.yaml",
)


@pytest.mark.slow
@pytest.mark.parametrize("command", REPORTS)
def test_what_reports_does_so_as_json(command, folder):
    status = int(command.startswith("deploy plan"))  # of machines that nothing names
    assert json.loads(called(*command.split(), "--json", status=status)) is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    "example", [one for one in EXAMPLES if ends(one) and not re.match(f"{LIVE}|{LISTENING}", one)]
)
def test_examples_of_files_do_what_they_say(example, folder):
    if "bag/ --format" in example:
        write_bag(Path("data/reference/cooperation.mcap"), Path("topics"))
        example = example.replace("bag/", "topics/")
    before = set(folder.rglob("*"))
    assert called(*words_of(example)) or set(folder.rglob("*")) > before


@pytest.mark.slow
@pytest.mark.live
@pytest.mark.parametrize("example", [one for one in EXAMPLES if ends(one) and re.match(LIVE, one)])
def test_examples_of_the_bus_do_what_they_say(example, folder, talker):
    # The talker's frames are no tree.
    status = int(example.startswith("sfglab frames lint --domain"))
    assert called(*words_in(talker, example), status=status)


@pytest.mark.slow
@pytest.mark.live
@pytest.mark.parametrize(
    "example",
    [one for one in EXAMPLES if re.match("sfglab (topic|log record)", one) and not ends(one)],
)
def test_what_never_ends_ends_by_one_line(example, folder, talker):
    words = words_in(talker, example.partition("|")[0])
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-u", "-m", "sfglab", *words], **pipes) as process:
        assert process.stdout.readline()
        process.send_signal(signal.SIGINT)
        _, said = process.communicate()
    assert process.returncode == 0
    assert said.endswith(b"ended\n")
    assert b"Traceback" not in said


@pytest.mark.live
def test_output_that_nobody_reads_or_that_is_full_is_no_traceback(talker):
    for shell, status, said in (
        ("topic pub -r 100 /x std_msgs/msg/String | head -1; exit ${PIPESTATUS[0]}", 1, b""),
        ("topic list > /dev/full", 1, b"sfglab: standard output: no space left on device\n"),
    ):
        argv = ["bash", "-c", f"{shlex.quote(sys.executable)} -m sfglab {shell}"]
        done = subprocess.run(argv, capture_output=True, check=False)
        assert (done.returncode, done.stderr) == (status, said)


def test_what_was_said_before_an_error_is_not_lost():
    code = (
        "from sfglab import cli, errors\n"
        "def app(**_):\n    print('so far')\n    raise errors.SfglabError('wrong')\n"
        "cli.app = app\ncli.main()\n"
    )
    environment = dict(os.environ)
    environment.pop("PYTHONUNBUFFERED", None)
    argv = [sys.executable, "-c", code]
    done = subprocess.run(argv, capture_output=True, check=False, env=environment)
    assert (done.returncode, done.stdout, done.stderr) == (1, b"so far\n", b"sfglab: wrong\n")
