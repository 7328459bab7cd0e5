"""Hardware readers of a software-mapped topic, one memory interface: the model's cycles, every word right."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.messages import row_type
from sfglab.soc.memory import MemoryInterface, round_robin_s

rtl = pytest.importorskip("sfglab.soc.rtl", reason="needs the extra `rtl` (amaranth)")

SIZES = [10_000, 100_000, 1_000_000, 10_000_000]
PATHS = list(rtl.MemoryPath)


def read(message_bytes, **more):
    return rtl.simulate_readers(rtl.Reading(message_bytes=message_bytes, **more))


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(0, 500), min_size=1, max_size=5), st.integers(1, 3), st.integers(0, 20))
def test_each_reader_ends_in_the_model_s_cycle_whenever_it_starts(releases, chunks, latency):
    delays = rtl.Delays(read=latency)
    found = read(256 * chunks, readers=len(releases), releases=tuple(releases), delays=delays)
    model = MemoryInterface(read_latency_cycles=latency)
    assert list(found.ends) == round_robin_s(releases, chunks, model.read_cycles)
    assert found.read_cycles == pytest.approx(rtl.model_reading_cycles(256 * chunks, releases, model))


@pytest.mark.parametrize("delays", [rtl.Delays(), rtl.Delays(read=0)])
def test_so_many_readers_take_so_many_times_what_one_takes(delays):
    one = MemoryInterface(read_latency_cycles=delays.read).read_cycles
    for readers in (1, 2, 4):
        law = rtl.measured_readers_law(readers, delays)
        assert law == rtl.CycleLaw(fixed_cycles=0, chunk_cycles=readers * one)


def test_what_a_publisher_wrote_over_the_same_interface_reaches_all_readers():
    found = read(2_560, readers=3, written=True, releases=(0, 40, 2_000))
    assert found.write_cycles == pytest.approx(MemoryInterface().write_s(2_560) * 100e6)
    assert found.read_cycles == max(found.ends)
    assert rtl.measured_writer_law() == rtl.CycleLaw(fixed_cycles=0, chunk_cycles=45)


def test_a_wrong_word_is_noticed(monkeypatch):
    from sfglab.soc.rtl.cycles import SlowMemory

    def spoilt(port, content, delays):
        return SlowMemory(port, [content[0], content[1] ^ 1, *content[2:]], delays)

    monkeypatch.setattr("sfglab.soc.rtl.readers.SlowMemory", spoilt)
    with pytest.raises(rtl.HardwareError, match="reader 0, word 1"):
        read(512, readers=2)


@pytest.mark.parametrize(
    ("path", "nodes"), [(path, nodes) for path in PATHS[:3] for nodes in (2, 8)] + [(PATHS[3], 1)]
)
def test_model_and_law_agree_within_five_percent_at_every_size_of_the_paper(path, nodes):
    rows = rtl.path_cycles(path, nodes, SIZES)
    assert [row.message_bytes for row in rows] == SIZES
    assert max(abs(row.residual) for row in rows) < 0.05


@pytest.mark.parametrize(("path", "nodes"), [(PATHS[0], 2), (PATHS[1], 2), (PATHS[2], 4), (PATHS[3], 1)])
def test_the_laws_are_exact_for_whole_chunks_and_the_model_is_but_for_the_publisher_s_id(path, nodes):
    row = rtl.check_law(path, nodes, 5_120)
    assert row.law_residual == 0
    assert row.simulated_cycles - row.model_cycles == pytest.approx(1.0 if path in PATHS[:2] else 0.0)


def test_a_last_chunk_with_a_single_word_makes_model_and_law_too_slow_by_less_than_a_chunk():
    row = rtl.check_law(PATHS[2], 2, 5_128)
    one = MemoryInterface().read_cycles
    assert 0 < row.law_cycles - row.simulated_cycles < 2 * one
    assert row.model_residual == pytest.approx(row.law_residual)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("path", "nodes", "message_bytes"), [(PATHS[0], 1, 100_000), (PATHS[1], 1, 40_000), (PATHS[2], 2, 40_000)]
)
def test_laws_and_model_hold_far_above_the_sizes_the_laws_were_made_from(path, nodes, message_bytes):
    row = rtl.check_law(path, nodes, message_bytes)
    assert row.message_bytes == message_bytes
    assert 0 <= row.law_residual < 0.005
    assert 0 <= row.model_residual < 0.005


@pytest.mark.parametrize("row", [rtl.PathCycles, rtl.LawCheck, rtl.ReadingCycles, rtl.ArbiterArea])
def test_results_are_rows(row):
    assert row_type(row)


@pytest.mark.parametrize(
    "wrong",
    [
        {"message_bytes": 0},
        {"message_bytes": 12},
        {"readers": 0},
        {"releases": (1,)},
        {"releases": (1, -1)},
        {"delays": rtl.Delays(write=0)},
    ],
)
def test_readings_that_cannot_be_are_refused(wrong):
    with pytest.raises(rtl.HardwareError):
        rtl.Reading(**{"message_bytes": 64, "readers": 2, **wrong})
