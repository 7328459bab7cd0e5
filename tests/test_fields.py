"""Fields of dataclasses: documentation, bounds, and values as JSON and back."""

from __future__ import annotations

import enum
import json
from collections.abc import Mapping, Sequence  # noqa: TC003  # read at run time
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.fields import Bounds, between, bounds_of, check_bounds, field_docs, from_json, to_json


class Colour(enum.Enum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True)
class Part:
    name: str  #: Its name: "#" is allowed.
    #: Longer than a line, so that it stands
    #: above.
    sizes: tuple[int, ...] = ()
    plain: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Whole(Part):
    colour: Colour = Colour.RED  #: Colour of the paint.
    pair: tuple[int, str] = (1, "a")
    parts: Sequence[Part] = ()
    by_name: Mapping[str, Part] = field(default_factory=dict)
    maybe: float | None = None
    loss: float = between(0.1, 0.0, 0.3)  #: Share.


def test_a_field_is_documented_on_its_line_or_above_and_inherits():
    assert field_docs(Whole) == {
        "name": 'Its name: "#" is allowed.',
        "sizes": "Longer than a line, so that it stands above.",
        "colour": "Colour of the paint.",
        "loss": "Share.",
    }


def test_bounds_are_read_and_kept():
    assert bounds_of(Whole) == {"loss": Bounds(0.0, 0.3)}
    check_bounds(Whole(name="x", loss=0.3))
    with pytest.raises(InvalidValueError, match=r"loss: given 0.31, allowed: from 0 to 0.3"):
        check_bounds(Whole(name="x", loss=0.31))


parts = st.builds(
    Part, name=st.text(), sizes=st.lists(st.integers()).map(tuple), plain=st.floats(allow_nan=False)
)
wholes = st.builds(
    Whole,
    name=st.text(),
    colour=st.sampled_from(Colour),
    pair=st.tuples(st.integers(), st.text()),
    parts=st.lists(parts, max_size=3).map(tuple),
    by_name=st.dictionaries(st.text(), parts, max_size=2),
    maybe=st.none() | st.floats(allow_nan=False),
)


@given(wholes)
def test_values_come_back_from_json(value):
    assert from_json(Whole, json.loads(json.dumps(to_json(value)))) == value


def test_unknown_keys_are_left_out_and_wrong_values_are_refused():
    assert from_json(Part, {"name": "a", "gone": 1}) == Part("a")
    with pytest.raises(InvalidValueError, match="allowed: Colour"):
        from_json(Whole, {"name": "a", "colour": "green"})
    with pytest.raises(InvalidValueError, match="Part"):
        from_json(Part, {"sizes": [1]})
