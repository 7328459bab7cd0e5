"""The map: its conditions are the criteria's, answers and verdicts follow the criteria to the letter."""

import shlex
from functools import cache
from itertools import product

import numpy as np
import pandas as pd
import pytest
import yaml
from made_logs import CLAIMS, ran, reference

from sfglab.lab.claims import Verdict, entry_for
from sfglab.lab.experiments.phases import exp, phases, press_map
from sfglab.lab.experiments.phases.experiment import CELLS, LAPS, PLACE, conditions, plausible
from sfglab.lab.experiments.phases.results import by_conditions, command_of, mapped
from sfglab.lab.runs import COMPLETION, lines_of


def test_there_are_432_conditions_and_27_of_the_criterion_for_each_mode_and_rate():
    assert len(conditions(exp.config("paper", criterion=False, rates_hz=(500,)))) == 432
    found = pd.DataFrame(plausible(), columns=PLACE)
    assert (found.groupby(["preset", "rate_max_hz"]).size() == 27).all()
    assert found["loss"].unique() == pytest.approx([0.0003, 0.001732, 0.01])
    assert found["stall_ms"].unique().tolist() == [0, 50, 100]


def test_a_small_run_is_not_judged(tmp_path):
    run = ran(exp, tmp_path / "a.mcap")
    assert exp.measure(run) == {}
    assert len(phases(run)) == 2


def test_a_click_prints_the_cells_and_a_command_that_simulates_the_condition_again():
    pytest.importorskip("ipywidgets", reason="the extra view is not installed")
    run = reference(exp)
    place = lines_of(mapped(run))[-1]
    words = [word.split("=") for word in shlex.split(command_of(run, place))[3:]]
    again = conditions(
        exp.config("quick", **{name: yaml.safe_load(value) for name, value in words})
    )
    found = [(one.rate_max_hz, one.preset, one.loss, one.frame_us) for one in again]
    here = (place.preset, place.loss, place.frame_us)
    assert found == [(rate_hz, *here) for rate_hz in (100, 200, 500, 1000)]
    pressed = press_map(run, place.preset)
    assert "OPT+LC: laps completed" in pressed.titles()[str(place.Index)]
    pressed.press(str(place.Index))
    assert "OPT+LC" in pressed.widget.children[1].value
    assert pressed.said == ""


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
    laps = pd.DataFrame(product(LAPS, range(2)), columns=["cell", "seed"])
    laps[["method", "depth"]] = laps.pop("cell").to_list()
    laps["end"] = np.where(laps["method"] == "OPT+LC", "success", "contact")
    return places.merge(cells, "cross"), places.merge(laps.assign(robot="robot2"), "cross")


BEST = "method == 'OPT+LC'"
NONE = "method == 'none'"
SMALL = f"{NONE} and depth in ('1', '5', '10')"
FOXY = "preset == 'fast_dds_foxy'"
MANY = (
    "(loss == 0.01 or loss == 0.0003 and (frame_us == 600 or frame_us == 200 and stall_ms < 100))"
)
SLOW, HALF = "rate_max_hz == 100", "rate_max_hz in (100, 1000)"
FAST = "rate_max_hz in (500, 1000)"


@pytest.mark.parametrize(
    ("claim", "where", "column", "value", "agrees"),
    [
        ("B-LAT", "loss < 1", "age_ms", 1.0, True),  # as it is
        ("B-LAT", f"{BEST} and {SLOW}", "pooled_ms", 22.0, True),  # at three of four
        ("B-LAT", f"{BEST} and {HALF}", "pooled_ms", 20.9, True),  # within 5 %
        ("B-LAT", f"{BEST} and {HALF}", "pooled_ms", 21.1, False),
        ("B-LAT", BEST, "p50_ms", 99.0, True),  # all seeds together count
        ("B-LAT", "method == 'OPT+CC'", "pooled_ms", 9.0, False),
        ("B-LAT", "method == 'CC' and depth == '5000'", "pooled_ms", 9.0, False),
        ("B-LAT", "loss < 1", "pooled_ms", np.inf, False),  # nothing shows the order
        ("B-LAT", f"{SMALL} and rate_max_hz == 500", "p50_ms", 19.0, True),  # worse at 1000 Hz
        ("B-LAT", f"{SMALL} and {FAST}", "p50_ms", 19.0, False),
        ("B-LAT", f"{SMALL} and {FAST} and seed == 3", "p50_ms", 20.4, False),  # intervals meet
        ("B-LAT", f"{SMALL} and {FAST} and depth != '5'", "p50_ms", 19.0, True),  # one is enough
        ("B-LAT", f"{SMALL} and rate_max_hz < 500", "p50_ms", 19.0, True),
        ("B-LAT", f"{BEST} and {FOXY} and loss == 0.01", "pooled_ms", 22.0, True),  # in 18 of 27
        ("B-LAT", f"{BEST} and {FOXY} and {MANY}", "pooled_ms", 22.0, False),  # 13; the lower mode
        ("B-LOSS", f"{BEST} and {HALF}", "arrived", 89, True),  # within a point
        ("B-LOSS", f"{BEST} and {HALF}", "arrived", 88, False),
        ("B-LOSS", f"{BEST} and {SLOW}", "arrived", 0, True),
        ("B-LOSS", f"{SMALL} and {FAST}", "arrived", 88, False),  # intervals meet
        ("B-LOSS", f"{SMALL} and {FAST} and depth != '10'", "arrived", 90, True),
        ("B-COOP", BEST, "end", "timeout", False),
        ("B-COOP", f"{BEST} and {FOXY} and stall_ms > 0", "end", "contact", False),  # a third
        ("B-COOP", f"{BEST} and {FOXY} and stall_ms == 0", "end", "contact", True),  # two thirds
        ("B-COOP", f"{NONE} and depth != 10", "end", "success", False),
        ("B-COOP", f"{NONE} and depth == 10", "end", "success", True),  # depths count alike
    ],
)
def test_a_verdict_is_the_criterion_s(claim, where, column, value, agrees):
    tables = [table.copy() for table in agreeing()]
    table = tables[claim == "B-COOP"]
    table.loc[table.eval(where), column] = value
    found = exp.measure(Made(*tables))[claim]
    expected = Verdict.REPRODUCED if agrees else Verdict.DEVIATES
    assert entry_for(CLAIMS[claim], found).verdict is expected
    said = (
        "of laps at 1 % loss"
        if claim == "B-COOP"
        else "of 27 conditions (compared with no method, CC and OPT+CC), and a small depth is worse than a deep one in"
    )
    assert said in found.reason


CELL = f"{FOXY} and {SLOW} and loss == 0.01 and frame_us == 600 and stall_ms == 50"


@pytest.mark.parametrize(
    ("table", "missing"),
    [
        (0, f"{BEST} and {CELL}"),
        (0, f"seed == 5 and {CELL}"),
        (1, "seed == 1 and rate_max_hz == 1000"),
        (1, f"{NONE} and depth == 1000"),
    ],
)
def test_a_run_that_lacks_anything_decides_nothing(table, missing):
    tables = list(agreeing())
    tables[table] = tables[table].query(f"not ({missing})")
    assert exp.measure(Made(*tables)) == {}
    assert exp.measure(Made(*agreeing(), finished=False)) == {}


def test_other_conditions_than_the_criteria_s_do_not_count():
    cells, laps = agreeing()
    others = cells.assign(queue_rule="tail", pooled_ms=99.0), cells.assign(loss=0.005, arrived=0)
    found = exp.measure(Made(pd.concat([cells, *others]), laps))
    for claim in ("B-LAT", "B-LOSS"):
        assert found[claim].estimate.value == 1
        assert found[claim].estimate.low == pytest.approx(0.875, abs=1e-3), "Wilson's of 27"


def test_the_committed_log_has_the_conditions_of_its_configuration():
    run = reference(exp)
    assert len(run["course"].drop_duplicates(PLACE)) == len(conditions(run.config)) == 252
    assert len(phases(run)) == 252


def test_an_interval_by_conditions_takes_laps_of_a_condition_together():
    _, laps = agreeing()
    laps = laps.query(FOXY)
    laps = laps.assign(done=laps["method"].eq("OPT+LC") & laps["loss"].lt(0.01))
    part = by_conditions(laps)
    assert part.value == pytest.approx(2 / 3)
    # As for 27 draws, and not for 27 x 8 laps.
    assert part.high - part.low == pytest.approx(2 * 1.96 * np.sqrt(2 / 9 / 27), rel=0.15)


def test_contacts_and_stops_are_told_apart():
    details = exp.measure(reference(exp))["B-COOP"].details
    ends = details["fast_dds_foxy, none: ends of laps"]
    assert ends == "contact in 648 (robot2 in 20) of 648 laps"
    assert "[0.153, 0.356]" in details["fast_dds_foxy, by conditions"]
