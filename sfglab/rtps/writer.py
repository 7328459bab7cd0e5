"""What a writer does, compiled: what it publishes, its heartbeats, and its repairs (RTPS 2.5, clause 8.4.9).

Knows the state of one flow's writer, and readers by their requests. Refuses to know what a reader has.
"""

from __future__ import annotations

import math
from typing import Any

from sfglab.rtps.answers import repair_in_bursts
from sfglab.rtps.heap import push
from sfglab.rtps.medium import claim, send_next, uniform
from sfglab.rtps.state import (
    SET,
    W_ACKED,
    W_ACKED_AT_HB,
    W_ARMED,
    W_CHANGE_AT,
    W_INTERVAL,
    W_LAST,
    W_LAST_HB,
    W_SENT,
    W_SENT_AT,
    W_VALUE,
    W_WROTE_AT,
    Count,
    Event,
    FlowColumn,
    Frame,
    TimingColumn,
)
from sfglab.rtps.world import compiled

# Compiled code takes plain integers.
_HEARTBEAT, _REPAIR = int(Event.HEARTBEAT), int(Event.REPAIR)
_DATA, _HB, _GAP = int(Frame.DATA), int(Frame.HEARTBEAT), int(Frame.GAP)
_C_REPEATED, _C_HELD, _C_THROTTLED = int(Count.REPEATED), int(Count.HELD), int(Count.THROTTLED)
_DEPTH, _RELIABLE, _CHANGE, _CACHED, _SILENCE, _KEEPS_ACKED = (
    int(FlowColumn.DEPTH),
    int(FlowColumn.RELIABLE),
    int(FlowColumn.CHANGE_NS),
    int(FlowColumn.CACHED),
    int(FlowColumn.SILENCE_NS),
    int(FlowColumn.KEEPS_ACKED),
)
_SOURCE, _SHARED = int(FlowColumn.SOURCE), int(TimingColumn.SHARED)
_T_HB, _T_HB_MAX, _T_FULL, _T_RESPONSE, _T_PROMPT, _T_FINAL = (
    int(TimingColumn.HEARTBEAT_NS),
    int(TimingColumn.HEARTBEAT_MAX_NS),
    int(TimingColumn.PIGGYBACK_WHEN_FULL),
    int(TimingColumn.NACK_RESPONSE_NS),
    int(TimingColumn.PROMPT),
    int(TimingColumn.FINAL_NS),
)
_T_BURST, _T_UNACKED = int(TimingColumn.BURST_BYTES), int(TimingColumn.UNACKED_MOST)


@compiled
def _send(world: Any, now: int, what: Any, arguments: Any, kept: Any) -> None:
    kind, flow = what
    world.counts[kind] += 1
    host = world.flows[flow, _SOURCE]
    place = claim(world, host, kind, flow, arguments[0])
    if place < 0:
        return
    queue = world.queue
    queue[host, place, 0] = kind
    queue[host, place, 1] = flow
    queue[host, place, 2], queue[host, place, 3] = arguments
    queue[host, place, 4], queue[host, place, 5] = kept
    send_next(world, now, 0 if world.timing[_SHARED] else host)


@compiled
def _first_kept(world: Any, flow: int) -> int:
    """Return the oldest sample in the writer's history."""
    depth, last = world.flows[flow, _DEPTH], world.writer[flow, W_LAST]
    if depth == 0:
        return int(world.writer[flow, W_ACKED] + 1)
    return int(max(1, last - depth + 1))


@compiled
def _sample_value(world: Any, now: int, flow: int) -> int:
    """Return the number of the value that the sensor has now; it changes at random times."""
    mean = world.flows[flow, _CHANGE]
    writer = world.writer
    if mean == 0:
        writer[flow, W_VALUE] += 1
    elif mean != SET:
        while now >= writer[flow, W_CHANGE_AT]:
            writer[flow, W_VALUE] += 1
            wait = -math.log(1.0 - uniform(world.random)) * mean
            writer[flow, W_CHANGE_AT] += max(1, int(wait))
    return int(writer[flow, W_VALUE])


@compiled
def _held_back(world: Any, now: int, flow: int, value: int) -> bool:
    """Return whether the local cache holds a value back (paper B, section 2.2)."""
    if not world.flows[flow, _CACHED] or value != world.writer[flow, W_SENT]:
        return False
    silence = world.flows[flow, _SILENCE]
    return bool(silence == 0 or now - world.writer[flow, W_SENT_AT] < silence)


@compiled
def _piggybacks(world: Any, flow: int) -> bool:
    timing, depth, last = world.timing, world.flows[flow, _DEPTH], world.writer[flow, W_LAST]
    if timing[_T_FULL]:
        # Without late joiners to keep it for, what is acknowledged leaves the history.
        gone = 0 if world.flows[flow, _KEEPS_ACKED] else world.writer[flow, W_ACKED]
        if depth > 0 and last - gone >= depth:
            return True
        if depth == 0 and last - world.writer[flow, W_ACKED] >= timing[_T_UNACKED]:
            return True
    return bool(timing[_T_PROMPT])


@compiled
def _send_data(world: Any, now: int, flow: int, sample: int) -> None:
    reliable = world.flows[flow, _RELIABLE]
    rides = 1 if reliable and _piggybacks(world, flow) else 0
    if rides:
        world.writer[flow, W_LAST_HB] = now
        if now - world.writer[flow, W_WROTE_AT] < world.timing[_T_FINAL]:
            rides = 2
    world.writer[flow, W_WROTE_AT] = now
    last = world.writer[flow, W_LAST]
    _send(world, now, (_DATA, flow), (sample, rides), (_first_kept(world, flow), last))


@compiled
def write(world: Any, now: int, flow: int) -> None:
    """Publish what the sensor has now, unless the local cache or a full history of KEEP_ALL holds it back.

    Args:
        world: The run.
        now: Nanoseconds.
        flow: Whose writer.
    """
    writer = world.writer
    value = _sample_value(world, now, flow)
    if _held_back(world, now, flow, value):
        world.counts[_C_HELD] += 1
        return
    unacked = writer[flow, W_LAST] - writer[flow, W_ACKED]
    if world.flows[flow, _RELIABLE] and world.flows[flow, _DEPTH] == 0 and unacked >= world.timing[_T_UNACKED]:
        world.counts[_C_THROTTLED] += 1
        return
    if writer[flow, W_LAST] + 1 >= world.fate.shape[1]:
        raise IndexError("more samples than the state has room for")
    writer[flow, W_SENT], writer[flow, W_SENT_AT] = value, now
    writer[flow, W_LAST] += 1
    sample = writer[flow, W_LAST]
    world.published_ns[flow, sample] = now
    world.value[flow, sample] = value
    _send_data(world, now, flow, sample)
    if world.flows[flow, _RELIABLE] and not writer[flow, W_ARMED]:
        writer[flow, W_ARMED] = 1
        writer[flow, W_INTERVAL] = world.timing[_T_HB]
        push(world.heap, world.heap_sizes, now + writer[flow, W_INTERVAL], _HEARTBEAT, flow)


@compiled
def heartbeat(world: Any, now: int, flow: int) -> None:
    """Say what there is while anything is unacknowledged, and again after the interval.

    Args:
        world: The run.
        now: Nanoseconds.
        flow: Whose writer.
    """
    writer = world.writer
    writer[flow, W_ARMED] = 0
    if writer[flow, W_ACKED] >= writer[flow, W_LAST]:
        return
    due = writer[flow, W_LAST_HB] + world.timing[_T_HB]
    if world.timing[_T_PROMPT] and now < due:
        writer[flow, W_ARMED] = 1
        push(world.heap, world.heap_sizes, due, _HEARTBEAT, flow)
        return
    writer[flow, W_LAST_HB] = now
    _send(world, now, (_HB, flow), (0, 0), (_first_kept(world, flow), writer[flow, W_LAST]))
    stuck = writer[flow, W_ACKED] == writer[flow, W_ACKED_AT_HB]
    longer = min(2 * writer[flow, W_INTERVAL], world.timing[_T_HB_MAX])
    grows = stuck and not world.timing[_T_PROMPT]
    writer[flow, W_INTERVAL] = longer if grows else world.timing[_T_HB]
    writer[flow, W_ACKED_AT_HB] = writer[flow, W_ACKED]
    writer[flow, W_ARMED] = 1
    push(world.heap, world.heap_sizes, now + writer[flow, W_INTERVAL], _HEARTBEAT, flow)


@compiled
def hear_acknack(world: Any, now: int, frame: Any) -> None:
    """Take a reader's acknowledgement; what it asks for is repaired after the vendor's delay.

    Args:
        world: The run.
        now: Nanoseconds.
        frame: The ACKNACK.
    """
    flow, base = frame[1], frame[2]
    writer, repair = world.writer, world.repair
    writer[flow, W_ACKED] = max(writer[flow, W_ACKED], base - 1)
    asked = (frame[4] | frame[5] | frame[6] | frame[7]) != 0
    if not asked:
        return
    waits = repair[flow, 0] != 0
    repair[flow, 0] = base
    for k in range(4):
        repair[flow, 1 + k] = frame[4 + k]
    if not waits:
        push(world.heap, world.heap_sizes, now + world.timing[_T_RESPONSE], _REPAIR, flow)


@compiled
def repair(world: Any, now: int, flow: int) -> None:
    """Send again what the last request asked for, and declare what is gone.

    Args:
        world: The run.
        now: Nanoseconds.
        flow: Whose writer.
    """
    base = world.repair[flow, 0]
    world.repair[flow, 0] = 0
    kept = _first_kept(world, flow)
    if world.timing[_T_BURST]:
        repair_in_bursts(world, now, flow, base, kept)
        return
    if base < kept:
        _send(world, now, (_GAP, flow), (base, kept), (0, 0))
    for k in range(4):
        word = world.repair[flow, 1 + k]
        if word == 0:
            continue
        for i in range(64):
            if (word >> i) & 1:
                sample = base + 64 * k + i
                if kept <= sample <= world.writer[flow, W_LAST]:
                    world.counts[_C_REPEATED] += 1
                    _send_data(world, now, flow, sample)
