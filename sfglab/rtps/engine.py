"""RELIABLE and BEST_EFFORT writers and readers with KEEP_LAST or KEEP_ALL, compiled: RTPS 2.5, clause 8.4.

One event after the other: publications, frames, heartbeats, requests, repairs, and the executor that takes
samples from readers. What writers and readers do at each stands in `writer` and `reader`. Everything that
happened is in the state.
"""

from __future__ import annotations

from typing import Any

from sfglab.rtps.medium import arrived_frame, sent_frame
from sfglab.rtps.model import BURST_ROOM
from sfglab.rtps.reader import drop_overflow, hear_gap, hear_heartbeat, hear_samples, request
from sfglab.rtps.state import (
    D_FLOW,
    D_FRESH,
    D_SAMPLE,
    D_SKIPPED,
    R_ARMED,
    R_ASKED,
    R_HEAD,
    R_REPAIRED,
    R_TAIL,
    R_VALUE,
    S_BUSY,
    S_FLOW,
    S_NEXT,
    S_SAMPLE,
    S_SKIPS,
    S_WAITING,
    W_VALUE,
    Count,
    Event,
    Fate,
    FlowColumn,
    Frame,
    TimingColumn,
)
from sfglab.rtps.world import compiled, pop, push
from sfglab.rtps.writer import hear_acknack, heartbeat, repair, write

# Compiled code takes plain integers.
_PUBLISH, _SENT, _ARRIVED, _HEARTBEAT, _ACKNACK, _SERVED = (
    int(Event.PUBLISH),
    int(Event.SENT),
    int(Event.ARRIVED),
    int(Event.HEARTBEAT),
    int(Event.ACKNACK),
    int(Event.SERVED),
)
_DATA, _HB, _ACK, _GAP, _BURST = (
    int(Frame.DATA),
    int(Frame.HEARTBEAT),
    int(Frame.ACKNACK),
    int(Frame.GAP),
    int(Frame.BURST),
)
_DELIVERED = int(Fate.DELIVERED)
_C_HELD, _C_EVENTS, _C_PROCESSED, _C_COMPARED = (
    int(Count.HELD),
    int(Count.EVENTS),
    int(Count.PROCESSED),
    int(Count.COMPARED),
)
_SERVER, _PERIOD, _DEPTH, _CHAIN, _SERVICE, _COMPARE = (
    int(FlowColumn.SERVER),
    int(FlowColumn.PERIOD_NS),
    int(FlowColumn.DEPTH),
    int(FlowColumn.CHAIN),
    int(FlowColumn.SERVICE_NS),
    int(FlowColumn.COMPARE_NS),
)
_T_REORDER, _T_DURATION, _T_DRAIN = (
    int(TimingColumn.REORDER_MOST),
    int(TimingColumn.DURATION_NS),
    int(TimingColumn.DRAIN_NS),
)


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
        write(world, now, chain)
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
        hear_acknack(world, now, frame)
        return
    if kind in (_DATA, _BURST):
        hear_samples(world, frame)
    elif kind == _GAP:
        hear_gap(world, frame)
    first, last = _heartbeat_of(world, frame)
    if last:
        hear_heartbeat(world, now, flow, first, last)
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
        write(world, now, argument)
        push(world.heap, world.heap_sizes, now + world.flows[argument, _PERIOD], _PUBLISH, argument)
    elif kind == _ACKNACK:
        world.reader[argument, R_ARMED] = 0
        request(world, now, argument)
    elif kind == _HEARTBEAT:
        heartbeat(world, now, argument)
    else:
        repair(world, now, argument)


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
    write(world, now, flow)
    return bool(world.counts[_C_HELD] == held)
