"""The experiment on cooperation: its settings, its reference log, the live lap, and the explorer."""

import asyncio
from dataclasses import asdict
from types import SimpleNamespace

import numpy as np
import pandas as pd
import psutil
import pytest
from made_logs import ran, reference

from sfglab.arp import hallway
from sfglab.arp.hallway import ROBOTS
from sfglab.arp.hallway.simulation import LAP_DEPTHS, LapSettings
from sfglab.arp.robots import RATES_HZ
from sfglab.lab.experiment import SkippedPartError
from sfglab.lab.experiments import cooperation
from sfglab.lab.experiments.cooperation import drawn, exp, experiment, explorer, live, results
from sfglab.processes import ProcessFailedError

REFERENCE = reference(exp)


def test_the_paper_s_profile_has_every_setting_once():
    settings = experiment.settings_of(exp.config("paper"))
    assert len(settings) == len(set(settings)) == len(RATES_HZ) * (3 * len(LAP_DEPTHS) + 4)


@pytest.mark.parametrize("lap", ["method == 'none' and seed == 2", "method == 'OPT+LC'"])
def test_a_lap_of_the_log_is_simulated_again_from_its_row(lap):
    logged = next(REFERENCE["course"].query(lap).itertuples())
    row = experiment.simulate_lap(experiment.settings_of_row(logged), logged.seed)
    assert all(getattr(logged, name) == value for name, value in asdict(row).items())


def test_the_reason_is_empty_without_failures_and_names_no_robot_that_did_not_fail():
    laps = cooperation.laps(REFERENCE)
    succeeded = laps[laps["success"]]
    assert not results._reason(succeeded)
    late = succeeded.assign(success=False, end="timeout")
    assert "fails in 1 of 1 laps: at a history" in results._reason(late)


def test_contacts_are_counted_by_robot():
    details = exp.measure(REFERENCE)["B-COOP"].details
    assert "contact in 72; by robot: robot1 in 42" in details["none, 72 laps"]


def test_the_difference_is_the_mean_over_rates_and_has_an_interval_where_no_lap_succeeds():
    rows = [("none", 100, False)] * 6 + [("none", 200, False)] * 2
    best = [("OPT+LC", 100, True)] * 3 + [("OPT+LC", 200, True), ("OPT+LC", 200, False)]
    table = pd.DataFrame(rows + best, columns=["method", "rate_max_hz", "success"])
    estimate = cooperation.difference(table)
    assert estimate.value == pytest.approx((1.0 + 0.5) / 2)
    assert estimate.low < estimate.value < estimate.high
    none = cooperation.difference(table.assign(success=False))
    assert none.low < none.value == 0 < none.high


def test_drawn_laps_are_the_paper_s_or_those_of_other_methods():
    def row(method, end):
        return SimpleNamespace(method=method, end=end)

    rows = [row("LC", "success"), row("CC", "contact"), row("OPT+LC", "success")]
    assert drawn.examples_of(rows) == {"success": rows[2], "failure": rows[1]}
    assert drawn.examples_of(rows[:1]) == {"success": rows[0]}


def test_a_drawn_lap_is_written_as_in_the_reference_log(tmp_path):
    new = ran(exp, tmp_path / "new.mcap", methods=("none",), depths=(1,))
    assert new.skipped("live") == "no live lap was asked for"
    for topic in ("/failure/robot2/pose", "/failure/robot3/scan"):
        messages = [repr(entry.message) for entry in new.messages(topic)]
        assert messages == [repr(entry.message) for entry in REFERENCE.messages(topic)]
    [walls] = new.messages("/failure/robot1/walls")
    [logged] = REFERENCE.messages("/failure/robot1/walls")
    assert walls.message.points == logged.message.points
    tracks = REFERENCE["track"].query("run == 'failure'").reset_index(drop=True)
    pd.testing.assert_frame_equal(new["track"], tracks)


# --- Live -------------------------------------------------------------------------------------


def test_a_live_lap_ends_when_the_station_stops_all():
    lap = live.LiveLap()
    pose = {"is": "pose", "t_s": 1.0, "pose": [1.0, 2.0, 0.5], "wound_rad": 0.2, "clearance_m": 0.3}
    lap.take("station", {"is": "released", "manoeuvre": "forward"})
    for robot in ROBOTS:
        lap.take(robot, pose)
    assert not lap.has_ended()
    lap.take("station", {"is": "stopped", "robot": 1})
    assert lap.has_ended()
    assert lap.verdict == hallway.Verdict(end=hallway.End.STOP, robot=1)
    tracks = [(track.robot, track.manoeuvre) for track in lap.tracks]
    assert tracks == [(robot, "forward") for robot in ROBOTS]


@pytest.mark.parametrize("failures", [1, 2])
def test_a_live_lap_that_fails_is_driven_once_more(monkeypatch, failures):
    begun = []

    async def drive_live(seed, *, limit_s):
        begun.append((seed, limit_s))
        if len(begun) <= failures:
            raise ProcessFailedError("it ended")
        return "the lap"

    monkeypatch.setattr(live, "drive_live", drive_live)
    lap = live.drive_again_if_failed(3, limit_s=9.0)
    if failures == 1:
        assert asyncio.run(lap) == "the lap"
    else:
        with pytest.raises(SkippedPartError, match="failed 2 times: it ended"):
            asyncio.run(lap)
    assert begun == [(3, 9.0)] * 2


@pytest.mark.live
@pytest.mark.netns
@pytest.mark.slow
def test_three_robots_set_off_together_and_no_process_is_left(monkeypatch):
    class UntilAllGo(live.LiveLap):
        def going(self):
            tracks = [track for track in self.tracks if track.t_s > 2.0]
            return {track.robot for track in tracks if track.manoeuvre == "forward"}

        def has_ended(self):
            return super().has_ended() or len(self.going()) == 3

    monkeypatch.setattr(live, "LiveLap", UntilAllGo)
    before = {child.pid for child in psutil.Process().children(recursive=True)}
    # How soon they get going depends on the machine's other work.
    lap, radio = asyncio.run(live.drive_live(0, limit_s=60.0))
    assert lap.verdict is None or lap.verdict.end is not hallway.End.CONTACT
    assert lap.going() == set(ROBOTS)
    assert radio.delivered > 0
    assert {child.pid for child in psutil.Process().children(recursive=True)} <= before


# --- Explorer ---------------------------------------------------------------------------------


def test_the_explorer_shows_the_lap_s_beginning_first_and_simulates_nothing_twice(monkeypatch):
    monkeypatch.setattr(explorer, "_COARSE_S", 0.0)
    shown = [picture for picture in cooperation.hallway_lap(seed=20) if picture]
    assert len(shown) == 2
    coarse, whole = shown
    assert "simulated up to" in coarse.said
    assert ": stop for an obstacle after " in whole.said
    monkeypatch.setattr(hallway.simulation.SimulatedLap, "_step", None)
    [later] = cooperation.hallway_lap(seed=20, shown_s=5.0)
    assert "At 5.0 s" in later.said


def test_the_explorer_draws_robots_where_the_lap_has_them_and_wrong_beams():
    *_, picture = cooperation.hallway_lap(shown_s=9.0)
    lap = explorer.lap_of(LapSettings(method="OPT+LC", rate_max_hz=100, depth=0), 0)
    snapshot = lap.snapshots[90]
    for number, panel in enumerate(picture.panels[:-1]):
        drawn_last = {series.name: series for series in panel.series}
        robot, beams = drawn_last[ROBOTS[number]], drawn_last["beams as measured"]
        assert [*robot.x, *robot.y] == snapshot.poses[number, :2].tolist()
        ranges_m = np.hypot(np.diff(beams.x), np.diff(beams.y))[::2]
        measured_m = snapshot.measured_m[number]
        np.testing.assert_allclose(ranges_m, measured_m[np.isfinite(measured_m)])


def test_time_counts_while_any_beam_is_wrong():
    turns = []
    for wrong in ([], [0, 2], [0], [2]):
        measured_m = np.full((3, 8), np.inf)
        believed_m = measured_m.copy()
        believed_m[wrong, 0] = 10.0
        turns.append(SimpleNamespace(measured_m=measured_m, believed_m=believed_m))
    lasting = explorer.wrong_for_s(turns)
    np.testing.assert_allclose(lasting.T, [[0, 0.1, 0.2, 0], [0] * 4, [0, 0.1, 0, 0.1]])


def test_the_axis_holds_the_longest_time_that_a_station_is_wrong():
    *_, picture = cooperation.hallway_lap(method="OPT", seed=1)
    panel = picture.panels[-1]
    longest_s = max(max(series.y) for series in panel.series)
    assert 11 < longest_s < panel.y.high
