"""``sfglab view`` as a process."""

import asyncio
import signal
import subprocess
import sys

import pytest
from commands import called
from mcap.reader import make_reader
from seen import BEAT, heartbeat, read_recording
from waiting import DEADLINE_S, program

from sfglab.bus import Node

pytest.importorskip("rerun", reason="the extra 'view' is not installed")
COMMAND = (sys.executable, "-m", "sfglab", "view")


def test_a_log_becomes_a_recording_of_every_message_and_what_was_shown_is_told(
    tmp_path, pytestconfig
):
    """One robot of the hallway: scans, poses and walls."""
    log, out = pytestconfig.rootpath / "data/reference/cooperation.mcap", tmp_path / "a.rrd"
    said = called("view", str(log), "--to", str(out), "--topic", "/failure/robot1").splitlines()
    with log.open("rb") as file:
        held = make_reader(file).get_summary().statistics
    begin = f"{log}: {held.message_count} messages of {held.channel_count} topics go to {out}"
    assert said == [begin, "3 displays, 231 updates shown"], "and none dropped"
    shown = read_recording(out)
    assert not any(entity.startswith("/failure/robot2") for entity, _ in shown)
    assert len(shown["/failure/robot1/scan", "Points3D:positions"]) == 115
    assert len(shown["/failure/robot1/pose", "Arrows3D:vectors"]) == 115
    (walls,) = shown["/failure/robot1/walls/robot1/0", "LineStrips3D:strips"]
    assert len(walls.content) > 0


@pytest.mark.live
def test_without_a_display_it_says_what_to_do_instead(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    done = subprocess.run(COMMAND, capture_output=True, text=True, check=False, timeout=DEADLINE_S)
    assert (done.returncode, done.stdout) == (1, "")
    (line,) = done.stderr.splitlines()
    assert "no display" in line
    assert "--to FILE.rrd" in line


@pytest.mark.live
def test_it_shows_what_another_process_sends_until_ctrl_c_and_the_file_is_whole(
    tmp_path, domain_id
):
    out = tmp_path / "live.rrd"

    async def beat_until_shown():
        async with Node("agent", domain_id=domain_id, interface="lo") as node:
            publisher = node.create_publisher(BEAT, "/global/agent_heartbeat")
            await publisher.wait_for_subscriptions(1, timeout_s=DEADLINE_S)
            for _ in range(30):  # three of its ticks
                publisher.publish(heartbeat("go2"))
                await asyncio.sleep(0.02)

    place = ("--domain", str(domain_id), "--interface", "lo")
    with program(*COMMAND, *place, "--to", str(out)) as process:
        assert process.stdout.readline() == f"domain {domain_id} goes to {out}; Ctrl-C ends\n"
        asyncio.run(beat_until_shown())
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0
    assert said.startswith("1 displays, ")
    assert ("/agents/go2/heartbeat/age_s", "Scalars:scalars") in read_recording(out)
