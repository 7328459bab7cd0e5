"""Rounds of live robots: over DDS on hosts of their own, and which cells on real Fast DDS, and how."""

import asyncio
import time
from dataclasses import replace

import psutil
import pytest

from sfglab.arp.hallway import End
from sfglab.lab.experiments.cooperation import exp, stage
from sfglab.lab.live_flows import MODES, live_hosts
from sfglab.processes import ProcessFailedError
from sfglab.rtps import Medium


def test_cells_are_few_in_quick_and_slowed_where_every_value_is_published():
    quick, paper = (stage.ros_cells(exp.config(profile)) for profile in ("quick", "paper"))
    assert sum(14 * cell.slowed for cell in quick) < 50
    assert [(c.point.method, c.preset[9:]) for c in quick] == [
        ("none", "async"),
        ("OPT+LC", "async"),
    ]
    assert {c.preset for c in paper} == {"fast_dds_sync", "fast_dds_async"}
    assert {f"{c.point.method} {c.slowed:g}" for c in paper} == {
        "none 2",
        "LC 1",
        "LC 2",
        "OPT 1",
        "OPT+LC 1",
    }
    assert max(flow.rate_hz for flow in quick[0].scenario(0, 14.0).flows) == 50


async def test_a_carrier_hands_over_what_is_due_and_nothing_earlier():
    told = []

    class Group(dict):
        check = staticmethod(lambda: None)

        def order(self, names, **order):
            told.append((names, order["flow"], order["value"]))

    group, now_ns = Group(station=type("Process", (), {})()), time.time_ns()
    cell = stage.ros_cells(exp.config("quick"))[0]
    carrier = stage.RosCarrier(group, cell.scenario(0, 1.0), now_ns, 2.0)
    for flow, after_ms in (("late", 120), ("first", 20)):
        done_ns = now_ns + after_ms * 1_000_000
        group["station"].on_report({"is": "heard", "flow": flow, "value": 7, "done_ns": done_ns})
    for value in (5, 5, 6):
        carrier.set_value("robot1/lidar/0", value)
    assert (carrier.advance(50_000_000).flow, carrier.advance(50_000_000)) == ("first", None)
    assert time.time_ns() - now_ns >= 100_000_000, "half as fast"
    late = carrier.advance(10**9)
    assert (late.flow, late.value, late.now_ns) == ("late", 7, 60_000_000)
    await asyncio.sleep(0)
    assert told == [(["robot1"], "robot1/lidar/0", 5), (["robot1"], "robot1/lidar/0", 6)]
    carrier.over = True
    with pytest.raises(ProcessFailedError, match="broken off"):
        carrier.advance(2 * 10**9)


@pytest.mark.live
@pytest.mark.ros
@pytest.mark.netns
async def test_robots_set_off_on_what_real_nodes_carry():
    cell = next(c for c in stage.ros_cells(exp.config("quick")) if c.point.method == "OPT+LC")
    lossless = cell._replace(point=replace(cell.point, medium=Medium(loss=0.0)))
    async with live_hosts(*stage.ROBOTS, "station", ros=MODES[cell.preset]) as hosts:
        row, _ = await stage.drive_cell(hosts, lossless, 0, 4.0)
    assert row.wound > 0.002, "all three were told to go"
    assert row.held > 10


@pytest.mark.live
@pytest.mark.netns
@pytest.mark.slow
def test_three_robots_set_off_together_and_nothing_is_left_behind(monkeypatch):
    class UntilAllGo(stage.LiveDrive):
        def going(self):
            return {
                track.robot
                for track in self.tracks
                if track.t_s > 2.0 and track.manoeuvre == "forward"
            }

        def ended(self):
            return super().ended() or len(self.going()) == 3

    monkeypatch.setattr(stage, "LiveDrive", UntilAllGo)
    before = {child.pid for child in psutil.Process().children(recursive=True)}
    # How soon they get going depends on the machine's other work.
    drive = asyncio.run(stage.drive_live(stage.LIVE_POINT, 0, seconds=60.0))
    assert drive.verdict is None or drive.verdict.end is not End.CONTACT
    assert drive.going() == {"robot1", "robot2", "robot3"}
    assert drive.radio.delivered > 0
    assert {child.pid for child in psutil.Process().children(recursive=True)} <= before
