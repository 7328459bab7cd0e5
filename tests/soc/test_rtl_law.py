"""Cycles of a message through the hardware: a law that holds, and the memory model's."""

from __future__ import annotations

import pytest

from sfglab.soc.memory import MemoryInterface

rtl = pytest.importorskip("sfglab.soc.rtl", reason="needs the extra `rtl` (amaranth)")


def cycles(message_bytes, subscribers, *, from_software, **more):
    transfer = rtl.Transfer(
        message_bytes=message_bytes, subscribers=subscribers, from_software=from_software, **more
    )
    return rtl.simulate_transfer(transfer).cycles


@pytest.mark.parametrize("from_software", [True, False])
def test_the_law_of_small_messages_holds_for_a_larger_one_and_any_number_of_subscribers(from_software):
    law = rtl.measured_law(2, from_software=from_software)
    for subscribers, chunks in ((2, 80), (4, 20), (8, 40)):
        wanted = law.cycles(256 * chunks)
        assert cycles(256 * chunks, subscribers, from_software=from_software) == wanted


@pytest.mark.parametrize("from_software", [True, False])
@pytest.mark.parametrize("delays", [rtl.Delays(), rtl.Delays(read=0, write=1)])
def test_the_hardware_takes_the_model_s_cycles_and_one_for_the_publisher_s_id(from_software, delays):
    model = MemoryInterface(read_latency_cycles=delays.read, write_latency_cycles=delays.write)
    law = rtl.measured_law(1, from_software=from_software, delays=delays)
    for message_bytes in (10_240, 10_000_000):
        stored = rtl.model_cycles(message_bytes, from_software=from_software, memory=model)
        assert law.cycles(message_bytes) == pytest.approx(stored + 1)


@pytest.mark.parametrize("from_software", [True, False])
def test_a_last_chunk_that_is_not_full_takes_at_most_what_a_full_one_would(from_software):
    law = rtl.measured_law(2, from_software=from_software)
    found = cycles(1000, 2, from_software=from_software)
    assert law.cycles(768) < found < law.cycles(1000)


@pytest.mark.parametrize("from_software", [True, False])
def test_subscribers_that_do_not_listen_hold_the_stream_up_and_lose_nothing(from_software):
    free = cycles(2048, 4, from_software=from_software)
    held_up = cycles(2048, 4, from_software=from_software, stalled=4)
    assert held_up > 1.3 * free


@pytest.mark.parametrize(
    "wrong", [{"message_bytes": 0}, {"message_bytes": 12}, {"stalled": 8}, {"delays": rtl.Delays(write=0)}]
)
def test_transfers_that_cannot_be_are_refused(wrong):
    with pytest.raises(rtl.HardwareError):
        rtl.Transfer(**{"message_bytes": 64, "subscribers": 1, "from_software": True, **wrong})
