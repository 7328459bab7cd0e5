"""Forms of settings, the explorer of an experiment, and the picture of its set-up."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import pytest

from sfglab.errors import InvalidValueError
from sfglab.fields import between
from sfglab.lab.experiments import EXPERIMENTS, experiment, gateways
from sfglab.lab.explore import explore
from sfglab.lab.explore.form import Form
from sfglab.lab.notebook import draw_setup

pytest.importorskip("ipywidgets")


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """A setting with a field of every kind."""

    share: float = between(0.1, 0, 0.5)  #: A share.
    rate_hz: int = between(100, 10, 1000, log=True)  #: A rate.
    count: int = between(3, 1, 9)  #: A count.
    method: Literal["none", "LC"] = "none"  #: A method.
    live: bool = False  #: Whether it is live.
    wait_s: float = 1.5  #: Without bounds.
    source: str = "photos"  #: A file of one's own.
    pause_s: float = between(1.0, 0, math.inf, without=(0.0,))  #: Above 0.


SET = {
    "share": (0.2, 0.2),
    "rate_hz": (316.228, 316),
    "count": (4, 4),
    "method": ("LC", "LC"),
    "live": (True, True),
    "wait_s": (2.0, 2.0),
    "source": ("mine.mp4", "mine.mp4"),
    "pause_s": (3.0, 3.0),
}


@pytest.mark.parametrize("name", SET)
def test_a_widget_sets_its_field_in_its_type(name):
    asked = []
    form = Form(Config(), lambda: asked.append(form.config))
    given, held = SET[name]
    form.controls[name].value = given
    assert getattr(form.config, name) == held
    assert type(getattr(form.config, name)) is type(held)
    assert asked == [form.config] == [replace(Config(), **{name: held})]
    form.reset()
    assert form.config == Config()


def test_what_a_field_cannot_hold_is_said_and_changes_nothing():
    asked = []
    form = Form(Config(), lambda: asked.append(1))
    form.controls["pause_s"].value = 0.0
    assert form.config == Config()
    assert not asked
    assert "given" in form._said.value
    form.controls["pause_s"].value = 2.0
    assert form.config.pause_s == 2.0
    assert not form._said.value


def test_an_experiment_without_an_explorer_is_refused():
    with pytest.raises(InvalidValueError, match="'gateways', allowed: one with an explorer"):
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
