"""RELIABLE and BEST_EFFORT writers and readers with KEEP_LAST or KEEP_ALL, compiled: RTPS 2.5, clause 8.4.

One event after the other: publications, frames, heartbeats, requests, repairs, and the executor that takes
samples from readers. `simulate` runs to the end of time; everything that happened is in the state.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from sfglab.rtps.answers import answer, drop_overflow, make_room_behind_gap, repair_in_bursts, request
from sfglab.rtps.heap import pop, push
from sfglab.rtps.medium import BURST_ROOM, arrived_frame, claim, send_next, sent_frame, uniform
from sfglab.rtps.state import (
    D_FLOW,
    D_FRESH,
    D_SAMPLE,
    D_SKIPPED,
    R_ARMED,
    R_ASKED,
    R_FIRST,
    R_HEAD,
    R_KNOWN,
    R_NEWEST,
    R_NEXT,
    R_OLDEST,
    R_REPAIRED,
    R_TAIL,
    R_VALUE,
    R_WAITING,
    S_BUSY,
    S_FLOW,
    S_NEXT,
    S_SAMPLE,
    S_SKIPS,
    S_WAITING,
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
    Fate,
    FlowColumn,
    Frame,
    TimingColumn,
)
from sfglab.rtps.world import World, compiled

if TYPE_CHECKING:
    from sfglab.rtps.state import Params, State

__all__ = ["advance", "publish", "simulate"]

# Compiled code takes plain integers.
_PUBLISH, _SENT, _ARRIVED, _HEARTBEAT, _ACKNACK, _REPAIR, _SERVED = (int(e) for e in Event)
_DATA, _HB, _ACK, _GAP, _BURST = (int(f) for f in Frame)
_DELIVERED, _OVERWRITTEN, _LATE = int(Fate.DELIVERED), int(Fate.OVERWRITTEN), int(Fate.LATE)
_C_REPEATED, _C_DUPLICATE, _C_HELD = int(Count.REPEATED), int(Count.DUPLICATE), int(Count.HELD)
_C_THROTTLED, _C_EVENTS = int(Count.THROTTLED), int(Count.EVENTS)
_C_PROCESSED, _C_COMPARED = int(Count.PROCESSED), int(Count.COMPARED)
_SERVER, _PERIOD, _DEPTH, _READER_DEPTH, _RELIABLE, _CHAIN = (
    int(FlowColumn.SERVER),
    int(FlowColumn.PERIOD_NS),
    int(FlowColumn.DEPTH),
    int(FlowColumn.READER_DEPTH),
    int(FlowColumn.RELIABLE),
    int(FlowColumn.CHAIN),
)
_CHANGE, _CACHED, _SILENCE, _SERVICE, _COMPARE, _KEEPS_ACKED = (
    int(FlowColumn.CHANGE_NS),
    int(FlowColumn.CACHED),
    int(FlowColumn.SILENCE_NS),
    int(FlowColumn.SERVICE_NS),
    int(FlowColumn.COMPARE_NS),
    int(FlowColumn.KEEPS_ACKED),
)
_T_HB, _T_HB_MAX, _T_FULL = (
    int(TimingColumn.HEARTBEAT_NS),
    int(TimingColumn.HEARTBEAT_MAX_NS),
    int(TimingColumn.PIGGYBACK_WHEN_FULL),
)
_T_NACK, _T_ACK, _T_RESPONSE = (
    int(TimingColumn.NACK_DELAY_NS),
    int(TimingColumn.ACK_DELAY_NS),
    int(TimingColumn.NACK_RESPONSE_NS),
)
_T_PROMPT, _T_FINAL, _T_REORDER, _T_BURST = (
    int(TimingColumn.PROMPT),
    int(TimingColumn.FINAL_NS),
    int(TimingColumn.REORDER_MOST),
    int(TimingColumn.BURST_BYTES),
)
_SOURCE, _SHARED = int(FlowColumn.SOURCE), int(TimingColumn.SHARED)
_T_DURATION, _T_UNACKED, _T_DRAIN = (
    int(TimingColumn.DURATION_NS),
    int(TimingColumn.UNACKED_MOST),
    int(TimingColumn.DRAIN_NS),
)


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


# --- The writer ---------------------------------------------------------------------------------------------


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
def _publish(world: Any, now: int, flow: int) -> None:
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
def _heartbeat(world: Any, now: int, flow: int) -> None:
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
def _hear_acknack(world: Any, now: int, frame: Any) -> None:
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
def _repair(world: Any, now: int, flow: int) -> None:
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


# --- The reader ---------------------------------------------------------------------------------------------


@compiled
def _make_room(world: Any, flow: int) -> None:
    """Push the oldest sample out of a reader's history that is over its bound, in order or behind a gap."""
    reader = world.reader
    depth = world.flows[flow, _READER_DEPTH]
    held = reader[flow, R_TAIL] - reader[flow, R_HEAD]
    if depth == 0 or held + reader[flow, R_WAITING] <= depth:
        return
    if held > 0:
        oldest = world.order[flow, reader[flow, R_HEAD]]
        reader[flow, R_HEAD] += 1
        world.server[world.flows[flow, _SERVER], S_WAITING] -= 1
    else:
        oldest = max(reader[flow, R_OLDEST], reader[flow, R_NEXT])
        while world.arrived[flow, oldest] != 1:
            oldest += 1
        reader[flow, R_OLDEST] = oldest + 1
        reader[flow, R_WAITING] -= 1
        world.arrived[flow, oldest] = 2
    world.fate[flow, oldest] = _LATE


@compiled
def _keep(world: Any, flow: int, sample: int) -> None:
    """Hand a sample to the reader's history, from which the executor takes it."""
    reader = world.reader
    world.order[flow, reader[flow, R_TAIL]] = sample
    reader[flow, R_TAIL] += 1
    world.server[world.flows[flow, _SERVER], S_WAITING] += 1


@compiled
def _advance(world: Any, flow: int) -> None:
    """Deliver in order what is there, and give up what the writer no longer has."""
    reader = world.reader
    last = world.writer[flow, W_LAST]
    sample = reader[flow, R_NEXT]
    while sample <= last:
        if world.arrived[flow, sample] == 1:
            reader[flow, R_WAITING] -= 1
            _keep(world, flow, sample)
        elif world.arrived[flow, sample] == 2 or sample < reader[flow, R_FIRST]:
            if world.fate[flow, sample] == 0:
                world.fate[flow, sample] = _OVERWRITTEN
        else:
            break
        sample += 1
    reader[flow, R_NEXT] = sample


@compiled
def _hear_sample(world: Any, flow: int, sample: int) -> None:
    apart = world.timing[_T_REORDER] != 0
    if world.arrived[flow, sample] or sample < world.reader[flow, R_NEXT]:
        world.counts[_C_DUPLICATE] += 1
    elif not apart or make_room_behind_gap(world, flow, sample):
        world.arrived[flow, sample] = 1
        world.reader[flow, R_NEWEST] = max(world.reader[flow, R_NEWEST], sample)
        if not world.flows[flow, _RELIABLE]:
            _keep(world, flow, sample)
            world.reader[flow, R_NEXT] = sample + 1
        else:
            world.reader[flow, R_WAITING] += 1
            if sample == world.reader[flow, R_NEXT]:
                _advance(world, flow)
        if not apart:
            _make_room(world, flow)


@compiled
def _hear_samples(world: Any, frame: Any) -> None:
    """Take the one sample of a DATA frame, or the several of a BURST."""
    alone = frame[0] == _DATA
    for i in range(1 if alone else 256):
        if alone or (frame[4 + i // 64] >> (i % 64)) & 1:
            _hear_sample(world, frame[1], frame[2] + i)


@compiled
def _hear_heartbeat(world: Any, now: int, flow: int, first: int, last: int) -> None:
    reader = world.reader
    reader[flow, R_FIRST] = max(reader[flow, R_FIRST], first)
    reader[flow, R_KNOWN] = max(reader[flow, R_KNOWN], last)
    _advance(world, flow)
    if world.timing[_T_PROMPT]:
        answer(world, now, flow)
    elif not reader[flow, R_ARMED]:
        reader[flow, R_ARMED] = 1
        lacks = reader[flow, R_NEXT] <= reader[flow, R_KNOWN]
        delay = world.timing[_T_NACK] if lacks else world.timing[_T_ACK]
        push(world.heap, world.heap_sizes, now + delay, _ACKNACK, flow)


@compiled
def _hear_gap(world: Any, frame: Any) -> None:
    flow = frame[1]
    for sample in range(max(frame[2], world.reader[flow, R_NEXT]), frame[3]):
        if world.arrived[flow, sample] == 0:
            world.arrived[flow, sample] = 2
    _advance(world, flow)


# --- The executor -------------------------------------------------------------------------------------------


@compiled
def _serve(world: Any, now: int, server: int) -> None:
    """Take one sample of the next flow that has any, in turn as an executor does."""
    if world.server[server, S_BUSY] or world.server[server, S_WAITING] == 0:
        return
    world.server[server, S_WAITING] -= 1
    flows = world.flows.shape[0]
    flow = world.server[server, S_NEXT] - 1
    for _ in range(flows):
        flow += 1
        if flow == flows:
            flow = 0
        if world.flows[flow, _SERVER] != server or world.reader[flow, R_HEAD] >= world.reader[flow, R_TAIL]:
            continue
        sample = world.order[flow, world.reader[flow, R_HEAD]]
        world.reader[flow, R_HEAD] += 1
        same = world.value[flow, sample] == world.reader[flow, R_VALUE]
        compare = world.flows[flow, _COMPARE]
        skips = same and compare >= 0
        world.counts[_C_COMPARED if skips else _C_PROCESSED] += 1
        world.reader[flow, R_VALUE] = world.value[flow, sample]
        world.server[server, S_BUSY] = 1
        world.server[server, S_SKIPS] = skips
        world.server[server, S_FLOW] = flow
        world.server[server, S_SAMPLE] = sample
        world.server[server, S_NEXT] = 0 if flow + 1 == flows else flow + 1
        cost = compare if skips else world.flows[flow, _SERVICE]
        push(world.heap, world.heap_sizes, now + cost, _SERVED, server)
        return


@compiled
def _served(world: Any, now: int, server: int) -> None:
    flow, sample = world.server[server, S_FLOW], world.server[server, S_SAMPLE]
    world.server[server, S_BUSY] = 0
    world.fate[flow, sample] = _DELIVERED
    world.received_ns[flow, sample] = now
    if world.watched[flow]:
        delivery, skipped = world.delivery, world.server[server, S_SKIPS]
        delivery[D_FRESH], delivery[D_FLOW], delivery[D_SAMPLE], delivery[D_SKIPPED] = 1, flow, sample, skipped
    chain = world.flows[flow, _CHAIN]
    if chain >= 0:
        world.writer[chain, W_VALUE] = world.value[flow, sample] - 1
        _publish(world, now, chain)
    _serve(world, now, server)


# --- The world ----------------------------------------------------------------------------------------------


@compiled
def _heartbeat_of(world: Any, frame: Any) -> tuple[int, int]:
    """Return a frame's heartbeat, first and last sample, zeros if there is none, and note what it asks."""
    kind, flow, riding = frame[0], frame[1], frame[3]
    if kind == _DATA:
        if riding == 1:
            world.reader[flow, R_ASKED] = 1
        return (frame[4], frame[5]) if riding else (0, 0)
    if (kind == _GAP and frame[5] == 0) or (kind == _BURST and riding < BURST_ROOM):
        return 0, 0
    world.reader[flow, R_ASKED] = 1
    if kind == _HB:
        return frame[4], frame[5]
    world.reader[flow, R_REPAIRED] = 1
    if kind == _GAP:
        return frame[4], frame[5]
    depth, last = world.flows[flow, _DEPTH], riding // BURST_ROOM
    return (max(1, last - depth + 1) if depth else 1), last


@compiled
def _hear(world: Any, now: int, frame: Any) -> None:
    kind, flow = frame[0], frame[1]
    if kind == _ACK:
        _hear_acknack(world, now, frame)
        return
    if kind in (_DATA, _BURST):
        _hear_samples(world, frame)
    elif kind == _GAP:
        _hear_gap(world, frame)
    first, last = _heartbeat_of(world, frame)
    if last:
        _hear_heartbeat(world, now, flow, first, last)
    if world.timing[_T_REORDER]:
        drop_overflow(world, flow)
    _serve(world, now, world.flows[flow, _SERVER])


@compiled
def _step(world: Any, now: int, kind: int, argument: int, frame: Any) -> None:
    if kind == _SENT:
        if sent_frame(world, now, argument, frame):
            _hear(world, now, frame)
    elif kind == _ARRIVED:
        arrived_frame(world, argument, frame)
        _hear(world, now, frame)
    elif kind == _SERVED:
        _served(world, now, argument)
    elif kind == _PUBLISH:
        _publish(world, now, argument)
        push(world.heap, world.heap_sizes, now + world.flows[argument, _PERIOD], _PUBLISH, argument)
    elif kind == _ACKNACK:
        world.reader[argument, R_ARMED] = 0
        request(world, now, argument)
    elif kind == _HEARTBEAT:
        _heartbeat(world, now, argument)
    else:
        _repair(world, now, argument)


@compiled
def advance(world: Any, until: int) -> int:
    """Run to the next watched delivery, and return its time; to `until` without any, and return -1.

    Publications end with the run's duration, so that what is under way can arrive.

    Args:
        world: A `World`.
        until: Nanoseconds; events at this time are left for the next call.
    """
    frame = world.scratch[0]
    end = world.timing[_T_DURATION]
    while world.heap_sizes[0] > 0 and world.heap[0, 0] < until:
        now, kind, argument = pop(world.heap, world.heap_sizes)
        if now >= end and kind == _PUBLISH:
            continue
        world.counts[_C_EVENTS] += 1
        _step(world, now, kind, argument, frame)
        if world.delivery[D_FRESH]:
            world.delivery[D_FRESH] = 0
            return int(now)
    return -1


@compiled
def publish(world: Any, now: int, flow: int, value: int) -> bool:
    """Publish a value from outside, and return whether the local cache let it pass.

    Args:
        world: A `World`.
        now: Nanoseconds, not before what was run so far.
        flow: Whose.
        value: Its number.
    """
    held = world.counts[_C_HELD]
    world.writer[flow, W_VALUE] = value
    _publish(world, now, flow)
    return bool(world.counts[_C_HELD] == held)


def simulate(params: Params, state: State) -> None:
    """Run until time is over.

    Args:
        params: The run's parameters.
        state: At time 0; afterwards, everything that happened.
    """
    advance(World(params, state), int(params.timing[_T_DURATION] + params.timing[_T_DRAIN]))
