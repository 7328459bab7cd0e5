"""The hallway's nodes live over DDS on hosts of their own: the same cores make the same turn."""

import asyncio

import psutil
import pytest

from sfglab.arp.hallway import End
from sfglab.lab.experiments.cooperation.stage import LIVE_POINT, drive_live

pytestmark = [pytest.mark.live, pytest.mark.netns, pytest.mark.slow]


def test_three_robots_set_off_together_and_nothing_is_left_behind():
    before = {child.pid for child in psutil.Process().children(recursive=True)}
    drive = asyncio.run(drive_live(LIVE_POINT, 0, seconds=4.0))
    assert drive.verdict is None or drive.verdict.end is not End.CONTACT
    # How many of them get going in these seconds depends on the machine's other work.
    last = {track.robot: track for track in drive.tracks}
    assert set(last) <= {"robot1", "robot2", "robot3"}
    assert all(track.manoeuvre == "forward" for track in last.values() if track.t_s > 2.0)
    assert drive.radio.delivered > 0
    assert {child.pid for child in psutil.Process().children(recursive=True)} <= before
