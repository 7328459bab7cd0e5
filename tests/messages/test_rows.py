from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np
import pytest

from sfglab.messages import (
    MessageError,
    definition,
    deserialize,
    row_message,
    row_type,
    serialize,
    type_name,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Side(Enum):
    PLAIN = "without proxy"
    PROXY = "with proxy"


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyRow:
    """One measurement."""

    sent: int  #: Messages that were sent.
    #: Mean latency, in seconds; it has a long
    #: explanation.
    mean_s: float
    lossless: bool
    agent: str
    side: Side  #: Which side.
    samples_s: tuple[float, ...]
    sizes: list[int]
    names: list[str]
    image: NDArray[np.uint8]


def row(**changes):
    single = {"sent": 3, "mean_s": 0.25, "lossless": True, "agent": "r1", "side": Side.PROXY}
    several = {
        "samples_s": (0.5, 1.5),
        "sizes": [],
        "names": ["a", ""],
        "image": np.arange(3, dtype=np.uint8),
    }
    return LatencyRow(**single | several | changes)


def test_a_dataclass_becomes_a_definition_with_its_docs_and_a_row_comes_back_field_by_field():
    assert type_name(row_type(LatencyRow)) == "sfglab_rows/msg/LatencyRow"
    assert definition(row_type(LatencyRow)) == (
        "int64 sent  # Messages that were sent.\n"
        "float64 mean_s  # Mean latency, in seconds; it has a long explanation.\n"
        "bool lossless\nstring agent\nstring side  # Which side.\nfloat64[] samples_s\nint64[] sizes\n"
        "string[] names\nuint8[] image\n"
    )
    read = deserialize(serialize(row_message(row())), row_type(LatencyRow))
    assert (read.sent, read.mean_s, read.lossless, read.agent, read.side) == (
        3,
        0.25,
        True,
        "r1",
        "with proxy",
    )
    assert (read.samples_s.tolist(), read.sizes.tolist(), read.names) == ([0.5, 1.5], [], ["a", ""])
    assert read.image.tolist() == [0, 1, 2]
    numpy = row(sent=np.int64(4), mean_s=np.float32(0.5), image=np.arange(8, dtype=np.uint8)[::2])
    assert deserialize(serialize(row_message(numpy)), row_type(LatencyRow)).image.tolist() == [
        0,
        2,
        4,
        6,
    ]


@pytest.mark.parametrize(
    ("field", "value", "complaint"),
    [
        ("mean_s", None, "LatencyRow.mean_s: given None, allowed is float64: use NaN"),
        ("sizes", [1.5], r"LatencyRow.sizes: given \[1.5\], allowed is int64\[\]"),
        ("image", np.zeros(3), r"LatencyRow.image: given .*allowed is uint8\[\]"),
    ],
)
def test_values_that_would_be_bent_are_refused(field, value, complaint):
    with pytest.raises(MessageError, match=complaint):
        row_message(row(**{field: value}))


def local_class(name, **annotations):
    return dataclass(type(name, (), {"__annotations__": annotations, "__module__": __name__}))


@pytest.mark.parametrize(
    ("annotation", "complaint"),
    [
        (float | None, "NaN or an empty value"),
        (dict, "allowed are int"),
        (tuple[int, str], "allowed are int"),
        ("NDArray[np.complex128]", "NDArray of numbers"),
        ("np.ndarray", "NDArray of numbers"),
        ("Nowhere", "'Nowhere' is not defined: annotations must be importable"),
    ],
)
def test_fields_that_no_message_can_hold_are_named(annotation, complaint):
    with pytest.raises(MessageError, match=complaint):
        row_type(local_class("BadRow", value=annotation))


def test_names_that_no_message_can_have_are_refused():
    for field in ("Big", "two__lines", "end_"):
        with pytest.raises(MessageError, match=f"BadRow.{field}"):
            row_type(local_class("BadRow", **{field: int}))
    for row_class in (local_class("lower", x=int), int):
        with pytest.raises(MessageError, match="CamelCase"):
            row_type(row_class)
    with pytest.raises(MessageError, match="at least one field"):
        row_type(local_class("EmptyRow"))
