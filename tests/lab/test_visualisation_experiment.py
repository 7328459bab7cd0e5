"""The visualisation experiment: what is wrong is seen. Its live run is that of its notebook."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from made_logs import ran, reference

from sfglab.errors import MissingExtraError
from sfglab.lab.experiments.visualisation import exp, plugin, points

pytest.importorskip("rerun", reason="the extra 'view' is not installed")


@pytest.mark.parametrize(
    ("broken", "fails"),
    [
        ("", []),
        ("session.Session.offers", ["offered for its type"]),
        ("session.Session.tune", ["shown, and tuned"]),
        ("session.Display.fail", ["one that fails is noted, and the other goes on"]),
    ],
)
def test_a_package_holds_and_a_mistake_of_the_view_is_seen(tmp_path, monkeypatch, broken, fails):
    if broken:
        monkeypatch.setattr(f"sfglab.view.{broken}", lambda *_: ())
    found = plugin.try_package(tmp_path)
    assert [name for name, held in found.items() if not held] == fails


def test_the_closed_form_inverts_the_projection_by_hand():
    depth = np.zeros((4, 8), np.uint16)
    depth[1, 2], depth[3, 7] = 2000, 12_000  # the second is too far
    rgb = np.arange(96, dtype=np.uint8).reshape(4, 8, 3)
    moment = points.Moment(number=0, rgb=rgb, depth_mm=depth)
    info = points.camera_info(None, (8, 4))
    (point,), (color,) = points.back_projected(moment, info, step=1, max_m=10.0)
    focal = info.k[0]
    assert np.allclose(point, [(2 - 3.5) * 2 / focal, (1 - 1.5) * 2 / focal, 2.0])
    assert np.array_equal(color, rgb[1, 2])


def test_points_are_those_of_the_closed_form_and_others_are_seen():
    [moment] = points.scene_moments(1, seed=0)
    ((stamp_ns, (shown, colors)),) = points.shown_points([moment]).items()
    row = points.compared(moment, (shown, colors))
    assert stamp_ns == moment.stamp_ns
    assert row.points > 10_000
    assert row.largest_error_m < points.TOLERANCE_M
    assert points.compared(moment, (shown + 1e-4, colors)).largest_error_m > points.TOLERANCE_M
    for wrong in ((shown, colors + np.uint8(1)), (shown[1:], colors[1:]), points.NO_POINTS):
        assert points.compared(moment, wrong).largest_error_m == np.inf
    empty = replace(moment, depth_mm=np.zeros_like(moment.depth_mm))
    assert points.compared(empty, points.NO_POINTS).largest_error_m == np.inf


def test_each_depth_gets_the_picture_of_its_stamp():
    moments = list(points.scene_moments(3, seed=0))
    shown = points.shown_points(moments)
    assert all(points.compared(one, shown[one.stamp_ns]).largest_error_m < 1e-5 for one in moments)
    first, second, _ = moments
    mixed = replace(second, rgb=first.rgb)
    assert points.compared(mixed, shown[second.stamp_ns]).largest_error_m == np.inf


def quiet_run(*, tail_ms=0.0):
    """Return the reference run, where a picture takes 2 ms, by the bridge 3 ms, two of a hundred longer."""
    run = reference(exp)
    times = run.table("time")
    bridge = times["arm"] == "bridge"
    times["taken_ms"] = 2.0 + bridge + tail_ms * (bridge & (times.index % 50 == 0))
    return run


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ("fails", "a plug-in of another package: 2 of 4: what was seen"),
        ("missing", "a plug-in of another package: 0 of 1: nothing to check"),
        (
            "late",
            "the bridge adds less than 5 ms to the median and to the 99th percentile: 1 of 2: 99th percentile: 21.0 ms",
        ),
    ],
)
def test_the_claim_is_the_fact_that_is_worst(change, reason):
    run = quiet_run(tail_ms=20.0 if change == "late" else 0.0)
    table = run.table("check")
    of_plugin = table["check"] == "a plug-in of another package"
    if change == "fails":
        table.loc[of_plugin, ["held", "example"]] = [2, "what was seen"]
    if change == "missing":
        table.loc[of_plugin, "check"] = "another"
    measured = exp.measure(run)["A-VIZ"]
    assert measured.estimate.value == (0.0 if change == "missing" else 0.5)
    assert (measured.reason, measured.count) == (reason, "lowest of 6 facts")


def test_without_rerun_the_run_says_so_and_leaves_no_log(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match="the view needs 'rerun'"):
        ran(exp, tmp_path / "a.mcap")
    assert not list(tmp_path.glob("*.mcap"))
