"""The module `reader` has the compiled reader: arriving samples, heartbeats and gaps, and responses (RTPS 2.5, 8.4.12).

In all functions `world` is the state of the run, `now` is nanoseconds, and `flow` is the reader's flow. A prompt
vendor, such as Cyclone DDS, responds to a heartbeat at once, other vendors after a delay (`Vendor.prompt`).
"""

from __future__ import annotations

from typing import Any

from sfglab.rtps.medium import enqueue, fragment_count, has_bit, new_frame, set_bit
from sfglab.rtps.state import BITMAP, Arrival, Count, Event, Fate, Frame
from sfglab.rtps.world import compiled, push


@compiled
def _keep(world: Any, flow: int, sample: int) -> None:
    """Add a sample to the reader's history, from which the executor takes the sample."""
    reader = world.reader[flow]
    world.order[flow, reader.tail] = sample
    reader.tail += 1
    world.server[world.flows[flow].server].waiting += 1


@compiled
def _drop_oldest(world: Any, flow: int) -> None:
    """Drop the oldest sample of a reader's history, because a newer sample takes its place."""
    reader = world.reader[flow]
    world.fate[flow, world.order[flow, reader.head]] = Fate.LATE
    reader.head += 1
    world.server[world.flows[flow].server].waiting -= 1


@compiled
def _make_room(world: Any, flow: int) -> None:
    """Drop the oldest sample of a history that exceeds its depth; samples behind a gap count in the depth."""
    reader = world.reader[flow]
    depth = world.flows[flow].reader_depth
    held = reader.tail - reader.head
    if held + reader.behind_gap <= depth:
        return
    if held > 0:
        _drop_oldest(world, flow)
        return
    oldest = max(reader.oldest, reader.next)
    while world.arrived[flow, oldest] != Arrival.HERE:
        oldest += 1
    reader.oldest = oldest + 1
    reader.behind_gap -= 1
    world.arrived[flow, oldest] = Arrival.GONE
    world.fate[flow, oldest] = Fate.LATE


@compiled
def drop_overflow(world: Any, flow: int) -> None:
    """Drop the oldest samples of a history that exceeds its depth after a gap has closed and all later samples came."""
    reader, depth = world.reader[flow], world.flows[flow].reader_depth
    while reader.tail - reader.head > depth:
        _drop_oldest(world, flow)


@compiled
def _advance(world: Any, flow: int) -> None:
    """Deliver available samples in order, and give up samples that the writer no longer has."""
    reader = world.reader[flow]
    # The value `last` limits the loop; the reader makes no decision with `last`.
    last = world.writer[flow].last
    sample = reader.next
    while sample <= last:
        arrived = world.arrived[flow, sample]
        if arrived == Arrival.HERE:
            reader.behind_gap -= 1
            _keep(world, flow, sample)
        elif arrived == Arrival.GONE or sample < reader.writer_oldest:
            if world.fate[flow, sample] == Fate.UNDERWAY:
                world.fate[flow, sample] = Fate.OVERWRITTEN
        else:
            break
        sample += 1
    reader.next = sample


@compiled
def _make_room_behind_gap(world: Any, flow: int, sample: int) -> bool:
    """Return whether the reader can keep a sample; the reader drops the newest if too many wait behind a gap."""
    reader = world.reader[flow]
    if sample == reader.next or reader.behind_gap < world.timing.reorder_most:
        return True
    newest = reader.newest
    if sample > newest:
        return False
    world.arrived[flow, newest] = Arrival.MISSING
    reader.behind_gap -= 1
    while newest > sample and world.arrived[flow, newest] != Arrival.HERE:
        newest -= 1
    reader.newest = newest
    return True


@compiled
def _hear_sample(world: Any, flow: int, sample: int) -> None:
    """Take a sample, unless the reader has taken it before."""
    reader = world.reader[flow]
    apart = world.timing.reorder_most != 0
    if world.arrived[flow, sample] != Arrival.MISSING or sample < reader.next:
        return
    if apart and not _make_room_behind_gap(world, flow, sample):
        return
    world.arrived[flow, sample] = Arrival.HERE
    reader.newest = max(reader.newest, sample)
    if not world.flows[flow].reliable:
        _keep(world, flow, sample)
        reader.next = sample + 1
    else:
        reader.behind_gap += 1
        if sample == reader.next:
            _advance(world, flow)
        # The sample was retransmitted, and is older than a sample that was dropped before.
        elif sample < reader.oldest:
            reader.oldest = sample
    if not apart:
        _make_room(world, flow)


@compiled
def is_whole(world: Any, frame: Any) -> bool:
    """Return whether a frame brings samples; a BURST brings samples if all its FRAGMENTs have arrived before."""
    flow = frame.flow
    reader = world.reader[flow]
    if frame.kind == Frame.FRAGMENT:
        follows = frame.sample in (0, reader.fragments)
        reader.fragments = frame.sample + 1 if follows else -1
        return False
    before = fragment_count(world.flows[flow].size_bytes, frame.samples, frame.heartbeats)
    return bool(before in (0, reader.fragments))


@compiled
def hear_samples(world: Any, frame: Any) -> None:
    """Take the sample of a DATA frame, or the samples of a BURST."""
    if frame.kind == Frame.DATA:
        _hear_sample(world, frame.flow, frame.sample)
        return
    for place in range(BITMAP):
        if has_bit(frame.bits, place):
            _hear_sample(world, frame.flow, frame.sample + place)


@compiled
def hear_gap(world: Any, frame: Any) -> None:
    """Give up the samples that the writer no longer has."""
    flow = frame.flow
    for sample in range(max(frame.sample, world.reader[flow].next), frame.sample + frame.samples):
        if world.arrived[flow, sample] == Arrival.MISSING:
            world.arrived[flow, sample] = Arrival.GONE
    _advance(world, flow)


@compiled
def hear_heartbeat(world: Any, now: int, frame: Any) -> None:
    """Record the samples that a heartbeat announces, and respond: a prompt reader at once, others after their delay."""
    flow, timing = frame.flow, world.timing
    reader = world.reader[flow]
    if not frame.final:
        reader.asked = 1
    if frame.kind in (Frame.GAP, Frame.BURST):
        reader.repaired = 1
    reader.writer_oldest = max(reader.writer_oldest, frame.oldest)
    reader.writer_newest = max(reader.writer_newest, frame.newest)
    _advance(world, flow)
    if timing.prompt:
        _answer(world, now, flow)
    elif not reader.armed:
        reader.armed = 1
        delay_ns = (
            timing.nack_delay_ns if reader.next <= reader.writer_newest else timing.ack_delay_ns
        )
        push(world.heap, world.heap_sizes, now + delay_ns, Event.ACKNACK, flow)


@compiled
def request(world: Any, now: int, flow: int) -> None:
    """Acknowledge all samples before the next sample, and request the announced samples that have not arrived."""
    reader, frame = world.reader[flow], new_frame(world, Frame.ACKNACK, flow)
    most = min(world.timing.nack_most, reader.writer_newest - reader.next + 1)
    for place in range(most):
        if world.arrived[flow, reader.next + place] == Arrival.MISSING:
            set_bit(frame.bits, place)
    _acknowledge(world, now, frame)


@compiled
def _acknowledge(world: Any, now: int, frame: Any) -> None:
    """Send an ACKNACK, which acknowledges all samples before the next sample."""
    frame.sample = world.reader[frame.flow].next
    world.counts[Count.ACKNACK] += 1
    enqueue(world, now, world.flows[frame.flow].target, frame)


@compiled
def _answer(world: Any, now: int, flow: int) -> None:
    """Respond to a heartbeat as a prompt reader, or send no response.

    A prompt reader at once requests samples that no request has covered yet. The reader requests the same samples again
    after the vendor's `nack_delay_ns`, and also when retransmissions have arrived without these samples, unless the
    last request was a repetition after `nack_delay_ns`. The reader sends an acknowledgement only when the writer
    requests one, and repeats the same acknowledgement only after `ack_delay_ns`.
    """
    reader, timing = world.reader[flow], world.timing
    if reader.next <= reader.writer_newest:
        fresh = reader.next >= reader.nacked
        waited = now >= reader.nacked_ns + timing.nack_delay_ns
        in_vain = reader.repaired and (waited or not reader.repeated)
        if fresh or in_vain or waited:
            reader.repeated = 0 if fresh or in_vain else 1
            reader.nacked = min(reader.writer_newest + 1, reader.next + timing.nack_most)
            reader.nacked_ns = now
            _note_answer(world, now, flow)
            request(world, now, flow)
            return
    is_new = reader.next > reader.answered_next or now >= reader.answered_ns + timing.ack_delay_ns
    if reader.asked and is_new:
        _note_answer(world, now, flow)
        _acknowledge(world, now, new_frame(world, Frame.ACKNACK, flow))


@compiled
def _note_answer(world: Any, now: int, flow: int) -> None:
    reader = world.reader[flow]
    reader.asked = 0
    reader.repaired = 0
    reader.answered_next = reader.next
    reader.answered_ns = now
