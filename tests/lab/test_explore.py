"""Forms of settings, the explorer of an experiment, and the picture of its set-up."""

from __future__ import annotations

from typing import Annotated, Literal

import pytest

from sfglab.errors import InvalidValueError
from sfglab.fields import Bounds
from sfglab.lab.experiments import EXPERIMENTS, experiment, gateways
from sfglab.lab.explore import explore
from sfglab.lab.explore.form import Form
from sfglab.lab.notebook import draw_setup

pytest.importorskip("ipywidgets")


def measure(
    *,
    share: Annotated[float, Bounds(0, 0.5)] = 0.1,
    rate_hz: Annotated[int, Bounds(10, 1000, log=True)] = 100,
    wait_s: Annotated[float, Bounds(0.5, 60, log=True)] = 3,
    count: Annotated[int, Bounds(1, 9)] = 3,
    method: Literal["none", "LC"] = "none",
    live: bool = False,
    loss_percent: Annotated[float, Bounds(0, 50)] = 1.0,
):
    """A setting with a parameter of every kind.

    Args:
        rate_hz: Rate of messages [Hz].
        loss_percent: Frames that are lost [%].
    """


SET = {
    "share": (0.2, 0.2),
    "rate_hz": (316.228, 316),
    "wait_s": (9.99999999999996, 10.0),
    "count": (4, 4),
    "method": ("LC", "LC"),
    "live": (True, True),
    "loss_percent": (2.0, 2.0),
}


@pytest.mark.parametrize("name", SET)
def test_a_widget_sets_its_parameter_in_its_type(name):
    asked = []
    form = Form(measure, lambda: asked.append(form.values))
    given, held = SET[name]
    form.controls[name].value = given
    assert type(form.values[name]) is type(held)
    assert asked == [form.values] == [form.default | {name: held}]
    form.reset()
    assert form.values == form.default


def test_a_unit_is_written_once_behind_its_control():
    rows = {
        row.children[0].description: row.children[1] for row in Form(measure, list).widget.children
    }
    assert rows["rate"].value.split("<small")[0] == "Hz "
    assert "Rate of messages.<" in rows["rate"].value
    assert rows["loss"].value.startswith("% <small")
    assert rows["loss"].value.count("%") == 1


def test_an_experiment_without_an_explorer_is_refused():
    with pytest.raises(
        InvalidValueError, match="'gateways', allowed: an experiment that declares an explorer"
    ):
        explore(gateways.exp)


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
