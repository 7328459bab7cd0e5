"""The kit: profiles, logs that count only when finished, rows, cases, defaults of figures, resuming, configuration."""

from __future__ import annotations

import asyncio
import math
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import nbformat
import pytest

from sfglab.errors import InvalidValueError
from sfglab.fields import between
from sfglab.lab.bench import TableRow
from sfglab.lab.checks import CheckRow, share_of_checks
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiment import Experiment, SkippedPartError
from sfglab.lab.figures import note
from sfglab.lab.ledger import find_log, logs_of
from sfglab.lab.paper import paper
from sfglab.lab.paths import Project
from sfglab.lab.runs import Run, derived, standing
from sfglab.lab.stats import exactly
from sfglab.lab.sweep import Workers


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    profile: str = "quick"
    seeds: int = 2
    seed: int = 0
    loss: float = between(0.01, 0.0, 0.3)
    breaks: bool = False
    kinds: tuple[str, ...] = ("a", "b")


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    kind: str
    hidden: int = 1


exp = Experiment("kit", Config, where="A 1", smoke={"seeds": 1}, paper={"seeds": 3})


exp.table("check")(CheckRow)


@exp.table("cell", "other")
@dataclass(frozen=True, slots=True, kw_only=True)
class KitRow:
    kind: str  #: One of the kinds.
    seed: int
    value: float


@exp.table("bar")
class BarRow(TableRow):
    repeat: int
    size: int


@exp.sweep(
    "cell", over=lambda config: [Point(kind=k) for k in config.kinds], workers=Workers(threads=True)
)
def cell(point: Point, seed: int) -> dict[str, float]:
    return {"value": len(point.kind) + seed}


@exp.part("live", total=2)
async def live(bench):
    bench.write("other", {"kind": "x", "seed": 0, "value": float(len(bench.rows["cell"]))})
    (bench.folder("scratch") / "file").write_text("gone afterwards")
    bench.advance("one")
    if bench.config.breaks:
        raise KeyboardInterrupt


@exp.part("bars", timed=False)
def bars(bench):
    for repeat in range(2):
        bench.write(BarRow(repeat=repeat, size=10 * repeat))
        bench.cases["size: bars are low"].append((f"bar {repeat}", repeat < 1))
        bench.cases["count: bars are few"].append((f"bar {repeat}", True))
    with pytest.raises(ValueError, match="too many values"):
        bench.write(KitRow(kind="x", seed=0, value=0.0))


@exp.part("impossible")
def impossible(_):
    raise SkippedPartError("no device")


calls = []


@derived
def total(run, column="value"):
    calls.append(column)
    return float(run["cell"][column].sum())


@derived
def largest(run):
    return int(run["bar"]["size"].max())


@exp.claim("X", how=How.EXACT)
def claim(run):
    return Finding(estimate=exactly(total(run), "things"))


@exp.figure("kit", size=(3, 2))
def draw(figure, run):
    figure.subplots().plot(run["cell"]["value"])
    return {"total": total(run)}


@exp.figure("bars", size=(6, 3), measured=False)
def draw_bars(figure, run):
    figure.subplots().bar([0], [largest(run)])
    note(figure, "bar: maximum")


exp.figure("measured bars", size=(6, 3))(draw_bars)


@exp.figure("never", size=(3, 2), when=lambda _: False)
def never(figure, run):
    raise AssertionError


def run(path, profile="smoke", **changes):
    return asyncio.run(exp.run(profile, path=path, **changes))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return run(tmp_path_factory.mktemp("kit") / "a.mcap")


def test_a_run_has_its_tables_its_configuration_and_its_completion(made):
    assert made.config == Config(profile="smoke", seeds=1)
    assert made["cell"].to_dict("list") == {"kind": ["a", "b"], "seed": [0, 0], "value": [1.0, 1.0]}
    assert list(made.table("cell")["log_time_ns"]) == [0, 1]
    assert made["other"]["value"].tolist() == [2.0]
    assert made.skipped("impossible") == "no device"
    assert made.profile == "smoke"
    left = [path.name for path in made.log.parent.iterdir()]
    assert left == ["a.mcap"], "no journal, no scratch, no half log"


def test_equal_seeds_give_equal_rows_and_derived_values_are_computed_once(made, tmp_path):
    again = run(tmp_path / "b.mcap")
    assert made["cell"].equals(again["cell"])
    calls.clear()
    finding = exp.measure(again)["X"]
    assert (finding.estimate.value, finding.how) == (2.0, How.EXACT)
    assert list(exp.figures(again)) == ["kit", "bars", "measured bars"]
    assert calls == ["value"]


def test_a_row_goes_into_the_table_of_its_class(made):
    assert made["bar"].to_dict("list") == {"repeat": [0, 1], "size": [0, 10]}
    with pytest.raises(TypeError, match="height"):
        BarRow(repeat=0, height=1)


def test_cases_of_a_part_become_checks_and_a_prefix_chooses_among_them(made):
    assert made.table("check")["log_time_ns"].to_list() == [0, 1]
    share = share_of_checks(made, "")
    assert share.estimate.value == 0.5
    assert share.groups == {"size: bars are low": "1 of 2", "count: bars are few": "2 of 2"}
    assert share.reason == "size: bars are low: 1 of 2: bar 1"
    assert share_of_checks(made, "count").estimate.value == 1
    assert math.isnan(share_of_checks(made, "none").estimate.value)


def test_a_figure_gets_its_note_and_sidecar_from_the_run(made):
    assert largest(made) == 10, "the table was read before"
    figure, sidecar = exp.draw("bars", made)
    assert (sidecar["tables"], sidecar["repetitions"]) == ({"bar": 2}, 2)
    assert sidecar["machine"].endswith(" cores")
    assert figure.get_supxlabel() == "bar: maximum; 2 repetitions; computed"
    measured, _ = exp.draw("measured bars", made)
    said = f"bar: maximum; 2 repetitions; run on {sidecar['machine']}"
    assert measured.get_supxlabel() == said


def test_numbers_of_the_papers_are_read_by_the_claims_id():
    assert paper("C-DRIVE") == 7.994
    assert paper("C-DRIVE", "software, mean (ms)") == 28.264
    for claim, number in [("C-NONE", ""), ("C-DRIVE", "mean"), ("C-FSM", "")]:
        with pytest.raises(KeyError):
            paper(claim, number)


def test_profiles_and_changes_are_checked():
    assert exp.config("paper").seeds == 3
    assert exp.config("smoke", kinds=["z"]).kinds == ("z",), "as a command line gives it"
    for profile, changes, message in [
        ("long", {}, "profile: given 'long', allowed: smoke, quick, paper"),
        ("smoke", {"sede": 1}, "kit: sede: given 'sede', allowed: .*did you mean 'seed'"),
        ("smoke", {"loss": 0.4}, "kit: loss: given 0.4, allowed: a number from 0 to 0.3"),
        ("smoke", {"seed": -1}, "kit: seed: given -1, allowed: at least 0"),
    ]:
        with pytest.raises(InvalidValueError, match=message):
            exp.config(profile, **changes)


def test_a_removed_field_that_held_another_value_than_usual_counts_for_no_claim(made):
    """As in a log of an older version, whose configuration had the field ``loss``."""

    @dataclass(frozen=True, slots=True, kw_only=True)
    class Later:
        profile: str = "quick"
        seeds: int = 2
        newer: int = 1

    gone = {name: {"smoke": value} for name, value in {"seed": 0, "breaks": False}.items()}
    gone["kinds"] = {"smoke": ["a", "b"]}
    usual = gone | {"loss": {"smoke": 0.01, "paper": 0.3}}
    assert Run(made.log, Later, exp.tables, usual, {}).unread == ()
    other = gone | {"loss": {"smoke": 0.02, "paper": 0.01}}
    later = Run(made.log, Later, exp.tables, other, {"smoke": {"seeds": 3, "newer": 4}})
    assert later.unread == ("loss",)
    assert later.config == Later(profile="smoke", seeds=1, newer=4)


def test_an_interrupted_run_has_another_name_goes_on_and_counts_only_when_finished(
    tmp_path, monkeypatch
):
    project = Project(root=tmp_path)
    path = tmp_path / "runs" / "logs" / "kit" / "20260101T000000-quick.mcap"
    with pytest.raises(KeyboardInterrupt):
        run(path, "quick", breaks=True)
    left = {entry.name for entry in path.parent.iterdir()}
    assert left == {f"{path.name}.part", "kit-quick-cell.journal"}
    assert find_log(project, "kit") is None
    assert [standing(log).why_not for log in logs_of(project, "kit")] == ["it is not finished"]
    monkeypatch.setattr("sfglab.lab.sweep.run.connected", None)
    again = path.with_name("20260102T000000-quick.mcap")
    run(again, "quick")  # what is in the journal is not run again, and asks for no workers
    assert find_log(project, "kit") == again
    assert {entry.name for entry in path.parent.iterdir()} == {f"{path.name}.part", again.name}


DESIGN = Path(__file__).parents[2] / "DESIGN.md"


@pytest.fixture
def example(tmp_path, monkeypatch):
    """Return the code of the page's experiment, and it and its test as a module."""
    blocks = re.findall(r"```python\n(.*?)```", DESIGN.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "design_example.py").write_text("import asyncio\n" + blocks[0] + blocks[1])
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "design_example", raising=False)
    return blocks[0], import_module("design_example")


def test_the_example_is_short_and_passes_its_own_test(example, tmp_path):
    code, module = example
    assert len([line for line in code.splitlines() if line.strip()]) <= 60
    module.test_every_size_is_measured(tmp_path)
    run = module.exp.load(tmp_path / "a.mcap")
    figure, numbers = module.exp.figures(run)["cdr"]
    assert figure.axes
    assert list(numbers) == [64, 256, 1024]


OWN_CLAIM = """
- id: A-CDR
  where: A 4.3
  says: an image is serialised and read back
  paper: null
  unit: us
  band: [0, 100000]
  experiment: cdr
"""


@pytest.mark.slow
def test_the_ledger_runs_with_an_experiment_of_ones_own(example, tmp_path):
    """The guide "Extend it": an experiment, its claim and its notebook, then the ledger."""
    root = Path(__file__).parents[2]
    for name in ("sfglab", "data", "notebooks"):
        # Without committed logs, which say nothing of an experiment of one's own.
        shutil.copytree(root / name, tmp_path / name, ignore=shutil.ignore_patterns("*.mcap"))
    experiments = tmp_path / "sfglab" / "lab" / "experiments"
    (experiments / "cdr.py").write_text(example[0], encoding="utf-8")
    listing = experiments / "__init__.py"
    text = listing.read_text("utf-8")
    listing.write_text(text.replace('    "naming",\n', '    "naming",\n    "cdr",\n'), "utf-8")
    with (tmp_path / "data" / "claims.yaml").open("a", encoding="utf-8") as claims:
        claims.write(OWN_CLAIM)
    sources = (
        "from sfglab.lab import notebook\nfrom sfglab.lab.experiments import cdr",
        'profile: str = "quick"\nseed: int = 0\nlog: str = ""\nsettings: dict = {}',
        "run = await notebook.run(cdr.exp, profile, log, settings, seed=seed)",
        "notebook.claims_of(run)",
    )
    page = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(each) for each in sources])
    page.cells[1].metadata["tags"] = ["parameters"]
    nbformat.write(page, tmp_path / "notebooks" / "22_cdr.ipynb")
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "SFGLAB_ROOT": str(tmp_path)}
    argv = [sys.executable, "-P", "-m", "sfglab", "reproduce", "22_cdr", "01_ledger"]
    done = subprocess.run(argv, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "2 of 2 notebooks ran through" in done.stderr
    shown = (tmp_path / "runs" / "notebooks" / "01_ledger.ipynb").read_text("utf-8")
    assert "A-CDR" in shown
    assert "your run of " in shown
