"""The phase diagram: its conditions and its answers are the criteria's, its borders are refined."""

import asyncio

import numpy as np
import pandas as pd
import pytest

from sfglab.lab.experiments.phases import exp, shares
from sfglab.lab.experiments.phases.answers import PLACE, answers, plausible
from sfglab.lab.experiments.phases.experiment import conditions, midpoints
from sfglab.lab.experiments.transmission.experiment import (
    HELLO_DOWN,
    HELLO_HOP,
    HELLO_UP,
    Point,
    hello_latency_ms,
    scenario_of,
)
from sfglab.rtps import Fate, FlowOutcome, Medium, run
from sfglab.rtps.session import age_ms
from sfglab.units import NS_PER_S


def test_there_are_432_conditions_and_27_of_the_criterion_for_each_mode_and_rate():
    assert len(conditions(exp.config("paper", criterion=False, rates_hz=(500,)))) == 432
    found = pd.DataFrame(plausible(), columns=PLACE)
    assert (found.groupby(["preset", "rate_max_hz"]).size() == 27).all()
    assert found["loss"].unique() == pytest.approx([0.0003, 0.001732, 0.01])
    assert sorted(found["stall_ms"].unique()) == [0, 50, 100]


def tables(best_ms, small_ms, arrived, ends):
    place = dict(zip(PLACE, ("cyclone_dds", 0.01, 50.0, "block", 0.0, 500), strict=True))
    rows = {("none", "1"): small_ms, ("none", "1000"): 20.0, ("OPT+LC", "opt"): best_ms}
    cells = [
        place
        | {
            "method": m,
            "depth": d,
            "seed": seed,
            "published": 100,
            "age_ms": 1.0,
            "p50_ms": ms + seed / 9,
            "pooled_ms": ms,
        }
        | {"arrived": arrived if m == "OPT+LC" else 50 if d == "1" else 90}
        for (m, d), ms in rows.items()
        for seed in range(6)
    ]
    courses = [
        place | {"method": m, "depth": 1, "seed": 0, "end": e}
        for m, e in zip(("OPT+LC", "none"), ends, strict=True)
    ]
    return pd.DataFrame(cells), pd.DataFrame(courses)


@pytest.mark.parametrize(
    ("best_ms", "small_ms", "arrived", "expected"),
    [
        (10.0, 30.0, 95, (True, True, True, True)),
        (20.9, np.inf, 89, (True, True, True, True)),  # within 5 % and within a point
        (22.0, 20.1, 80, (False, False, False, True)),  # intervals over seeds overlap
        (np.inf, np.inf, 0, (False, False, True, True)),
    ],
)
def test_a_condition_answers_as_the_criteria_ask(best_ms, small_ms, arrived, expected):
    [row] = answers(*tables(best_ms, small_ms, arrived, ("success", "contact"))).to_dict("records")
    asked = ("latency_lowest", "loss_lowest", "latency_small", "loss_small")
    assert tuple(row[name] for name in asked) == expected
    assert (row["lc_lowest"], row["completed"], row["completed_none"]) == (sum(expected[:2]) / 2, 1, 0)


def test_between_unlike_neighbours_and_only_there_is_a_midpoint():
    config = exp.config("smoke")
    answer = {"lc_lowest": 1.0, "small_worst": 0.0, "completed_none": 0.0}
    rows = [
        dict(zip(PLACE, ("cyclone_dds", loss, frame, "block", 0.0, 500), strict=True))
        | answer
        | {"completed": done}
        for loss, frame, done in ((0.01, 50.0, 1.0), (0.01, 200.0, 1.0), (0.01, 800.0, 0.0), (0.04, 50.0, 1.0))
    ]
    [between] = midpoints(pd.DataFrame(rows), config, most=9)
    assert (between.loss, between.frame_us) == (0.01, 400.0)
    assert midpoints(pd.DataFrame(rows), config, most=0) == []


def test_age_is_half_a_period_and_the_way_and_grows_where_nothing_arrives():
    published = np.arange(0, 10, 0.1)
    at = {"name": "a", "published_ns": (published * NS_PER_S).astype(np.int64), "value": np.ones(100, np.int32)}
    at |= {"received_ns": at["published_ns"] + 20_000_000, "dropped": np.zeros(100, np.int8)}
    there, never = (
        FlowOutcome(fate=np.full(100, fate, np.int8), **at) for fate in (Fate.DELIVERED, Fate.UNDERWAY)
    )
    assert age_ms(there, duration_s=10) == pytest.approx(50 + 20, abs=0.5)
    assert age_ms(never, duration_s=10) == pytest.approx(5000)


def test_hello_goes_by_robot_3_where_asked_and_values_have_the_size_and_the_planning_the_time_asked():
    plain, printed = (
        Point(rate_max_hz=100, depth="10", method="none", duration_s=1, hop=hop) for hop in (False, True)
    )
    quiet = Medium(loss=0.0, rate_bps=1e12, overhead_s=1e-3, contention=0.0)
    flows = {flow.name: flow for flow in scenario_of(printed).flows}
    assert [flows[name].target for name in (HELLO_UP, HELLO_HOP, HELLO_DOWN)] == ["station", "robot3", "robot1"]
    short, long = (hello_latency_ms(run(scenario_of(p, medium=quiet), seed=0)) for p in (plain, printed))
    assert len(short) == len(long) == 100
    assert np.quantile(long, 0.1) - np.quantile(short, 0.1) > 0.9, "a crossing more"
    slow = Point(rate_max_hz=100, depth="10", method="none", duration_s=1, sizes="cdr", slower=4.0)
    table, cdr = ({f.name: f for f in scenario_of(p).flows}["robot1/lidar"] for p in (plain, slow))
    assert (table.size_bytes, cdr.size_bytes, cdr.service_s / table.service_s) == (24, 8, 4)


def test_a_small_run_is_refined_and_drawn(tmp_path):
    found = asyncio.run(exp.run("smoke", path=tmp_path / "a.mcap"))
    assert len(found["cell"]) == 14 * len(found["course"]) / 4
    assert set(found["course"]["frame_us"]) == {50.0, 245.0, 1200.0}
    assert set(exp.figures(found)) == {"phases", "phases_cells"}
    assert shares(found)["conditions"].tolist() == [3, 1]
