"""The writer, compiled: what it publishes, its heartbeats, and its repairs (RTPS 2.5, clause 8.4.9).

In all functions `world` is the run, `now` is nanoseconds, and `flow` is whose writer it is.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sfglab.rtps.medium import (
    burst_most,
    enqueue,
    fragment_count,
    has_room,
    message_bytes,
    note_drop,
    uniform,
)
from sfglab.rtps.model import BURST_ROOM
from sfglab.rtps.state import SET, Count, Drop, Event, FlowColumn, Frame, TimingColumn, W
from sfglab.rtps.world import compiled, push


@compiled
def _send(world: Any, now: int, what: Any, arguments: Any, kept: Any) -> None:
    kind, flow = what
    world.counts[kind] += 1
    frame = world.scratch[1]
    frame[0], frame[1] = kind, flow
    frame[2], frame[3] = arguments
    frame[4], frame[5] = kept
    enqueue(world, now, world.flows[flow, FlowColumn.SOURCE], frame)


@compiled
def _first_kept(world: Any, flow: int) -> int:
    """Return the oldest sample in the writer's history."""
    depth, last = world.flows[flow, FlowColumn.DEPTH], world.writer[flow, W.LAST]
    if depth == 0:
        return int(world.writer[flow, W.ACKED] + 1)
    return int(max(1, last - depth + 1))


@compiled
def _sample_value(world: Any, now: int, flow: int) -> int:
    """Return the number of the value that the sensor has now; it changes at random times."""
    mean = world.flows[flow, FlowColumn.CHANGE_NS]
    writer = world.writer
    if mean == 0:
        writer[flow, W.VALUE] += 1
    elif mean != SET:
        while now >= writer[flow, W.CHANGE_AT]:
            writer[flow, W.VALUE] += 1
            wait = -math.log(1.0 - uniform(world.random)) * mean
            writer[flow, W.CHANGE_AT] += max(1, int(wait))
    return int(writer[flow, W.VALUE])


@compiled
def _held_back(world: Any, now: int, flow: int, value: int) -> bool:
    """Return whether the local cache holds a value back (paper B, section 2.2)."""
    if not world.flows[flow, FlowColumn.CACHED] or value != world.writer[flow, W.SENT]:
        return False
    silence = world.flows[flow, FlowColumn.SILENCE_NS]
    return bool(silence == 0 or now - world.writer[flow, W.SENT_AT] < silence)


@compiled
def _piggybacks(world: Any, flow: int) -> bool:
    timing, depth, last = (
        world.timing,
        world.flows[flow, FlowColumn.DEPTH],
        world.writer[flow, W.LAST],
    )
    if timing[TimingColumn.PIGGYBACK_WHEN_FULL]:
        # Without late joiners to keep it for, what is acknowledged leaves the history.
        gone = 0 if world.flows[flow, FlowColumn.KEEPS_ACKED] else world.writer[flow, W.ACKED]
        if depth > 0 and last - gone >= depth:
            return True
        if depth == 0 and last - world.writer[flow, W.ACKED] >= timing[TimingColumn.UNACKED_MOST]:
            return True
    return bool(timing[TimingColumn.PROMPT])


@compiled
def _heartbeats(world: Any, now: int, flow: int, samples: int, repairs: bool) -> int:  # noqa: FBT001 - compiled
    """Return how many heartbeats travel with so many samples, one behind each at most, and note them."""
    writer, most = world.writer, world.timing[TimingColumn.PIGGYBACK_BYTES]
    if not world.flows[flow, FlowColumn.RELIABLE]:
        return 0
    each, count = _piggybacks(world, flow), 0
    before = world.timing[TimingColumn.SENT_BEFORE]
    own = message_bytes(world.flows[flow, FlowColumn.SIZE_BYTES])
    for _ in range(samples):
        sent = own
        if before >= 0 and (repairs or world.timing[TimingColumn.QUEUES]):
            writer[flow, W.BYTES] += own
            sent = before + writer[flow, W.BYTES]
        writer[flow, W.UNSHOWN] += sent
        if each or writer[flow, W.UNSHOWN] > most > 0:
            writer[flow, W.LAST_HB], writer[flow, W.UNSHOWN] = now, 0
            count += 1
    return count


@compiled
def _send_data(world: Any, now: int, flow: int, sample: int) -> None:
    rides = _heartbeats(world, now, flow, 1, False)
    if rides and now - world.writer[flow, W.WROTE_AT] < world.timing[TimingColumn.FINAL_NS]:
        rides = 2
    world.writer[flow, W.WROTE_AT] = now
    last = world.writer[flow, W.LAST]
    _send(world, now, (Frame.DATA, flow), (sample, rides), (_first_kept(world, flow), last))


@compiled
def _is_full(world: Any, flow: int, unacked: int) -> bool:
    """Return whether a history of KEEP_LAST has no place for one more sample."""
    unsent = world.writer[flow, W.LAST] - world.writer[flow, W.QUEUED]
    kept = unacked if world.flows[flow, FlowColumn.RELIABLE] else unsent
    return bool(0 < world.flows[flow, FlowColumn.DEPTH] <= kept)


@compiled
def write(world: Any, now: int, flow: int) -> None:
    """Publish what the sensor has now, unless the local cache or a full history of KEEP_ALL holds it back."""
    writer = world.writer
    value = _sample_value(world, now, flow)
    if _held_back(world, now, flow, value):
        world.counts[Count.HELD] += 1
        return
    unacked = writer[flow, W.LAST] - writer[flow, W.ACKED]
    room = has_room(world, world.flows[flow, FlowColumn.SOURCE])
    goes = room and writer[flow, W.QUEUED] == writer[flow, W.LAST]
    if not goes and (
        not world.timing[TimingColumn.QUEUES] or (not room and _is_full(world, flow, unacked))
    ):
        # Whoever publishes still waits to be rid of what came before; or for the thread that sends, since only
        # then the oldest sample of a full history can go.
        world.counts[Count.THROTTLED] += 1
        return
    if (
        world.flows[flow, FlowColumn.RELIABLE]
        and world.flows[flow, FlowColumn.DEPTH] == 0
        and unacked >= world.timing[TimingColumn.UNACKED_MOST]
    ):
        world.counts[Count.THROTTLED] += 1
        return
    if writer[flow, W.LAST] + 1 >= world.fate.shape[1]:
        raise IndexError("more samples than the state has room for")
    writer[flow, W.SENT], writer[flow, W.SENT_AT] = value, now
    writer[flow, W.LAST] += 1
    sample = writer[flow, W.LAST]
    world.published_ns[flow, sample] = now
    world.value[flow, sample] = value
    if goes:
        writer[flow, W.QUEUED] = sample
        _send_data(world, now, flow, sample)
    if world.flows[flow, FlowColumn.RELIABLE] and not writer[flow, W.ARMED]:
        writer[flow, W.ARMED] = 1
        writer[flow, W.INTERVAL] = world.timing[TimingColumn.HEARTBEAT_NS]
        push(world.heap, world.heap_sizes, now + writer[flow, W.INTERVAL], Event.HEARTBEAT, flow)


@compiled
def send_unsent(world: Any, now: int, host: int) -> None:
    """Send what waits longest in the histories of a host whose queue has room again: of one flow, together."""
    oldest = -1
    for flow in range(world.flows.shape[0]):
        queued = world.writer[flow, W.QUEUED]
        if world.flows[flow, FlowColumn.SOURCE] == host and queued < world.writer[flow, W.LAST]:
            since = world.published_ns[flow, queued + 1]
            if oldest < 0 or since < world.published_ns[oldest, world.writer[oldest, W.QUEUED] + 1]:
                oldest = flow
    if oldest < 0 or not has_room(world, host):
        return
    last, frame = world.writer[oldest, W.LAST], world.scratch[1]
    first = max(world.writer[oldest, W.QUEUED] + 1, _first_kept(world, oldest))
    frame[0], frame[1] = Frame.DATA, oldest
    for sample in range(world.writer[oldest, W.QUEUED] + 1, first):
        frame[2] = sample
        note_drop(world, frame, Drop.QUEUE)
    most = burst_most(
        world.flows[oldest, FlowColumn.SIZE_BYTES], world.timing[TimingColumn.BURST_BYTES]
    )
    count = min(last - first + 1, most, 256)
    world.writer[oldest, W.QUEUED] = first + count - 1
    if count == 1:
        _send_data(world, now, oldest, first)
        return
    frame[:] = 0
    frame[0], frame[1], frame[2] = Frame.BURST, oldest, first
    frame[3] = _burst(count, _heartbeats(world, now, oldest, count, False), last)
    for i in range(count):
        frame[4 + i // 64] |= np.int64(1) << (i % 64)
    _send_together(world, now, oldest, frame)


@compiled
def heartbeat(world: Any, now: int, flow: int) -> None:
    """Say what there is while anything is unacknowledged, and again after the interval."""
    writer = world.writer
    writer[flow, W.ARMED] = 0
    if writer[flow, W.ACKED] >= writer[flow, W.LAST]:
        return
    due = writer[flow, W.LAST_HB] + world.timing[TimingColumn.HEARTBEAT_NS]
    if world.timing[TimingColumn.PROMPT] and now < due:
        writer[flow, W.ARMED] = 1
        push(world.heap, world.heap_sizes, due, Event.HEARTBEAT, flow)
        return
    writer[flow, W.LAST_HB], writer[flow, W.UNSHOWN] = now, 0
    _send(
        world,
        now,
        (Frame.HEARTBEAT, flow),
        (0, 0),
        (_first_kept(world, flow), writer[flow, W.LAST]),
    )
    stuck = writer[flow, W.ACKED] == writer[flow, W.ACKED_AT_HB]
    longer = min(2 * writer[flow, W.INTERVAL], world.timing[TimingColumn.HEARTBEAT_MAX_NS])
    grows = stuck and not world.timing[TimingColumn.PROMPT]
    writer[flow, W.INTERVAL] = longer if grows else world.timing[TimingColumn.HEARTBEAT_NS]
    writer[flow, W.ACKED_AT_HB] = writer[flow, W.ACKED]
    writer[flow, W.ARMED] = 1
    push(world.heap, world.heap_sizes, now + writer[flow, W.INTERVAL], Event.HEARTBEAT, flow)


@compiled
def hear_acknack(world: Any, now: int, frame: Any) -> None:
    """Take a reader's acknowledgement; what it asks for is repaired after the vendor's delay."""
    flow, base = frame[1], frame[2]
    writer, repair = world.writer, world.repair
    writer[flow, W.ACKED] = max(writer[flow, W.ACKED], base - 1)
    asked = (frame[4] | frame[5] | frame[6] | frame[7]) != 0
    if not asked:
        return
    waits = repair[flow, 0] != 0
    repair[flow, 0] = base
    for k in range(4):
        repair[flow, 1 + k] = frame[4 + k]
    if not waits:
        due = now + world.timing[TimingColumn.NACK_RESPONSE_NS]
        push(world.heap, world.heap_sizes, due, Event.REPAIR, flow)


@compiled
def repair(world: Any, now: int, flow: int) -> None:
    """Send again what the last request asked for, and declare what is gone."""
    base = world.repair[flow, 0]
    world.repair[flow, 0] = 0
    kept = _first_kept(world, flow)
    if world.timing[TimingColumn.BURST_BYTES]:
        _repair_in_bursts(world, now, flow, base, kept)
        return
    if base < kept and world.timing[TimingColumn.GAPS]:
        _send(world, now, (Frame.GAP, flow), (base, kept), (0, 0))
    for k in range(4):
        word = world.repair[flow, 1 + k]
        if word == 0:
            continue
        for i in range(64):
            if (word >> i) & 1:
                sample = base + 64 * k + i
                if kept <= sample <= world.writer[flow, W.QUEUED]:
                    world.counts[Count.REPEATED] += 1
                    _send_data(world, now, flow, sample)


@compiled
def _repair_in_bursts(world: Any, now: int, flow: int, base: int, kept: int) -> None:
    """Send what was asked for, many samples a message; a prompt vendor sends a heartbeat with the last one."""
    prompt = world.timing[TimingColumn.PROMPT]
    last = world.writer[flow, W.QUEUED]
    most = burst_most(
        world.flows[flow, FlowColumn.SIZE_BYTES], world.timing[TimingColumn.BURST_BYTES]
    )
    left = 0
    for i in range(256):
        left += _asked(world, flow, i) and kept <= base + i <= last
    frame = world.scratch[1]
    frame[:] = 0
    if base < kept and world.timing[TimingColumn.GAPS]:
        frame[0], frame[1], frame[2], frame[3] = Frame.GAP, flow, base, kept
        frame[4], frame[5] = kept, last if left == 0 and prompt else 0
        world.counts[Count.GAP] += 1
        enqueue(world, now, world.flows[flow, FlowColumn.SOURCE], frame)
    inside = 0
    for i in range(256):
        if not (_asked(world, flow, i) and kept <= base + i <= last):
            continue
        if inside == 0:
            frame[:] = 0
            frame[0], frame[1], frame[2] = Frame.BURST, flow, base
        frame[4 + i // 64] |= np.int64(1) << (i % 64)
        inside, left = inside + 1, left - 1
        if inside == most or left == 0:
            heartbeats = int(left == 0) if prompt else _heartbeats(world, now, flow, inside, True)
            frame[3] = _burst(inside, heartbeats, world.writer[flow, W.LAST])
            world.counts[Count.REPEATED] += inside
            _send_together(world, now, flow, frame)
            inside = 0


@compiled
def _burst(samples: int, heartbeats: int, last: int) -> int:
    """Return the second argument of a BURST with so many samples and heartbeats, which show the last sample."""
    return samples + BURST_ROOM * (heartbeats + (BURST_ROOM * last if heartbeats else 0))


@compiled
def _send_together(world: Any, now: int, flow: int, frame: Any) -> None:
    """Send a BURST; if IP cuts it, its full frames first."""
    host, before = world.flows[flow, FlowColumn.SOURCE], world.scratch[2]
    before[0], before[1] = Frame.FRAGMENT, flow
    for i in range(fragment_count(world.flows[flow, FlowColumn.SIZE_BYTES], frame[3])):
        before[2] = before[3] = i
        enqueue(world, now, host, before)
    world.counts[Count.DATA] += 1
    enqueue(world, now, host, frame)


@compiled
def _asked(world: Any, flow: int, place: int) -> bool:
    return bool((world.repair[flow, 1 + place // 64] >> (place % 64)) & 1)
