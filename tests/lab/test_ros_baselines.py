"""Real ROS 2 beside our stand-ins, as experiments measure it: few nodes find each other, pictures arrive."""

import asyncio

import pytest

from sfglab.lab.baselines import PART, REAL, STAND_IN, beside, compared
from sfglab.lab.bench import Options
from sfglab.lab.experiments import decode_once, discovery, latency

pytestmark = [pytest.mark.live, pytest.mark.ros, pytest.mark.netns]

CASES = [
    (discovery.exp, {"timeout_s": 60.0}, {REAL, STAND_IN, "routed"}),
    (latency.exp, {}, {REAL, STAND_IN}),
    (decode_once.exp, {}, {REAL, STAND_IN}),
]


@pytest.mark.parametrize(("exp", "changes", "kinds"), CASES, ids=lambda case: getattr(case, "name", ""))
def test_a_smoke_run_measures_both_sides(tmp_path, exp, changes, kinds):
    options = Options(only=frozenset({PART}))
    run = asyncio.run(exp.run("smoke", path=tmp_path / "smoke.mcap", options=options, **changes))
    assert run.skipped(PART) == ""
    rows = beside(exp, run)
    assert set(rows["kind"]) == kinds
    assert (rows["value"] > 0).all()
    if exp is discovery.exp:  # nobody was given up
        assert (rows[rows["quantity"].str.startswith("until")]["value"] < 60).all()
    assert set(compared(exp, run)["quantity"]) == set(rows["quantity"])
    assert exp.draw(f"{exp.name}_{PART}", run)[1]["apart"] == ""


@pytest.mark.parametrize(("exp", "none"), [(latency.exp, 0), (decode_once.exp, ())])
def test_who_asks_for_no_subscriber_is_told_so(tmp_path, exp, none):
    options = Options(only=frozenset({PART}))
    run = asyncio.run(exp.run("smoke", path=tmp_path / "smoke.mcap", options=options, ros2=none))
    assert run.skipped(PART) == "ros2: none was asked for"
