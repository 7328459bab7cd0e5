"""What a writer does, compiled: what it publishes, its heartbeats, and its repairs (RTPS 2.5, clause 8.4.9).

Knows the state of one flow's writer, and readers by their requests. Refuses to know what a reader has. In all
functions `world` is the run, `now` is nanoseconds, and `flow` is whose writer it is.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sfglab.rtps.medium import burst_most, enqueue, uniform
from sfglab.rtps.model import BURST_ROOM
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
from sfglab.rtps.world import compiled, push

# Compiled code takes plain integers.
_HEARTBEAT, _REPAIR = int(Event.HEARTBEAT), int(Event.REPAIR)
_DATA, _HB, _GAP, _BURST = int(Frame.DATA), int(Frame.HEARTBEAT), int(Frame.GAP), int(Frame.BURST)
_C_DATA, _C_REPEATED, _C_HELD, _C_THROTTLED, _C_GAP = (
    int(Count.DATA),
    int(Count.REPEATED),
    int(Count.HELD),
    int(Count.THROTTLED),
    int(Count.GAP),
)
_DEPTH, _RELIABLE, _CHANGE, _CACHED, _SILENCE, _KEEPS_ACKED = (
    int(FlowColumn.DEPTH),
    int(FlowColumn.RELIABLE),
    int(FlowColumn.CHANGE_NS),
    int(FlowColumn.CACHED),
    int(FlowColumn.SILENCE_NS),
    int(FlowColumn.KEEPS_ACKED),
)
_SOURCE, _SIZE = int(FlowColumn.SOURCE), int(FlowColumn.SIZE_BYTES)
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
    frame = world.scratch[1]
    frame[0], frame[1] = kind, flow
    frame[2], frame[3] = arguments
    frame[4], frame[5] = kept
    enqueue(world, now, world.flows[flow, _SOURCE], frame)


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
    """Publish what the sensor has now, unless the local cache or a full history of KEEP_ALL holds it back."""
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
    """Say what there is while anything is unacknowledged, and again after the interval."""
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
    """Take a reader's acknowledgement; what it asks for is repaired after the vendor's delay."""
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
    """Send again what the last request asked for, and declare what is gone."""
    base = world.repair[flow, 0]
    world.repair[flow, 0] = 0
    kept = _first_kept(world, flow)
    if world.timing[_T_BURST]:
        _repair_in_bursts(world, now, flow, base, kept)
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


@compiled
def _repair_in_bursts(world: Any, now: int, flow: int, base: int, kept: int) -> None:
    """Send what was asked for, many samples a frame, and a heartbeat with the last one."""
    last, most = world.writer[flow, W_LAST], burst_most(world.flows[flow, _SIZE], world.timing[_T_BURST])
    left = 0
    for i in range(256):
        left += _asked(world, flow, i) and kept <= base + i <= last
    frame = world.scratch[1]
    frame[:] = 0
    if base < kept:
        frame[0], frame[1], frame[2], frame[3] = _GAP, flow, base, kept
        frame[4], frame[5] = kept, last if left == 0 else 0
        world.counts[_C_GAP] += 1
        enqueue(world, now, world.flows[flow, _SOURCE], frame)
    inside = 0
    for i in range(256):
        if not (_asked(world, flow, i) and kept <= base + i <= last):
            continue
        if inside == 0:
            frame[:] = 0
            frame[0], frame[1], frame[2] = _BURST, flow, base
        frame[4 + i // 64] |= np.int64(1) << (i % 64)
        inside, left = inside + 1, left - 1
        if inside == most or left == 0:
            frame[3] = inside + (BURST_ROOM * last if left == 0 else 0)
            world.counts[_C_DATA] += 1
            world.counts[_C_REPEATED] += inside
            enqueue(world, now, world.flows[flow, _SOURCE], frame)
            inside = 0


@compiled
def _asked(world: Any, flow: int, place: int) -> bool:
    return bool((world.repair[flow, 1 + place // 64] >> (place % 64)) & 1)
