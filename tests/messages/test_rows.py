from dataclasses import dataclass

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


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyRow:
    """One measurement."""

    sent: int  #: Messages that were sent.
    #: Mean latency, in seconds; it has a long
    #: explanation.
    mean_s: float
    lossless: bool
    agent: str


def row(**changes):
    values = {"sent": 3, "mean_s": 0.25, "lossless": True, "agent": "r1"}
    return LatencyRow(**values | changes)


def test_a_dataclass_becomes_a_definition_with_its_docs_and_a_row_comes_back_field_by_field():
    assert type_name(row_type(LatencyRow)) == "sfglab_rows/msg/LatencyRow"
    assert definition(row_type(LatencyRow)) == (
        "int64 sent  # Messages that were sent.\n"
        "float64 mean_s  # Mean latency, in seconds; it has a long explanation.\n"
        "bool lossless\nstring agent\n"
    )
    for given in (row(), row(sent=np.int64(3), mean_s=np.float32(0.25), lossless=np.True_)):
        read = deserialize(serialize(row_message(given)), row_type(LatencyRow))
        assert (read.sent, read.mean_s, read.lossless, read.agent) == (3, 0.25, True, "r1")


def test_a_value_that_would_be_bent_is_refused():
    with pytest.raises(MessageError, match=r"LatencyRow: .* mean_s: given None, allowed: float64"):
        serialize(row_message(row(mean_s=None)))


@pytest.mark.parametrize("annotation", [float | None, dict, tuple[int, ...]])
def test_a_field_that_no_row_can_hold_is_named(annotation):
    bad = dataclass(type("BadRow", (), {"__annotations__": {"value": annotation}}))
    with pytest.raises(MessageError, match=r"BadRow.value: given .* allowed: int, float, bool"):
        row_type(bad)


def test_what_is_no_dataclass_is_refused():
    with pytest.raises(MessageError, match="allowed: dataclasses"):
        row_message({"a": 1})
