"""Explorers: forms from configurations, pictures that follow, what is kept speaks for no claim."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal
from unittest.mock import Mock

import pytest
from made_logs import share_findings
from matplotlib.figure import Figure
from matplotlib.text import Text
from waiting import wait_until

from sfglab.errors import InvalidValueError
from sfglab.fields import Bounds, between, to_json
from sfglab.lab import notebook
from sfglab.lab.experiment import Experiment, Look, Profiled
from sfglab.lab.experiments import EXPERIMENTS, depth_codecs, experiment, transmission
from sfglab.lab.explore import explore
from sfglab.lab.explore.form import Form, unit_of
from sfglab.lab.notebook import draw_setup
from sfglab.lab.paths import find_project
from sfglab.lab.workers import preview as workers_preview
from sfglab.lab.workers.preview import draw_look, preview
from sfglab.record import LogReader

pytest.importorskip("ipywidgets")
ROOT = find_project(Path(__file__)).root


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A checkout with our data and figures whose runs are its own."""
    for name in ("data", "figures"):
        (tmp_path / name).symlink_to(ROOT / name)
    share_findings(tmp_path)
    monkeypatch.setenv("SFGLAB_ROOT", str(tmp_path))
    return find_project()


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """A configuration with a field of every kind."""

    share: float = between(0.1, 0, 0.5)  #: A share.
    rate_hz: int = between(100, 10, 1000, log=True)  #: A rate.
    count: int = between(3, 1, 9)  #: A count.
    method: Literal["none", "LC"] = "none"  #: A method.
    live: bool = False  #: Whether it is live.
    wait_s: float = 1.5  #: Without bounds.
    depths: tuple[Annotated[int, Bounds(1, 5000)], ...] = (1, 10)  #: Several.
    #: One, so that it slides.
    one: tuple[Annotated[int, Bounds(1, 5000, log=True)], ...] = (10,)
    source: str = "photos"  #: A file of one's own.
    height: float = between(1.0, 0, 9)  #: How high [mm].


SET = {
    "share": (0.2, 0.2),
    "rate_hz": (316.228, 316),
    "count": (4, 4),
    "method": ("LC", "LC"),
    "live": (True, True),
    "wait_s": (2.0, 2.0),
    "depths": ("1, 5,10", (1, 5, 10)),
    "one": (99.9, (100,)),
    "source": ("mine.mp4", "mine.mp4"),
    "height": (3.0, 3.0),
}


@pytest.mark.parametrize("name", SET)
def test_a_widget_sets_its_field_in_its_type(name):
    asked = []
    form = Form(Config(), ["share"], lambda: asked.append(form.config))
    given, held = SET[name]
    form.controls[name].value = given
    assert getattr(form.config, name) == held
    assert type(getattr(form.config, name)) is type(held)
    assert asked == [form.config] == [replace(Config(), **{name: held})]
    form.reset()
    assert form.config == Config()


def test_every_field_has_a_widget_with_its_text_and_those_to_turn_stand_first():
    form = Form(Config(), ["count", "share"])
    assert set(form.controls) == set(SET)
    assert form.controls["count"].tooltip == "A count."
    first, second, *_ = form.widget.children
    assert [row.children[0] for row in (first, second)] == [
        form.controls["count"],
        form.controls["share"],
    ]


@pytest.mark.parametrize(
    ("name", "given"), [("depths", "1, many"), ("depths", "1, 9000"), ("depths", "0")]
)
def test_what_a_field_cannot_hold_is_said_and_changes_nothing(name, given):
    asked = []
    form = Form(Config(), [], lambda: asked.append(1))
    form.controls[name].value = given
    assert form.config == Config()
    assert not asked
    assert "given" in form._said.value
    form.controls[name].value = "7"
    assert form.config.depths == (7,)
    assert not form._said.value


def test_units_come_from_brackets_else_from_names():
    assert unit_of("rate_hz", "At which it is published.") == "Hz"
    assert unit_of("height", "How high [mm].") == "mm"
    assert unit_of("count", "How many.") == ""


def test_what_cannot_be_turned_is_refused_by_name():
    with pytest.raises(InvalidValueError, match=r"field to turn: given 'colour', allowed: .*share"):
        Form(Config(), ["colour"])
    with pytest.raises(
        InvalidValueError,
        match=r"transmission: look: given 'nothing', allowed: hello_over_depth",
    ):
        explore(transmission.exp, "nothing")


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """A part of a configuration."""

    agents: tuple[int, ...] = ()  #: Sizes of the fleet.
    talkers: int = 10  #: Publishing nodes of each agent.


@dataclass(frozen=True, slots=True, kw_only=True)
class Fleets(Profiled):
    """A configuration with a part."""

    simulated: Scale = Scale(agents=(2, 4))  #: Simulated fleets.
    seed: int = 0  #: The seed.


fleets = Experiment("fleets", Fleets, where="A 1", smoke={}, paper={})


@fleets.table("fleet")
class ToyFleetRow:
    """A fleet."""

    agents: int  #: Size.
    nodes: int  #: Nodes of all agents.


@fleets.sweep(
    "fleet",
    over=lambda config: [replace(config.simulated, agents=(n,)) for n in config.simulated.agents],
    seeds=lambda config: [config.seed],
)
def count_nodes(scale, _seed):
    """Return the nodes of a fleet."""
    (agents,) = scale.agents
    return {"agents": agents, "nodes": agents * scale.talkers}


@fleets.look(
    "fleet",
    Look(
        turn=("simulated.agents", "simulated.talkers"),
        needs=("fleet",),
        size=(4, 2),
        start={"simulated": Scale(agents=(6,))},
        within={"simulated.talkers": Bounds(1, 20), "simulated.agents": Bounds(2, 16)},
    ),
)
def draw_nodes(figure, run):
    """Draw the nodes of fleets."""
    figure.subplots().plot(run["fleet"]["agents"], run["fleet"]["nodes"])


async def test_a_part_of_a_configuration_is_turned_within_what_follows_a_slider():
    look = fleets.looks["fleet"]
    config = fleets.config("quick", **look.start)
    form = Form(config, look.turn, within=look.within)
    agents = form.controls["simulated.agents"]
    assert (agents.min, agents.max, agents.value) == (2, 16, 6)
    assert agents.tooltip == "Sizes of the fleet."
    agents.value = 3
    form.controls["simulated.talkers"].value = 1
    assert form.config.simulated == replace(config.simulated, agents=(3,), talkers=1)
    async with preview(fleets, "fleet", form.config) as run:
        assert run["fleet"].to_numpy().tolist() == [[3, 3]]
        assert len(draw_look(fleets, "fleet", run).axes) == 1
    form.reset()
    assert form.config == config


@pytest.mark.parametrize("name", [name for name in EXPERIMENTS if experiment(name).setup.actors])
def test_a_picture_of_the_set_up_names_every_host_and_process_and_what_is_sent(name):
    setup = experiment(name).setup
    said = " ".join(text.get_text() for text in draw_setup(setup).axes[0].texts)
    flat = " ".join(said.split())
    for actor in setup.actors:
        assert actor.name in flat
        assert actor.host in flat
    for link in setup.links:
        assert link.carries in flat
        assert link.boundary in flat


@pytest.mark.live
def test_a_figure_follows_only_the_newest_of_many_moves_and_what_is_kept_speaks_for_no_claim(
    project,
):
    def claims() -> bytes:
        argv = [sys.executable, "-m", "sfglab", "claims", "--json"]
        return subprocess.run(argv, check=True, capture_output=True, cwd=project.root).stdout

    before = claims()
    with closing(explore(depth_codecs.exp)) as explorer:
        assert explorer.wait()
        still, alt = explorer._repr_mimebundle_()
        assert still["image/png"]
        assert alt["image/png"]["alt"]
        for noise_mm in (2.0, 3.0, 4.0, 5.0):
            explorer.form.controls["noise_mm"].value = noise_mm
        assert explorer.wait()
        assert explorer.shown == 4
        assert explorer._repr_mimebundle_()[0]["image/png"] != still["image/png"]
        assert "noise_mm=5.0" in explorer.code()
        explorer.keep()
        assert explorer._state.value == "starting"
        explorer.run_all()
        assert "one run at a time" in explorer._state.value
        while explorer._running is not None:
            time.sleep(0.1)
        (log,) = map(Path, explorer.kept)
        run = depth_codecs.exp.load(log)
        assert run.config.noise_mm == 5.0
        assert run.metadata("completion")["explored"] is True
        assert claims() == before


async def test_a_look_that_cannot_be_drawn_is_said_and_the_next_one_is_drawn(monkeypatch):
    reports, exp = [], depth_codecs.exp
    drawn = [
        KeyError("not in the table"),
        *(Figure(figsize=(1, 1)) for _ in range(2)),
    ]  # coarse, whole
    monkeypatch.setattr(workers_preview, "draw_look", Mock(side_effect=drawn))
    order = {"look": next(iter(exp.looks)), "config": to_json(exp.config("smoke"))}
    for number in range(2):
        await workers_preview._draw(exp, order | {"request": number}, reports.append, lambda: False)
    assert [(report["is"], report["request"]) for report in reports] == [
        ("refused", 0),
        *[("picture", 1)] * 2,
    ]
    assert "not in the table" in reports[0]["why"]


@pytest.mark.parametrize(
    ("name", "look", "changes", "said"),
    [
        ("depth_codecs", "codecs", {"frames": 1, "png_level": 1, "noise_mm": 5.0}, ()),
    ],
)
async def test_a_look_is_drawn_as_turned_without_host_or_live_part(
    name, look, changes, said, monkeypatch
):
    monkeypatch.setattr("sfglab.lab.experiment.Testbed", None)
    exp = experiment(name)
    async with preview(exp, look, exp.config(**{**exp.looks[look].start, **changes})) as run:
        figure = draw_look(exp, look, run)
    assert all(axes.has_data() for axes in figure.axes)
    text = " ".join(found.get_text() for found in figure.findobj(Text))
    assert all(word in text for word in said)


def finished(explorer):
    """Wait until what runs on a button has ended."""
    wait_until(lambda: explorer._running is None, 300)


@pytest.mark.live
def test_run_all_ends_in_the_figures_and_claims_of_that_run(project):
    exp = depth_codecs.exp
    with closing(explore(exp, profile="smoke")) as explorer:
        explorer.form.controls["frames"].value = 2
        explorer.run_all()
        finished(explorer)
        head, *figures, claims = explorer._result.children
        (log,) = map(Path, explorer.kept)
    run = exp.load(log)
    assert run.config.frames == 2
    assert [figure.value[:4] for figure in figures] == [b"\x89PNG"] * len(exp.drawings_of(run))
    assert "A-RVL" in claims.value
    assert "In this run alone (A-RVL): it counts for no claim: it was explored." in claims.value
    relative = project.relative(log)
    assert f"log=&quot;{relative}&quot;" in head.value
    assert relative in explorer._state.value
    again = asyncio.run(notebook.run(exp, "smoke", log=relative))
    assert again.config == run.config


@pytest.mark.live
def test_keep_is_offered_where_there_are_tables_and_what_is_kept_opens(project):
    with closing(explore(depth_codecs.exp)) as explorer:
        explorer.keep()
        finished(explorer)
        (log,) = map(Path, explorer.kept)
    run = depth_codecs.exp.load(log)
    with LogReader(log) as reader:
        assert reader.tables
        assert all(len(run[table]) for table in reader.tables)
    for words in (["claims", "--all"], ["log"]):
        argv = [sys.executable, "-m", "sfglab", *words]
        done = subprocess.run(argv, check=True, capture_output=True, cwd=project.root, text=True)
        assert done.stderr == ""


@pytest.mark.live
def test_a_cell_that_runs_again_ends_the_worker_of_the_one_before(project):
    first = explore(depth_codecs.exp)
    process = first._worker._process
    with closing(explore(depth_codecs.exp)) as second:
        assert process.wait(60) is not None
        assert second._worker._process.poll() is None
