"""From which message size on a gateway is worth it (paper C: small messages lose by one)."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.soc.memory import (
    CUT_THROUGH,
    LARGEST_BYTES,
    STORED,
    Judge,
    Setup,
    Side,
    Times,
    Transport,
    break_even_bytes,
    faster_transport,
    judged_s,
)

CHUNK_BYTES = STORED.memory.chunk_bytes


def setup(publisher: Side, hardware: int, software: int = 1) -> Setup:
    return Setup(
        publisher=publisher,
        transport=Transport.SMT,
        message_bytes=CHUNK_BYTES,
        hardware=hardware,
        software=software,
    )


@pytest.mark.parametrize("costs", [STORED, CUT_THROUGH], ids=["stored", "cut-through"])
def test_for_one_hardware_subscriber_a_gateway_never_serves_a_software_publisher_better(costs):
    assert break_even_bytes(setup(Side.SOFTWARE, 1), Judge.HARDWARE, costs) is None


def test_more_hardware_subscribers_make_a_gateway_worth_it_for_smaller_messages():
    sizes = [break_even_bytes(setup(Side.SOFTWARE, n), Judge.HARDWARE) for n in (2, 3, 4, 8)]
    assert sizes == [301_056, 101_120, 60_928, 11_264]


def test_between_hardware_nodes_a_gateway_is_worth_it_at_any_size():
    assert break_even_bytes(setup(Side.HARDWARE, 2), Judge.HARDWARE) == CHUNK_BYTES


def test_who_counts_decides():
    found = {judge: break_even_bytes(setup(Side.HARDWARE, 4), judge) for judge in Judge}
    assert found[Judge.HARDWARE] == found[Judge.MEAN] == CHUNK_BYTES
    assert found[Judge.LAST] == 27_392
    assert found[Judge.SOFTWARE] is None


@given(
    publisher=st.sampled_from(Side),
    hardware=st.integers(1, 8),
    software=st.integers(0, 3),
    judge=st.sampled_from(Judge),
    message_bytes=st.integers(1, LARGEST_BYTES),
)
def test_below_the_break_even_the_topic_is_faster_and_above_it_the_gateway(
    publisher, hardware, software, judge, message_bytes
):
    at = setup(publisher, hardware, software)
    limit = break_even_bytes(at, judge)
    found = faster_transport(replace(at, message_bytes=message_bytes), judge)
    if limit is None or message_bytes <= limit - CHUNK_BYTES:
        assert found is Transport.SMT
    elif message_bytes >= limit:
        assert found is Transport.GATEWAY


def test_nobodys_time_is_zero():
    alone = setup(Side.SOFTWARE, 0, 0)
    assert judged_s(Times(hardware_s=None, software_s=None), alone, Judge.MEAN) == 0.0
    assert faster_transport(alone) is Transport.SMT
