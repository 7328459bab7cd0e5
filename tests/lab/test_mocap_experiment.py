"""The mocap experiment: each fault of a tree breaks its check. Its live run is that of its notebook."""

from dataclasses import asdict, replace

import pandas as pd
import pytest
from made_logs import broken, made_run

from sfglab.lab.checks import trees
from sfglab.lab.experiments.mocap import checks, exp, recordings
from sfglab.lab.experiments.mocap.experiment import live_rows
from sfglab.lab.workers.mocap import motions, world_from_camera
from sfglab.spatial import Pose
from sfglab.spatial.mocap.bridge import mocap_trees

JOINED = mocap_trees(*trees.figure_6(), trees.captures_of([Pose()]))
EDGES = [{"way": way, **asdict(edge)} for way in trees.WAYS for edge in getattr(JOINED, way).edges]
LOOK = dict.fromkeys(exp.tables["look"].__dataclass_fields__.keys() - {"round"}, 15.0) | {
    "error_mm": 1.0
}
TRIES = {"proxy": {"found": 4}, "direct": {"E": 4}, "renamed": {"E": 4}}
PERFECT = {
    "looks": [LOOK] * 4,
    "tries": TRIES,
    "heard": [(10_000_000, 17_000_000, 18_000_000)],
    "edges": EDGES,
}


@pytest.fixture
def made(tmp_path):
    """Give a function that returns a run as its log would give it, from what a perfect live round reports."""

    def make(*, fault=1, **changed):
        reports = {
            "listener": PERFECT | changed,
            "bridge": {"receipts": [(10_000_000, 16_000_000, True)]},
        }
        tables = {
            "edge": [{"where": "figure 6", **edge} for edge in EDGES],
            "check": [
                {"check": "proxy: exact", "checked": 9, "held": 9},
                {"check": "faults: some", "checked": 1, "held": fault},
            ],
            "confusion": [{"truth": "flipped", "verdict": "flipped", "count": 3}],
        }
        for table, row in live_rows("faulty", 0.8, 0, 0, reports):
            tables.setdefault(table, []).append(row)
        return made_run(exp, tmp_path / "m.mcap", tables, config=exp.config(rounds=("faulty",)))

    return make


def claim(run):
    return exp.measure(run)["A-VICON"]


def test_a_perfect_run_holds_everywhere_and_the_claim_is_one(made):
    run = made()
    assert broken(checks(run)) == {}
    assert (claim(run).estimate.value, claim(run).how.value, claim(run).reason) == (1.0, "live", "")


def edges(way, child, change, *, static=None):
    """Return all edges, those of one frame changed, or without them."""
    chosen = [
        (e["way"], e["child"]) == (way, child) and static in (None, e["static"]) for e in EDGES
    ]
    return [
        e | (change or {}) if hit else e
        for e, hit in zip(EDGES, chosen, strict=True)
        if change or not hit
    ]


FAULTS = {
    "proxy: every look is answered": {"looks": [LOOK | {"wait_ms": float("nan")}]},
    "proxy: the camera is within 20 mm of the truth": {"looks": [LOOK | {"error_mm": 200.0}]},
    "proxy: the tree as heard is whole": {
        "edges": edges("proxy", "agent_x/base", {"parent": "map2"})
    },
    "proxy: the robot's own edges are as without": {
        "edges": edges("proxy", "agent_x/camera", None)
    },
    "direct: what is published is no frame of the robot": {
        "edges": edges("direct", "agent_x_markers", {"child": "agent_x/seen"})
    },
    "renamed: the markers have two parents": {
        "edges": edges("renamed", "agent_x/markers", None, static=True)
    },
    "direct: no look from the world to the camera is answered": {
        "tries": TRIES | {"direct": {"E": 3, "found": 1}}
    },
}


@pytest.mark.parametrize("check", FAULTS)
def test_each_fault_breaks_its_check_and_the_claim(made, check):
    run = made(**FAULTS[check])
    assert f"live, faulty, {check}" in broken(checks(run))
    assert claim(run).estimate.value < 1


def test_many_exact_checks_do_not_hide_a_fault(made):
    assert claim(made(fault=0)).estimate.value == 0


def test_flips_that_were_published_count_whether_or_not_a_listener_kept_them(made):
    run = made()
    seen = {"round": "faulty", "truth": "seen", "published": True, "count": 1}
    assert run["sight"].to_dict("records") == [seen]
    flips = pd.DataFrame(
        [seen | {"truth": "flipped", "published": p, "count": 3} for p in (True, False)]
    )
    run._known["table", "sight"] = flips.assign(log_time_ns=1), frozenset()
    assert broken(checks(run)).keys() == {"live, faulty, proxy: no flipped sight is published"}


def test_a_round_in_which_nothing_was_heard_has_not_shown_anything(made):
    run = made(looks=[], tries={way: {} for way in trees.WAYS}, heard=[], edges=[])
    live = [check for check in broken(checks(run)) if check.startswith("live")]
    assert len(live) == 8  # nothing is as nothing was


def test_a_bridge_that_believes_everything_fails_its_checks(monkeypatch):
    robot, mapping = trees.figure_6()
    lax = replace(mapping.limits, slack_rad=4.0, turn_rad=4.0)
    monkeypatch.setattr(recordings, "figure_6", lambda: (robot, replace(mapping, limits=lax)))
    monkeypatch.setattr(recordings, "_TURNED_RAD", 4.0 + recordings._TURNED_RAD)
    tally = recordings.confusion_of(1, 10.0, 0)
    assert tally.confusion["flipped", "sound"]
    *_, last = recordings.fault_checks(tally)
    published = recordings.published_check(tally.confusion)
    assert last.held < last.checked
    assert published.held == published.checked - tally.confusion["flipped", "sound"]


def test_the_chain_of_the_robot_s_frames_is_where_the_camera_really_is():
    (odom_from_base, _), later = motions(0, 0), world_from_camera(0, 10_000_000_000)
    assert odom_from_base.child == "agent_x/base"
    assert later.same_as(world_from_camera(0, 0), within_m=1.0, within_rad=2.0)
