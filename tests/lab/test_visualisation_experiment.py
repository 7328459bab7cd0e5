"""The visualisation experiment: everything that is wrong is seen. Its live run is that of its notebook."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_logs import ran, reference

from sfglab.errors import MissingExtraError, SfglabError
from sfglab.lab.checks import fleet_scene, handling, synchronisation
from sfglab.lab.checks.recordings import Shown, check_sources, check_visualizers, read_recording
from sfglab.lab.checks.synchronisation import Cloud, check_clouds
from sfglab.lab.experiments.visualisation import checks, exp
from sfglab.lab.experiments.visualisation.experiment import check_memory
from sfglab.lab.experiments.visualisation.stage import BOUND_BYTES
from sfglab.view import Latest
from sfglab.view.session import BUILT_IN
from sfglab.view.sync import synchronizer

sys.path.append(str(Path(__file__).parents[2] / "tools"))

import screenshots

pytest.importorskip("rerun", reason="the extra 'view' is not installed")


@pytest.fixture(scope="module")
def moments():
    return fleet_scene.scene_moments(2, seed=0)


@pytest.fixture(scope="module")
def parts(moments):
    return [part for part in fleet_scene.make_parts(moments) if part.expected]


def recorded(parts):
    """What a perfect view would have recorded."""
    found = {}
    for part in parts:
        rows = []
        for number, values in enumerate(part.expected):
            stamp_ns = fleet_scene.START_NS + number * fleet_scene.PERIOD_NS
            received_ns = stamp_ns + fleet_scene.RECEIVED_AFTER_NS
            captured_ns = received_ns if part.type.endswith("MarkerArray") else stamp_ns
            times = (None, None) if part.is_timeless else (captured_ns, received_ns)
            rows.append(Shown(capture_ns=times[0], received_ns=times[1], content=values))
        found[part.place] = rows
    return found


def wrong(rows):
    return [row.check.partition(":")[0] for row in rows if row.held < row.checked]


def changed(recording, part, **changes):
    first, *others = recording[part.place]
    return {**recording, part.place: [replace(first, **changes), *others]}


def test_every_visualizer_that_there_is_has_its_part_in_the_scene(moments):
    assert {part.kind for part in fleet_scene.make_parts(moments)} == {
        kind.name for kind in BUILT_IN
    }


def test_a_perfect_recording_passes_and_whatever_is_changed_in_it_is_found(parts):
    perfect = recorded(parts)
    assert wrong(check_visualizers(tuple(parts), perfect)) == []
    for part in parts:
        first = part.expected[0]
        values = ["else"] if isinstance(first, list) else np.asarray(first) + 1
        assert wrong(check_visualizers(tuple(parts), changed(perfect, part, content=values))) == [
            part.kind
        ]
        late = changed(perfect, part, capture_ns=7)
        assert wrong(check_visualizers(tuple(parts), late)) == [part.kind]
        assert wrong(check_visualizers(tuple(parts), {**perfect, part.place: []})) == [part.kind]
        twice = {key: rows * 2 for key, rows in perfect.items()}
        assert len(wrong(check_visualizers(tuple(parts), twice))) == len(parts)


def test_what_the_bus_shows_otherwise_than_the_log_is_found(parts):
    logged, image = recorded(parts), parts[0]
    assert wrong(check_sources(tuple(parts), logged, logged)) == []
    other = changed(logged, image, content=np.asarray(image.expected[1]))
    assert wrong(check_sources(tuple(parts), logged, other)) == ["image"]
    assert wrong(check_sources(tuple(parts), logged, {**logged, image.place: []})) == ["image"]


def test_a_plugin_that_breaks_others_would_be_found(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    assert wrong([handling.check_plugins(tmp_path / "a")]) == []
    monkeypatch.setattr(handling, "_ENTRIES", "battery = {0}:Battery\nbroken = {0}:Broken\n")
    (tmp_path / "b").mkdir()
    assert "one that cannot be loaded is told" in handling.check_plugins(tmp_path / "b").example


def test_streams_that_are_not_synchronised_are_found(monkeypatch):
    monkeypatch.setattr(
        synchronisation, "synchronizer", lambda _, topics, **_more: synchronizer(Latest(), topics)
    )
    found = wrong(synchronisation.checks.rows(3, seed=1))
    assert found[:2] == ["exact time", "approximate time"]
    assert len(found) == len(synchronisation.checks.names), "every check sees it"


def test_the_reference_inverts_the_projection_by_hand():
    depth = np.zeros((4, 8), np.uint16)
    depth[1, 2], depth[3, 7] = 2000, 12_000  # the second is too far
    info = fleet_scene.camera_info(None, (8, 4))
    (point,) = fleet_scene.back_projected(depth, info, step=1, max_m=10.0)
    focal = info.k[0]
    assert np.allclose(point, [(2 - 3.5) * 2 / focal, (1 - 1.5) * 2 / focal, 2.0])


def test_points_or_colours_that_are_off_are_found(moments):
    expected = np.ones((3, 3))
    colors = np.zeros((3, 3), np.uint8)
    good = Cloud(
        moment=moments[0], shown=expected, colors=colors, expected=expected, expected_colors=colors
    )
    bad = [
        replace(good, shown=expected + 1e-4),
        replace(good, shown=expected[:2], colors=colors[:2]),
        replace(good, colors=colors + np.uint8(1)),
    ]
    check = check_clouds([good, *bad])
    assert (check.checked, check.held) == (4, 1)


def memory(**changes):
    rows = {
        "at_s": [0.0, 1.0, 2.0, 3.0],
        "stopped": [False, True, True, False],
        "queued_bytes": [0, 10, BOUND_BYTES, 0],
        "resident_bytes": [0] * 4,
        "received": [0, 10, 20, 30],
        "shown": [0, 10, 10, 15],
        "dropped": [0, 0, 10, 15],
    }
    return pd.DataFrame({**rows, **changes})


@pytest.mark.parametrize(
    ("changes", "held"),
    [
        ({}, 3),
        ({"queued_bytes": [0, 10, BOUND_BYTES + 1, 0]}, 2),
        ({"dropped": [0, 0, 10, 12]}, 2),
        ({"shown": [0, 10, 10, 10], "dropped": [0, 0, 10, 20]}, 2),
    ],
)
def test_unbounded_waiting_or_pictures_that_vanish_fail_the_check(changes, held):
    row = check_memory(memory(**changes))
    assert (row.checked, row.held) == (3, held)


def quiet_run(*, tail_ms=0.0):
    """Return the reference run, where a picture takes 2 ms, by the bridge 3 ms, two of a hundred longer."""
    run = reference(exp)
    times = run.table("time")
    bridge = times["arm"] == "bridge"
    times["taken_ms"] = 2.0 + bridge + tail_ms * (bridge & (times.index % 50 == 0))
    return run


def test_the_claim_is_the_group_that_is_worst_and_a_tail_fails_it():
    assert exp.measure(quiet_run())["A-VIZ"].estimate.value == 1.0
    run = quiet_run()
    table = run.table("check")
    table.loc[table["group"] == "plugins", ["checked", "held", "example"]] = [2, 1, "what was seen"]
    assert list(checks(run)["group"])[-2:] == ["memory", "latency"]
    for worst, reason in (
        (run, "a package's visualizers through entry points: 1 of 2: what was seen"),
        (
            quiet_run(tail_ms=20.0),
            "what the bridge adds to a picture's way: 1 of 2: 99 %: 21.0 of 5 ms",
        ),
    ):
        measured = exp.measure(worst)["A-VIZ"]
        assert (measured.estimate.value, measured.reason) == (0.5, reason)


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
        assert shown[f"/agents/{agent}/communication/life", "StateChange:state"][-1].content == [
            life
        ]
    assert {entity for entity, _ in shown} >= {"/tf/go2/base", "/tf/pi1/base", "/fleet/border"}
