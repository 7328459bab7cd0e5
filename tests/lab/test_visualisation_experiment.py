"""The visualisation experiment: what is wrong is seen. Its live run is that of its notebook."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_logs import ran, reference

from sfglab.errors import MissingExtraError, SfglabError
from sfglab.lab.experiments.visualisation import exp, facts, plugin, scene
from sfglab.lab.experiments.visualisation.points import Cloud, show_clouds
from sfglab.lab.experiments.visualisation.recordings import read_recording

sys.path.append(str(Path(__file__).parents[2] / "tools"))

import screenshots

pytest.importorskip("rerun", reason="the extra 'view' is not installed")


def test_a_package_holds_and_one_whose_mistake_is_not_told_does_not(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    assert all(plugin.try_package(tmp_path / "a").values())
    entries = plugin._ENTRY_POINTS.replace("gone = ", "other = ").replace(":Gone", ":Battery")
    monkeypatch.setattr(plugin, "_ENTRY_POINTS", entries)
    (tmp_path / "b").mkdir()
    wrong = [name for name, held in plugin.try_package(tmp_path / "b").items() if not held]
    assert wrong == ["one that cannot be loaded is told"]


def test_the_closed_form_inverts_the_projection_by_hand():
    depth = np.zeros((4, 8), np.uint16)
    depth[1, 2], depth[3, 7] = 2000, 12_000  # the second is too far
    info = scene.camera_info(None, (8, 4))
    (point,) = scene.back_projected(depth, info, step=1, max_m=10.0)
    focal = info.k[0]
    assert np.allclose(point, [(2 - 3.5) * 2 / focal, (1 - 1.5) * 2 / focal, 2.0])


def test_the_points_of_a_recording_are_those_of_the_closed_form(tmp_path):
    (cloud,) = show_clouds(scene.scene_moments(1, seed=0), tmp_path / "a.rrd")
    assert len(cloud.shown) == len(cloud.expected) > 10_000
    assert cloud.errors_m.max() < 1e-5
    assert cloud.wrong_colors == 0


def test_points_or_colours_that_are_off_are_seen():
    expected = np.ones((3, 3))
    colors = np.zeros((3, 3), np.uint8)
    good = Cloud(
        moment=None, shown=expected, colors=colors, expected=expected, expected_colors=colors
    )
    assert (good.errors_m.max(), good.wrong_colors) == (0.0, 0)
    assert replace(good, shown=expected + 1e-4).errors_m.max() > 1e-5
    fewer = replace(good, shown=expected[:2], colors=colors[:2])
    assert (len(fewer.errors_m), fewer.wrong_colors) == (0, 3)
    assert replace(good, colors=colors + np.uint8(1)).wrong_colors == 3


def quiet_run(*, tail_ms=0.0):
    """Return the reference run, where a picture takes 2 ms, by the bridge 3 ms, two of a hundred longer."""
    run = reference(exp)
    times = run.table("time")
    bridge = times["arm"] == "bridge"
    times["taken_ms"] = 2.0 + bridge + tail_ms * (bridge & (times.index % 50 == 0))
    return run


def test_a_log_from_before_the_facts_has_them_by_its_checks():
    run = quiet_run()
    assert list(facts(run)["held"]) == [8, 7, 3, 2, 10, 2]
    assert exp.measure(run)["A-VIZ"].estimate.value == 1.0


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ("fails", "a plug-in of another package: 4 of 8: what was seen"),
        ("missing", "a plug-in of another package: 0 of 1: nothing to check"),
        ("late", "the delay of the bridge is within its bound: 1 of 2: 99 %: 21.0 of 5 ms"),
    ],
)
def test_the_claim_is_the_fact_that_is_worst(change, reason):
    run = quiet_run(tail_ms=20.0 if change == "late" else 0.0)
    table = run.table("check")
    of_plugin = table["check"] == "a package's visualizers through entry points"
    if change == "fails":
        table.loc[of_plugin, ["held", "example"]] = [4, "what was seen"]
    if change == "missing":
        table.loc[of_plugin, "check"] = "another"
    measured = exp.measure(run)["A-VIZ"]
    assert measured.estimate.value == (0.0 if change == "missing" else 0.5)
    assert (measured.reason, measured.count) == (reason, "6 facts")


def test_without_rerun_the_run_says_so_and_leaves_no_log(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match="the view needs 'rerun'"):
        ran(exp, tmp_path / "a.mcap")
    assert not list(tmp_path.glob("*.mcap"))


def test_without_a_driver_there_is_no_screenshot_but_one_sentence(tmp_path, monkeypatch):
    for name in screenshots._NAMED_DRIVERS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(screenshots, "_DRIVERS", (str(tmp_path / "icd.d"),))
    with pytest.raises(
        SfglabError, match="needs a Vulkan driver, such as the package mesa-vulkan-drivers"
    ):
        screenshots.main(tmp_path, ["viewer"])
    assert not list(tmp_path.iterdir())


def test_the_fleet_of_the_screenshot_has_its_cloud_its_lost_agent_and_nothing_that_fails(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(screenshots, "_MOMENTS", 16)
    path = tmp_path / "fleet.rrd"
    screenshots.record_fleet(path)
    shown = read_recording(path)
    root = "/agents/go2/global/camera_front/aligned_depth/compressed_depth"
    assert len(shown[f"{root}/cloud", "Points3D:positions"]) == 16
    assert len(shown[root, "DepthImage:buffer"]) == 16
    for agent, life in (("go2", "alive"), ("pi3", "late")):
        states = shown[f"/agents/{agent}/heartbeat/life", "StateChange:state"]
        assert states[-1].content == [life]
    assert {entity for entity, _ in shown} >= {"/tf/go2/base", "/tf/pi1/base"}
