"""Cycles of a message through the hardware: those of the memory model, and every word right."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.errors import SfglabError
from sfglab.soc.memory import MemoryInterface, round_robin_s
from sfglab.soc.paper_values import MESSAGE_BYTES

rtl = pytest.importorskip("sfglab.soc.rtl", reason="needs the extra `rtl` (amaranth)")

ChunkNode = rtl.bench.ChunkNode
OUT, IN, READS, WRITE = rtl.MemoryPath
SIZE = 256 * 12


@pytest.mark.parametrize("delays", [None, rtl.Delays(read=0, write=1)], ids=["default", "quick"])
@pytest.mark.parametrize("nodes", [1, 2, 4, 8])
@pytest.mark.parametrize("path", rtl.MemoryPath)
def test_hardware_takes_the_cycles_of_the_memory_model_and_one_for_a_publisher_s_id(
    path, nodes, delays
):
    model = rtl.cycle_model(path, nodes, delays)
    assert rtl.simulated_cycles(path, nodes, SIZE, delays) == model.cycles(SIZE)
    delays = delays or rtl.Delays()
    memif = MemoryInterface(read_latency_cycles=delays.read, write_latency_cycles=delays.write)
    chunk_cycles = {
        OUT: memif.memory_to_stream_cycles,
        IN: memif.stream_to_memory_cycles,
        READS: nodes * memif.read_cycles,
        WRITE: memif.write_cycles,
    }
    for message_bytes in (SIZE, *MESSAGE_BYTES):
        expected = memif.chunks(message_bytes) * chunk_cycles[path] + (path in (OUT, IN))
        assert model.cycles(message_bytes) == pytest.approx(expected)


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(0, 500), min_size=1, max_size=5), st.integers(1, 3), st.integers(0, 20))
def test_each_reader_ends_in_the_model_s_cycle_whenever_it_starts(starts, chunks, latency):
    words = 32 * chunks
    readers = [ChunkNode(words, start_cycle=start) for start in starts]
    ends = rtl.cycles.simulate_nodes(readers, words, rtl.Delays(read=latency))
    chunk_cycles = MemoryInterface(read_latency_cycles=latency).read_cycles
    assert ends == round_robin_s(starts, chunks, chunk_cycles)


def test_a_wrong_word_and_a_bench_that_is_not_done_are_errors(monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(rtl.bench, "WORD_FACTOR", 2)  # of the writer, not of the expected words
        patch.setattr(rtl.cycles, "message_words", lambda *_: [0, 3])
        with pytest.raises(SfglabError, match="memory, word 1: 0x2, must be 0x3"):
            rtl.simulated_cycles(WRITE, 1, 512)
    monkeypatch.setattr(rtl.cycles, "cycle_limit", lambda *_: 50)
    with pytest.raises(SfglabError, match="GatewayBench: no result after 50 cycles"):
        rtl.simulated_cycles(OUT, 1, 512)
