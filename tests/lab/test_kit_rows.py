"""Rows, cases and defaults of figures: what an experiment leaves to the kit."""

import math
from dataclasses import dataclass

import pytest
from made_logs import ran
from matplotlib.figure import Figure

from sfglab.lab.bench import TableRow
from sfglab.lab.checks import CheckRow, share_of_checks
from sfglab.lab.experiment import Experiment, Profiled
from sfglab.lab.figures import add_note, note
from sfglab.lab.paper import paper
from sfglab.lab.runs import derived


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    repeats: int = 2  #: Number of repetitions.
    seed: int = 0  #: Seed.


EMPTY = {"smoke": {}, "paper": {}}
exp = Experiment("small", Config, where="A 1", **EMPTY)
exp.table("check")(CheckRow)


@exp.table("bar")
class BarRow(TableRow):
    """A bar."""

    repeat: int  #: Number of the repetition.
    size: int  #: Its height.


@exp.table("one", "other")
class SharedRow(TableRow):
    """A row of two tables."""

    value: int  #: A value.


@exp.part("bars", timed=False)
def write_bars(bench):
    for repeat in range(bench.config.repeats):
        bench.write(BarRow(repeat=repeat, size=10 * repeat))
        bench.cases["size: bars are low"].append((f"bar {repeat}", repeat < 1))
        bench.cases["count: bars are few"].append((f"bar {repeat}", True))
    with pytest.raises(ValueError, match="too many values"):
        bench.write(SharedRow(value=1))
    bench.write("other", SharedRow(value=1))


@derived
def largest(run):
    return int(run["bar"]["size"].max())


@exp.figure("bars", size=(6, 3))
def draw_bars(figure, run):
    """Draw the largest bar."""
    figure.subplots().bar([0], [largest(run)])
    note(figure, "bar: maximum")


@pytest.fixture
def run(tmp_path):
    return ran(exp, tmp_path / "a.mcap")


def test_a_row_goes_into_the_table_of_its_class(run):
    assert run["bar"].to_dict("list") == {"repeat": [0, 1], "size": [0, 10]}
    assert (len(run["one"]), len(run["other"])) == (0, 1)
    with pytest.raises(TypeError, match="height"):
        BarRow(repeat=0, height=1)


def test_cases_of_a_part_become_checks_and_a_prefix_chooses_among_them(run):
    assert run.table("check")["log_time_ns"].to_list() == [0, 1]
    share = share_of_checks(run, "")
    assert share.estimate.value == 0.5
    assert share.groups == {"size: bars are low": "1 of 2", "count: bars are few": "2 of 2"}
    assert share.reason == "size: bars are low: 1 of 2: bar 1"
    assert share_of_checks(run, "count").estimate.value == 1
    assert math.isnan(share_of_checks(run, "none").estimate.value)


def test_a_figure_gets_its_note_and_sidecar_from_the_run(run):
    assert largest(run) == 10, "the table was read before"
    figure, sidecar = exp.draw("bars", run)
    assert sidecar["tables"] == {"bar": 2}
    assert sidecar["repetitions"] == 2
    assert sidecar["machine"].endswith(" cores")
    assert figure.get_supxlabel() == "bar: maximum; 2 repetitions; computed"


def test_the_note_of_a_measuring_experiment_names_the_machine():
    figure = Figure()
    add_note(figure, {"machine": "X, 2 cores", "repetitions": 1}, measured=True)
    assert figure.get_supxlabel() == "run on X, 2 cores"


def test_numbers_of_the_papers_are_read_by_the_claims_id():
    assert paper("C-DRIVE") == 7.994
    assert paper("C-DRIVE", "software, mean (ms)") == 28.264
    for claim, number in [("C-NONE", ""), ("C-DRIVE", "mean"), ("C-FSM", "")]:
        with pytest.raises(KeyError):
            paper(claim, number)
