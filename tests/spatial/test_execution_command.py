"""`sfglab follow`: a simulated agent in one process, sent along a scene's trajectory by another."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from sfglab.cli import app
from sfglab.errors import SfglabError

HALL = str(Path(__file__).parents[2] / "data" / "scenes" / "hall.yaml")


def start(*words):
    code = "import sys; from sfglab.cli import main; sys.argv[0] = 'sfglab'; main()"
    pipe = subprocess.PIPE
    return subprocess.Popen([sys.executable, "-c", code, "follow", *words], stdout=pipe, stderr=pipe, text=True)


@pytest.mark.live
def test_ctrl_c_stops_the_agent_and_the_command_ends_when_it_stands(domain_id):
    address = ("--domain", str(domain_id), "--interface", "lo")
    with start("serve", "--agent", "go2", "--scene", HALL, *address) as server:
        try:
            assert "/global/go2/execute_trajectory" in server.stdout.readline()
            with start("run", HALL, "--agent", "go2", "--delay", "0", *address) as sender:
                seen = ""
                while "m off" not in seen:
                    more = sender.stderr.read(1)
                    assert more, seen
                    seen += more
                sender.send_signal(signal.SIGINT)
                said, _ = sender.communicate(timeout=60)
                assert said.startswith("go2: canceled: somebody canceled the goal, and the agent braked at (-")
                assert sender.returncode == 130
        finally:
            server.send_signal(signal.SIGINT)
        server.communicate(timeout=60)
        assert server.returncode == 0


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["run", HALL, "--agent", "spot"], "given 'spot', allowed: .* go2, drone"),
        (["run", HALL, "--action", "/x"], "--action: given for 2 agents"),
        (["run", "none.yaml"], "none.yaml: .*a readable text file"),
        (["serve", "--agent", "spot", "--scene", HALL], "--agent: given 'spot', allowed for .*: go2, drone"),
        (["serve", "--agent", "Go-2"], "agent"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(words, says):
    found = CliRunner().invoke(app, ["follow", *words])
    assert isinstance(found.exception, SfglabError)
    with pytest.raises(SfglabError, match=says):
        raise found.exception
    assert "\n" not in str(found.exception)
