"""The experiment on cooperation: its settings, its reference log, the live lap, and the explorer."""

import asyncio
from contextlib import closing
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
from sfglab.lab.explore import explore
from sfglab.lab.explore.interactive import argument_texts
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


def test_the_channel_is_full_without_a_method_and_free_with_the_best_one():
    laps = cooperation.laps(REFERENCE)
    utilisation = laps.groupby("method")["airtime"].agg(["min", "max"])
    assert utilisation.loc["none", "min"] > 0.99
    assert utilisation.loc["OPT+LC", "max"] < 0.3


def test_the_reason_counts_failures_and_is_empty_without_any():
    [measured] = exp.measure(REFERENCE).values()
    assert "fails in 23 of 24 laps: at a history depth of 5" in measured.reason
    laps = cooperation.laps(REFERENCE)
    assert not results._reason(laps[laps["success"]])


def test_the_difference_is_the_mean_over_rates():
    rows = [("none", 100, False)] * 4 + [("none", 200, True), ("none", 200, False)]
    rows += [("OPT+LC", 100, True)] * 3 + [("OPT+LC", 200, True)] * 2
    table = pd.DataFrame(rows, columns=["method", "rate_max_hz", "success"])
    estimate = cooperation.difference(table)
    assert estimate.value == pytest.approx(1.0 - (0.0 + 0.5) / 2)
    assert estimate.low <= estimate.value <= estimate.high


def test_contacts_and_stops_are_counted_apart_and_by_robot():
    laps = cooperation.laps(REFERENCE)
    ends = cooperation.endings(laps)
    assert ends.iloc[:, :4].sum(axis=1).to_dict() == laps.groupby("method").size().to_dict()
    assert ends.loc["none"].tolist() == [0, 72, 0, 0, 42, 15, 15]
    assert ends.loc["OPT+LC"].tolist() == [1, 3, 19, 1, 11, 5, 6]
    details = exp.measure(REFERENCE)["B-COOP"].details
    assert "contact in 72; by robot: robot1 in 42" in details["none, 72 laps"]


def test_the_difference_has_an_interval_where_no_lap_succeeds():
    estimate = cooperation.difference(cooperation.laps(REFERENCE))
    assert estimate.value == pytest.approx(1 / 24)
    assert estimate.low < 0
    assert estimate.high == pytest.approx(0.202, abs=1e-3)


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
    tracks = REFERENCE["track"].query("run == 'failure'").reset_index(drop=True)
    pd.testing.assert_frame_equal(new["track"], tracks)
    [walls] = new.messages("/failure/robot1/walls")
    [old] = REFERENCE.messages("/failure/robot1/walls")
    assert walls.message.points == old.message.points


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
    assert [track.robot for track in lap.tracks] == list(ROBOTS)
    assert {track.manoeuvre for track in lap.tracks} == {"forward"}


@pytest.mark.parametrize(("failures", "driven"), [(0, 1), (1, 2), (2, 2)])
def test_a_live_lap_that_fails_is_driven_once_more(monkeypatch, failures, driven):
    begun = []

    async def drive_live(seed, *, limit_s):
        begun.append(seed)
        if len(begun) <= failures:
            raise ProcessFailedError("it ended")
        return "the lap", limit_s

    monkeypatch.setattr(live, "drive_live", drive_live)
    lap = live.drive_again_if_failed(3, limit_s=9.0)
    if failures < driven:
        assert asyncio.run(lap) == ("the lap", 9.0)
    else:
        with pytest.raises(SkippedPartError, match="failed 2 times: it ended"):
            asyncio.run(lap)
    assert begun == [3] * driven


def test_the_live_lap_is_shown_with_its_end_and_whether_it_kept_its_schedule():
    figure, _ = exp.draw("cooperation_live", REFERENCE)
    assert "kept its schedule" in figure.get_suptitle()
    assert [axes.get_title() for axes in figure.axes] == ["live: success", "simulated: success"]


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


def test_the_explorer_s_form_has_a_control_for_each_parameter_and_follows_the_time():
    pytest.importorskip("altair", reason="the extra view is not installed")
    with closing(explore(exp)) as shown:
        shown.form.controls["shown_s"].value = 4.0
        assert shown.wait(60)
        assert "At 4.0 s" in shown.picture.said
        assert len(shown._figure.rows["path0"]) > 50
        assert set(shown.form.controls) == set(argument_texts(cooperation.hallway_lap))


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
    for number, panel in enumerate(picture.panels[:-1]):
        drawn_last = {series.name: series for series in panel.series}
        robot, beams = drawn_last[ROBOTS[number]], drawn_last["beams as measured"]
        assert [*robot.x, *robot.y] == lap.snapshots[90].poses[number, :2].tolist()
        ranges_m = np.hypot(np.diff(beams.x), np.diff(beams.y))[::2]
        measured_m = lap.snapshots[90].measured_m[number]
        np.testing.assert_allclose(ranges_m, measured_m[np.isfinite(measured_m)])


def test_time_counts_while_any_beam_is_wrong():
    def snapshot(*apart_m):
        measured_m = np.full((3, 8), np.inf)
        believed_m = measured_m.copy()
        believed_m[:, 0] = [10.0 if wrong else np.inf for wrong in apart_m]
        return SimpleNamespace(measured_m=measured_m, believed_m=believed_m)

    turns = [snapshot(0, 0, 0), snapshot(1, 0, 1), snapshot(1, 0, 0), snapshot(0, 0, 1)]
    lasting = explorer.wrong_for_s(turns)
    np.testing.assert_allclose(lasting.T, [[0, 0.1, 0.2, 0], [0] * 4, [0, 0.1, 0, 0.1]])


def test_the_axis_holds_the_longest_time_that_a_station_is_wrong():
    *_, picture = cooperation.hallway_lap(method="OPT", seed=1)
    panel = picture.panels[-1]
    longest_s = max(max(series.y) for series in panel.series)
    assert 11 < longest_s < panel.y.high
