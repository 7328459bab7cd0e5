"""The phase diagram: conditions and answers are the criteria's, borders are refined, verdicts follow."""

from functools import cache
from itertools import product

import numpy as np
import pandas as pd
import pytest
from made_logs import CLAIMS, ran

from sfglab.lab.claims import How, Measured, Verdict, entry_for
from sfglab.lab.experiments.phases import exp, shares
from sfglab.lab.experiments.phases.answers import ANSWERS, PLACE, answers, plausible
from sfglab.lab.experiments.phases.experiment import CELLS, COURSES, conditions, midpoints
from sfglab.lab.findings import Findings
from sfglab.lab.ledger import _judged, _Source
from sfglab.lab.runs import COMPLETION
from sfglab.lab.stats import exactly
from sfglab.rtps import Fate, FlowOutcome
from sfglab.rtps.session import age_ms
from sfglab.units import NS_PER_S


def test_there_are_432_conditions_and_27_of_the_criterion_for_each_mode_and_rate():
    assert len(conditions(exp.config("paper", criterion=False, rates_hz=(500,)))) == 432
    found = pd.DataFrame(plausible(), columns=PLACE)
    assert (found.groupby(["preset", "rate_max_hz"]).size() == 27).all()
    assert found["loss"].unique() == pytest.approx([0.0003, 0.001732, 0.01])
    assert sorted(found["stall_ms"].unique()) == [0, 50, 100]


def test_between_unlike_neighbours_and_only_there_is_a_midpoint():
    config = exp.config("smoke")
    answer = {"lc_lowest": 1.0, "small_worst": 0.0, "completed_none": 0.0}
    rows = [
        dict(zip(PLACE, ("cyclone_dds", loss, frame, "block", 0.0, 500), strict=True))
        | answer
        | {"completed": done}
        for loss, frame, done in (
            (0.01, 50.0, 1.0),
            (0.01, 200.0, 1.0),
            (0.01, 800.0, 0.0),
            (0.04, 50.0, 1.0),
        )
    ]
    [between] = midpoints(pd.DataFrame(rows), config, most=9)
    assert (between.loss, between.frame_us) == (0.01, 400.0)
    assert midpoints(pd.DataFrame(rows), config, most=0) == []


def test_age_is_half_a_period_and_the_way_and_grows_where_nothing_arrives():
    published = np.arange(0, 10, 0.1)
    at = {
        "name": "a",
        "published_ns": (published * NS_PER_S).astype(np.int64),
        "value": np.ones(100, np.int32),
    }
    at |= {"received_ns": at["published_ns"] + 20_000_000, "dropped": np.zeros(100, np.int8)}
    fates = (np.full(100, fate, np.int8) for fate in (Fate.DELIVERED, Fate.UNDERWAY))
    there, never = (FlowOutcome(fate=fate, **at) for fate in fates)
    assert age_ms(there, duration_s=10) == pytest.approx(50 + 20, abs=0.5)
    assert age_ms(never, duration_s=10) == pytest.approx(5000)


def test_a_small_run_is_refined_and_drawn(tmp_path):
    found = ran(exp, tmp_path / "a.mcap")
    assert len(found["cell"]) == 14 * len(found["course"]) / 4
    assert set(found["course"]["frame_us"]) == {50.0, 245.0, 1200.0}
    assert set(exp.figures(found)) == {"phases"}
    assert shares(found)["conditions"].tolist() == [3, 1]


AGREES, DEVIATES, UNDECIDED = Verdict.REPRODUCED, Verdict.DEVIATES, None


class Made:
    """A run with made-up tables."""

    config = exp.config("quick")

    def __init__(self, cells, courses, *, finished=True):
        self._tables, self._finished, self._made = {"cell": cells, "course": courses}, finished, {}

    def __getitem__(self, table):
        return self._tables[table]

    def metadata(self, name):
        return {"profile": "quick"} if name == COMPLETION and self._finished else {}

    def once(self, key, make):
        return self._made[key] if key in self._made else self._made.setdefault(key, make())


@cache
def agreeing() -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return what agrees everywhere: 20 ms and 10 % lost, with OPT+LC 10 and 5, at a small depth 30 and 50."""
    places = pd.DataFrame(plausible(), columns=PLACE)
    cells = pd.DataFrame(product(*[CELLS], range(6)), columns=["cell", "seed"])
    cells[["method", "depth"]] = cells.pop("cell").to_list()
    best = cells["method"] == "OPT+LC"
    small = cells["depth"].isin(["1", "5", "10"]) & (cells["method"] == "none")
    for column, values in {"pooled_ms": (10.0, 30.0, 20.0), "arrived": (95, 50, 90)}.items():
        cells[column] = np.select([best, small], values[:2], values[2])
    cells = cells.assign(p50_ms=cells["pooled_ms"] + cells["seed"] / 9, published=100, age_ms=1.0)
    courses = pd.DataFrame(product(COURSES, range(2)), columns=["cell", "seed"])
    courses[["method", "depth"]] = courses.pop("cell").to_list()
    courses["end"] = np.where(courses["method"] == "OPT+LC", "success", "contact")
    return places.merge(cells, "cross"), places.merge(courses.assign(robot="robot2"), "cross")


def finding(claim, cells, courses):
    return exp.measure(Made(cells, courses)).get(claim)


def test_the_maps_show_shares_of_what_is_asked_of_a_condition():
    cells, courses = agreeing()
    later = cells.assign(pooled_ms=cells["pooled_ms"].mask(cells["method"] == "OPT+LC", 22.0))
    for table, lowest in ((cells, 1), (later, 0.5)):
        [shown] = answers(table, courses)[[*ANSWERS]].drop_duplicates().to_dict("records")
        assert shown == {"lc_lowest": lowest, "small_worst": 1, "completed": 1, "completed_none": 0}


BEST = "method == 'OPT+LC'"
SMALL = "method == 'none' and depth in ('1', '5', '10')"
FOXY = "preset == 'fast_dds_foxy'"
MANY = (
    "(loss == 0.01 or loss == 0.0003 and (frame_us == 600 or frame_us == 200 and stall_ms < 100))"
)
SLOW, HALF = "rate_max_hz == 100", "rate_max_hz in (100, 1000)"
FAST = "rate_max_hz in (500, 1000)"


@pytest.mark.parametrize(
    ("claim", "where", "change", "verdict"),
    [
        ("B-LAT", "loss > 1", {}, AGREES),
        ("B-LAT", f"{BEST} and {SLOW}", {"pooled_ms": 22.0}, AGREES),  # at three of four
        ("B-LAT", f"{BEST} and {HALF}", {"pooled_ms": 20.9}, AGREES),  # within 5 %
        ("B-LAT", f"{BEST} and {HALF}", {"pooled_ms": 21.1}, DEVIATES),
        ("B-LAT", BEST, {"p50_ms": 99.0}, AGREES),  # all seeds together count
        ("B-LAT", "method == 'OPT+CC'", {"pooled_ms": 9.0}, DEVIATES),
        ("B-LAT", "method == 'CC' and depth == '5000'", {"pooled_ms": 9.0}, DEVIATES),
        ("B-LAT", "loss < 1", {"pooled_ms": np.inf}, DEVIATES),  # nothing shows it
        (
            "B-LAT",
            f"{SMALL} and rate_max_hz == 500",
            {"p50_ms": 19.0},
            AGREES,
        ),  # at 1000 Hz it is worse
        ("B-LAT", f"{SMALL} and {FAST}", {"p50_ms": 19.0}, DEVIATES),
        (
            "B-LAT",
            f"{SMALL} and {FAST} and seed == 3",
            {"p50_ms": 20.4},
            DEVIATES,
        ),  # intervals meet
        (
            "B-LAT",
            f"{SMALL} and {FAST} and depth != '5'",
            {"p50_ms": 19.0},
            AGREES,
        ),  # one depth is enough
        ("B-LAT", f"{SMALL} and rate_max_hz < 500", {"p50_ms": 19.0}, AGREES),
        (
            "B-LAT",
            f"{BEST} and {FOXY} and loss == 0.01",
            {"pooled_ms": 22.0},
            AGREES,
        ),  # in 18 of 27
        (
            "B-LAT",
            f"{BEST} and {FOXY} and {MANY}",
            {"pooled_ms": 22.0},
            DEVIATES,
        ),  # in 13; the lower judges
        ("B-LOSS", f"{BEST} and {HALF}", {"arrived": 89}, AGREES),  # within a point
        ("B-LOSS", f"{BEST} and {HALF}", {"arrived": 88}, DEVIATES),
        ("B-LOSS", f"{BEST} and {SLOW}", {"arrived": 0}, AGREES),
        ("B-LOSS", f"{SMALL} and {FAST}", {"arrived": 88}, DEVIATES),  # intervals meet
        ("B-LOSS", f"{SMALL} and {FAST} and depth != '10'", {"arrived": 90}, AGREES),
        ("B-COOP", BEST, {"end": "timeout"}, DEVIATES),
        (
            "B-COOP",
            f"{BEST} and {FOXY} and stall_ms > 0",
            {"end": "contact"},
            DEVIATES,
        ),  # a third; the lower
        (
            "B-COOP",
            f"{BEST} and {FOXY} and stall_ms == 0",
            {"end": "contact"},
            AGREES,
        ),  # two thirds
        ("B-COOP", "method == 'none' and depth != 10", {"end": "success"}, DEVIATES),
        (
            "B-COOP",
            "method == 'none' and depth == 10",
            {"end": "success"},
            AGREES,
        ),  # depths count alike
    ],
)
def test_a_verdict_is_the_criterion_s(claim, where, change, verdict):
    tables = [table.copy() for table in agreeing()]
    table = tables[claim == "B-COOP"]
    table.loc[table.eval(where), list(change)] = list(change.values())
    found = finding(claim, *tables)
    assert entry_for(CLAIMS[claim], found).verdict is verdict
    assert "by stall_ms 0: " in found.reason
    if claim == "B-LAT":
        assert (
            f"no median at any depth in {27 * (change == {'pooled_ms': np.inf})} of 27"
            in found.reason
        )


@pytest.mark.parametrize(
    ("table", "missing"),
    [
        (
            0,
            f"{BEST} and {FOXY} and {SLOW} and loss == 0.01 and frame_us == 600 and stall_ms == 50",
        ),
        (
            0,
            f"seed == 5 and {FOXY} and {SLOW} and loss == 0.01 and frame_us == 600 and stall_ms == 50",
        ),
        (1, "seed == 1 and rate_max_hz == 1000"),
        (1, "method == 'none' and depth == 1000"),
    ],
)
def test_a_run_that_lacks_anything_decides_nothing(table, missing):
    tables = list(agreeing())
    tables[table] = tables[table].query(f"not ({missing})")
    assert exp.measure(Made(*tables)) == {}
    assert exp.measure(Made(*agreeing(), finished=False)) == {}


def test_conditions_beside_the_criteria_s_do_not_count_and_the_older_figure_stands_beside():
    cells, courses = agreeing()
    others = (
        cells.assign(queue_rule="tail", pooled_ms=99.0),
        cells.assign(loss=0.005, pooled_ms=99.0),
    )
    found = finding("B-LAT", pd.concat([cells, *others]), courses)
    assert (found.estimate.value, found.estimate.high) == (1, 1)
    assert found.estimate.low == pytest.approx(0.875, abs=1e-3), "Wilson's of 27"
    older = Measured(estimate=exactly(0.25, "share of rates"), how=How.SIMULATED)
    sources = [
        [_Source(log, Findings(measured={"B-LAT": measured}, origin=""))]
        for log, measured in (("a", older), ("b", found))
    ]
    for pair in (sources, sources[::-1]):
        entry = _judged(CLAIMS["B-LAT"], pair)
        assert (entry.log, entry.measured.estimate) == ("b", found.estimate)
        assert "0.25 share of rates" in entry.measured.details["by the band of other runs"]
        assert entry.claim.experiment == "phases"
    assert entry_for(CLAIMS["B-LAT"], older).claim.band == (1, 1)
