"""`sfglab mocap`, `sfglab frames` and `sfglab follow`: what the commands print, and how they refuse."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from commands import called
from waiting import program

from sfglab.errors import SfglabError
from sfglab.messages import message_type
from sfglab.names import TF_STATIC
from sfglab.record import LogWriter
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.listener import TRANSFORMS

EXAMPLE = str(Path(__file__).parents[2] / "data" / "mocap" / "two_agents.yaml")


def logged(path, *transforms):
    with LogWriter(path) as log:
        for number, (parent, child, *topic) in enumerate(transforms):
            value = StampedTransform(parent=parent, child=child, stamp_ns=0, pose=Pose())
            message = message_type(TRANSFORMS)(transforms=[value.to_msg()])
            log.write(*(topic or [TF_STATIC]), message, log_time_ns=number)
    return str(path)


def test_a_sound_tree_passes_the_lint_and_a_broken_one_is_told_and_fails(tmp_path):
    good = logged(tmp_path / "good.mcap", ("map", "go2/base"), ("go2/base", "go2/markers"))
    bad = logged(tmp_path / "bad.mcap", ("map", "go2_markers"), ("go2/base", "go2/markers"))
    options = ("--root-frame", "map", "--agent", "go2")
    assert called("frames", "lint", good, *options) == "3 frames, 0 findings\n"
    printed = called("frames", "lint", bad, *options, status=1)
    assert "second-root" in printed
    assert "did you mean 'go2/markers'?" in printed


def test_the_lint_fails_where_listeners_would_get_nothing(tmp_path):
    log = logged(tmp_path / "run.mcap", ("map", ""), ("map", "go2/base", "/go2/tf"))
    printed = called("frames", "lint", log, status=1)
    assert "refused: transform 'map' -> '' (1x): " in printed
    assert "namespaced: /go2/tf has transforms" in printed
    assert printed.endswith("0 frames, 2 findings\n")


@pytest.mark.live
def test_live_made_up_trees_are_placed_as_a_robot_s_would_be(domain_id):
    options = ("--domain", str(domain_id), "--interface", "lo", "--duration", "2")
    printed = called("mocap", "run", EXAMPLE, "--synthetic", "--publish-tf", *options)
    assert "agent_x/markers -> agent_x/base: tracked" in printed
    assert "Go2 Body -> go2/odom: " in printed
    assert " 0 published" not in printed


FOLLOW = (sys.executable, "-m", "sfglab", "follow")
HALL = str(Path(__file__).parents[2] / "data" / "scenes" / "hall.yaml")


@pytest.mark.live
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_ctrl_c_and_a_lost_terminal_stop_the_agent_and_the_command_ends_when_it_stands(
    domain_id, number
):
    address = ("--domain", str(domain_id), "--interface", "lo")
    with program(*FOLLOW, "serve", "--agent", "go2", "--scene", HALL, *address) as server:
        assert "/global/go2/execute_trajectory" in server.stdout.readline()
        run = ("run", HALL, "--agent", "go2", "--delay", "0", *address)
        with program(*FOLLOW, *run, stderr=subprocess.PIPE) as sender:
            seen = ""
            while "m off" not in seen:
                more = sender.stderr.read(1)
                assert more, seen
                seen += more
            sender.send_signal(number)
            said, _ = sender.communicate(timeout=60)
        assert said.startswith("go2: canceled: the goal was canceled, and the agent braked at (-")
        assert sender.returncode == 130
        server.send_signal(signal.SIGINT)
        server.communicate(timeout=60)
        assert server.returncode == 0


SOURCE = f"mocap run {EXAMPLE} --domain 1"


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (SOURCE, "exactly one of --vicon"),
        (f"{SOURCE} --vicon h --synthetic", "exactly one of --vicon"),
        (f"{SOURCE} --topic a=/x", "'a=/x', allowed: agent_x/markers=/topic, Go2 Body"),
        ("frames lint", "nothing to read; give a file"),
        (f"follow run {HALL} --agent spot", "given 'spot', allowed: .* go2, drone"),
        (f"follow serve --agent spot --scene {HALL}", "'spot', allowed: go2, drone"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(command, says):
    with pytest.raises(SfglabError, match=says) as caught:
        called(*command.split())
    assert "\n" not in str(caught.value)
