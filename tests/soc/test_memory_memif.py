"""The shared memory interface: cycles of the reference design, turns that lose no time."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.soc.memory import Forwarding, MemoryInterface, MemoryInterfaceError, round_robin_s, shared_s

MEMIF = MemoryInterface()


def test_a_chunk_takes_32_data_4_control_and_the_latency_cycles():
    assert MEMIF.data_cycles == 32
    assert MEMIF.read_cycles == 66
    assert MEMIF.read_s(256) == pytest.approx(660e-9)
    assert 256 / MEMIF.read_s(256) / 1e6 == pytest.approx(388, abs=1)


def test_without_latency_the_interface_reads_711_megabytes_a_second():
    quick = MemoryInterface(read_latency_cycles=0)
    assert 256 / quick.read_s(256) / 1e6 == pytest.approx(711, abs=1)


def test_a_stream_carries_a_word_a_cycle():
    assert MEMIF.stream_s(10_000_000) == pytest.approx(12.5e-3)
    assert MEMIF.stream_s(1) == pytest.approx(10e-9)


def test_a_part_of_a_chunk_costs_a_chunk():
    assert (MEMIF.chunks(1), MEMIF.chunks(256), MEMIF.chunks(257)) == (1, 1, 2)


def test_a_stored_chunk_costs_both_sides_a_passed_on_one_the_memory_side():
    passing = MemoryInterface(forwarding=Forwarding.CUT_THROUGH)
    assert MEMIF.memory_to_stream_s(25_600) == pytest.approx(MEMIF.read_s(25_600) + MEMIF.stream_s(25_600))
    assert MEMIF.stream_to_memory_s(25_600) == pytest.approx(MEMIF.write_s(25_600) + MEMIF.stream_s(25_600))
    assert passing.memory_to_stream_s(25_600) == passing.read_s(25_600)


@pytest.mark.parametrize("field", ["width_bytes", "clock_hz", "chunk_bytes"])
def test_an_interface_without_width_clock_or_chunk_is_refused(field):
    with pytest.raises(MemoryInterfaceError, match="must be above 0"):
        MemoryInterface(**{field: 0})


def test_negative_cycles_are_refused():
    with pytest.raises(MemoryInterfaceError, match="0 or more"):
        MemoryInterface(control_cycles=-1)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(0, 400), min_size=1, max_size=8), st.integers(1, 40))
def test_the_last_of_several_readers_ends_with_the_busy_period_whatever_the_turns(releases, chunks):
    ends = round_robin_s(releases, chunks, 1.0)
    assert max(ends) == pytest.approx(shared_s(releases, chunks))
    assert all(end >= release + chunks for end, release in zip(ends, releases, strict=True))


def test_readers_that_start_together_share_evenly():
    ends = round_robin_s([0.0] * 4, 100, 1.0)
    assert ends == [397.0, 398.0, 399.0, 400.0]
