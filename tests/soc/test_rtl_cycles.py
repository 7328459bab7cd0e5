"""Cycles of a message through the hardware: those of the memory model, and every word right."""

from functools import partial

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.soc.memory import MemoryInterface, round_robin_s, shared_s
from sfglab.soc.paper_values import MESSAGE_BYTES

rtl = pytest.importorskip("sfglab.soc.rtl", reason="needs the extra `rtl` (amaranth)")

OUT, IN, READS, WRITE = rtl.MemoryPath
QUICK = rtl.Delays(read=0, write=1)


def read(message_bytes, **more):
    return rtl.readers.simulate_readers(rtl.readers.Reading(message_bytes=message_bytes, **more))


def transfer(message_bytes, subscribers, **more):
    given = {
        "message_bytes": message_bytes,
        "subscribers": subscribers,
        "from_software": True,
        **more,
    }
    return rtl.cycles.simulate_transfer(rtl.cycles.Transfer(**given))


@pytest.mark.parametrize(
    ("path", "nodes", "chunks", "delays"),
    [
        *(
            (path, nodes, chunks, None)
            for path in (OUT, IN)
            for nodes, chunks in ((2, 80), (4, 20), (8, 40))
        ),
        *((path, 1, 40, QUICK) for path in (OUT, IN)),
        *((READS, nodes, 20, delays) for nodes in (1, 2, 8) for delays in (None, QUICK)),
        (WRITE, 1, 20, None),
    ],
)
def test_hardware_takes_the_cycles_of_its_model_and_of_memory_s_and_one_for_a_publisher_s_id(
    path, nodes, chunks, delays
):
    gateway = path in (OUT, IN)
    model = rtl.cycle_model(
        path, 2 if gateway else nodes, delays
    )  # a gateway's is any number's of subscribers
    assert rtl.simulated_cycles(path, nodes, 256 * chunks, delays) == model.cycles(256 * chunks)
    for size in (256 * chunks, *MESSAGE_BYTES):
        wanted = rtl.memory_model_cycles(path, nodes, size, delays)
        assert model.cycles(size) == pytest.approx(wanted + gateway)


@pytest.mark.parametrize("path", [OUT, IN, READS])
def test_a_last_chunk_that_is_not_full_takes_less_than_a_full_one(path):
    model = rtl.cycle_model(path, 2)
    for more_bytes in (8, 232):
        assert (
            model.cycles(2560)
            < rtl.simulated_cycles(path, 2, 2560 + more_bytes)
            < model.cycles(2561)
        )


@pytest.mark.parametrize("from_software", [True, False])
def test_subscribers_that_do_not_listen_hold_the_stream_up_and_lose_nothing(from_software):
    free, held_up = (
        transfer(2048, 4, from_software=from_software, stalled=stalled) for stalled in (0, 4)
    )
    assert held_up > 1.3 * free


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(0, 500), min_size=1, max_size=5), st.integers(1, 3), st.integers(0, 20))
def test_each_reader_ends_in_the_model_s_cycle_whenever_it_starts(releases, chunks, latency):
    delays = rtl.Delays(read=latency)
    found = read(256 * chunks, readers=len(releases), releases=tuple(releases), delays=delays)
    chunk_cycles = MemoryInterface(read_latency_cycles=latency).read_cycles
    assert list(found.ends) == round_robin_s(releases, chunks, chunk_cycles)
    assert found.read_cycles == shared_s(releases, chunks * chunk_cycles)


def test_what_a_publisher_wrote_over_the_same_interface_reaches_all_readers():
    found = read(2_560, readers=3, written=True, releases=(0, 40, 2_000))
    assert found.write_cycles == 10 * MemoryInterface().write_cycles
    assert found.read_cycles == max(found.ends)


def test_a_wrong_word_is_noticed(monkeypatch):
    def spoilt(port, content, delays, make=rtl.cycles.SlowMemory):
        return make(port, [content[0], content[1] ^ 1, *content[2:]], delays)

    monkeypatch.setattr(rtl.readers, "SlowMemory", spoilt)
    with pytest.raises(SfglabError, match="reader 0, word 1"):
        read(512, readers=2)


@pytest.mark.parametrize(
    "simulate",
    [
        *(partial(transfer, size, 1) for size in (0, 12)),
        *(partial(read, size, readers=2) for size in (0, 12)),
        partial(transfer, 64, -1),
        partial(transfer, 64, 1, stalled=8),
        partial(read, 64, readers=0),
        *(partial(read, 64, readers=2, releases=releases) for releases in ((1,), (1, -1))),
        partial(rtl.Delays, write=0),  # it takes at least a cycle
    ],
)
def test_what_cannot_be_simulated_is_refused(simulate):
    with pytest.raises(InvalidValueError, match=r"given .*, allowed: "):
        simulate()
