"""The gateway core drawn from its table (paper C, Fig. 4): every state, every arrow, nothing else."""

from __future__ import annotations

import itertools
from collections import Counter

import pytest
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from sfglab.soc.gateway import TABLE, State
from sfglab.soc.gateway.core import PLACES, arrows, draw_core


@pytest.fixture
def axes():
    ax = Figure().add_subplot()
    draw_core(ax)
    return ax


def test_every_state_has_a_place_of_its_own():
    assert set(PLACES) == set(State)
    assert len(set(PLACES.values())) == len(State)


def test_every_arrow_of_the_table_is_drawn_once_with_its_input(axes):
    drawn = Counter(text.get_text() for text in axes.texts)
    inputs = Counter(arrow.given.name for arrow in arrows())
    words = {"OFFERED": "offered", "ANSWERED": "answered", "GRANTED": "granted", "FOREIGN": "foreign"}
    assert len(arrows()) == sum(len(row.moves) for row in TABLE.values()) == 26
    assert all(drawn[text] == inputs[name] for name, text in words.items())


def test_every_state_is_a_box(axes):
    boxes = [patch for patch in axes.patches if isinstance(patch, FancyBboxPatch)]
    assert len(boxes) == len(State)
    assert "filter SMT" in {text.get_text() for text in axes.texts}


def test_no_arrow_but_the_one_with_a_detour_passes_over_a_state():
    for arrow in arrows():
        if (arrow.source, arrow.target) == (State.CANCEL_WAIT, State.PUBLISH_HOLDING):
            continue
        (x0, y0), (x1, y1) = PLACES[arrow.source], PLACES[arrow.target]
        for x, y in set(itertools.product(range(-1, 6), range(5))) - {(x0, y0), (x1, y1)}:
            between = min(x0, x1) <= x <= max(x0, x1) and min(y0, y1) <= y <= max(y0, y1)
            on_line = (x - x0) * (y1 - y0) == (y - y0) * (x1 - x0)
            assert not (between and on_line and (x, y) in PLACES.values()), arrow
