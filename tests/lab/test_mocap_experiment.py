"""The mocap experiment: each error of a tree breaks its check. Its live run is that of its notebook."""

from dataclasses import asdict

import pytest
from made_logs import broken, made_run

from sfglab.lab.checks import trees
from sfglab.lab.experiments.mocap import checks, exp
from sfglab.lab.experiments.mocap.experiment import live_rows
from sfglab.spatial import Pose

JOINED = trees.join_trees(*trees.figure_6(), trees.captures_of([Pose()]))
EDGES = [{"way": way, **asdict(edge)} for way, tree in JOINED.items() for edge in tree.edges]
LOOK = {"at_s": 1.0, "wait_ms": 15.0, "error_mm": 1.0, "error_mrad": 1.0, "latest_mm": 15.0}
TRIES = {"proxy": {"found": 4}, "direct": {"E": 4}, "renamed": {"E": 4}}
PERFECT = {
    "looks": [LOOK] * 4,
    "tries": TRIES,
    "edges": EDGES,
}


@pytest.fixture
def made(tmp_path):
    """Give a function that returns a run as its log would give it, from what a perfect live run reports."""

    def make(*, held=9, **changed):
        exact = {"check": "proxy: nothing is found wrong", "checked": 9, "held": held}
        tables = {
            "edge": [{"where": "figure 6", **edge} for edge in EDGES],
            "check": [exact],
        }
        names = {row_class: table for table, row_class in exp.tables.items()}
        for row in live_rows(PERFECT | changed):
            tables.setdefault(names[type(row)], []).append(asdict(row))
        return made_run(exp, tmp_path / "m.mcap", tables, config=exp.config())

    return make


def claim(run):
    return exp.measure(run)["A-VICON"]


def test_a_perfect_run_holds_everywhere_and_the_claim_is_one(made):
    run = made()
    assert broken(checks(run)) == {}
    assert (claim(run).estimate.value, claim(run).how.value, claim(run).reason) == (1.0, "live", "")


def edges(way, child, change, *, static=None):
    """Return all edges, those of one frame changed, or without them."""
    found = []
    for edge in EDGES:
        is_chosen = (edge["way"], edge["child"]) == (way, child)
        if not is_chosen or static not in (None, edge["static"]):
            found.append(edge)
        elif change:
            found.append(edge | change)
    return {"edges": found}


FAULTS = {
    "proxy: each look-up is answered": {"looks": [LOOK | {"wait_ms": float("nan")}]},
    "proxy: the camera is within 20 mm of its true position": {"looks": [LOOK | {"error_mm": 99.0}]},
    "proxy: the tree as received is whole": edges("proxy", "agent_x/base", {"parent": "map2"}),
    "proxy: the robot's own edges are as without": edges("proxy", "agent_x/camera", None),
    "direct: the tree as received has two roots": edges("direct", "agent_x_markers", {"parent": "agent_x/base"}),
    "direct: what is published is no frame of the robot": edges("direct", "agent_x_markers", {"child": "agent_x/seen"}),
    "renamed: the markers have two parents": edges("renamed", "agent_x/markers", None, static=True),
    "direct: no look-up from the world to the camera is answered": {"tries": TRIES | {"direct": {"E": 3, "found": 1}}},
}  # fmt: skip


@pytest.mark.parametrize("check", FAULTS)
def test_each_fault_breaks_its_check_and_the_claim(made, check):
    run = made(**FAULTS[check])
    assert f"live, {check}" in broken(checks(run))
    assert claim(run).estimate.value < 1


def test_many_live_checks_do_not_hide_an_exact_one(made):
    assert claim(made(held=0)).estimate.value == 0


def test_a_run_that_received_nothing_has_not_shown_anything_and_is_drawn(made):
    tries = {way: {"E": 1} for way in trees.WAYS}
    never = dict.fromkeys(LOOK, float("nan")) | {"at_s": 1.0}
    run = made(looks=[never], tries=tries, edges=[])
    assert len(broken(checks(run))) == 7, "all but the two on look-ups that fail"
    assert set(exp.figures(run)) == {"mocap_error", "mocap_trees"}


def test_all_checks_of_trees_are_asked_of_random_robots_and_hold():
    asked = set()
    for one in trees.joined(20, 1):
        found = trees.checked(one)
        assert all(found.values()), one.name
        asked |= found.keys()
    assert asked == set(trees.CHECKS)


@pytest.mark.parametrize(
    ("way", "other", "check"),
    [
        ("direct", "proxy", "direct: what is published is no frame of the robot"),
        ("renamed", "proxy", trees.TWO_PARENTS),
        ("proxy", "direct", "proxy: nothing is found wrong"),
        ("renamed", "direct", trees.AT_THE_ROOT),
    ],
)
def test_a_robot_whose_tree_is_joined_in_another_way_fails_a_check(monkeypatch, way, other, check):
    join_trees = trees.join_trees

    def mistaken(*given):
        found = join_trees(*given)
        return {**found, way: found[other]}

    monkeypatch.setattr(trees, "join_trees", mistaken)
    assert not any(trees.CHECKS[check](one) for one in trees.joined(20, 1))
