"""RELIABLE and BEST_EFFORT writers and readers with KEEP_LAST or KEEP_ALL, compiled: RTPS 2.5, clause 8.4.

One event after the other: publications, frames, heartbeats, requests, repairs, and executors that take samples.
"""

from __future__ import annotations

from typing import Any

from sfglab.rtps.medium import arrived_frame, sent_frame
from sfglab.rtps.model import BURST_ROOM
from sfglab.rtps.reader import (
    drop_overflow,
    hear_gap,
    hear_heartbeat,
    hear_samples,
    is_whole,
    request,
)
from sfglab.rtps.state import Count, D, Event, Fate, FlowColumn, Frame, R, S, TimingColumn, W
from sfglab.rtps.world import compiled, pop, push
from sfglab.rtps.writer import hear_acknack, heartbeat, repair, send_unsent, write

# --- The executor -------------------------------------------------------------------------------------------


@compiled
def _serve(world: Any, now: int, server: int) -> None:
    """Take one sample of the next flow that has any, in turn as an executor does."""
    if world.server[server, S.BUSY] or world.server[server, S.WAITING] == 0:
        return
    world.server[server, S.WAITING] -= 1
    flows = world.flows.shape[0]
    flow = world.server[server, S.NEXT] - 1
    for _ in range(flows):
        flow += 1
        if flow == flows:
            flow = 0
        if (
            world.flows[flow, FlowColumn.SERVER] != server
            or world.reader[flow, R.HEAD] >= world.reader[flow, R.TAIL]
        ):
            continue
        sample = world.order[flow, world.reader[flow, R.HEAD]]
        world.reader[flow, R.HEAD] += 1
        same = world.value[flow, sample] == world.reader[flow, R.VALUE]
        compare = world.flows[flow, FlowColumn.COMPARE_NS]
        skips = same and compare >= 0
        world.counts[Count.COMPARED if skips else Count.PROCESSED] += 1
        world.reader[flow, R.VALUE] = world.value[flow, sample]
        world.server[server, S.BUSY] = 1
        world.server[server, S.SKIPS], world.server[server, S.SAME] = skips, same
        world.server[server, S.FLOW] = flow
        world.server[server, S.SAMPLE] = sample
        world.server[server, S.NEXT] = 0 if flow + 1 == flows else flow + 1
        cost = compare if skips else world.flows[flow, FlowColumn.SERVICE_NS]
        push(world.heap, world.heap_sizes, now + cost, Event.SERVED, server)
        return


@compiled
def _served(world: Any, now: int, server: int) -> None:
    flow, sample = world.server[server, S.FLOW], world.server[server, S.SAMPLE]
    world.server[server, S.BUSY] = 0
    world.fate[flow, sample] = Fate.DELIVERED
    world.received_ns[flow, sample] = now
    if world.watched[flow] > world.server[server, S.SAME]:
        delivery, skipped = world.delivery, world.server[server, S.SKIPS]
        delivery[D.FRESH], delivery[D.FLOW], delivery[D.SAMPLE], delivery[D.SKIPPED] = (
            1,
            flow,
            sample,
            skipped,
        )
    chain = world.flows[flow, FlowColumn.CHAIN]
    if chain >= 0:
        world.writer[chain, W.VALUE] = world.value[flow, sample] - 1
        write(world, now, chain)
    _serve(world, now, server)


# --- The world ----------------------------------------------------------------------------------------------


@compiled
def _heartbeat_of(world: Any, frame: Any) -> tuple[int, int]:
    """Return a frame's heartbeat, first and last sample, zeros if there is none, and note what it asks."""
    kind, flow, riding = frame[0], frame[1], frame[3]
    if kind == Frame.DATA:
        if riding == 1:
            world.reader[flow, R.ASKED] = 1
        return (frame[4], frame[5]) if riding else (0, 0)
    if (kind == Frame.GAP and frame[5] == 0) or (kind == Frame.BURST and riding < BURST_ROOM):
        return 0, 0
    world.reader[flow, R.ASKED] = 1
    if kind == Frame.HEARTBEAT:
        return frame[4], frame[5]
    world.reader[flow, R.REPAIRED] = 1
    if kind == Frame.GAP:
        return frame[4], frame[5]
    depth, last = world.flows[flow, FlowColumn.DEPTH], riding // BURST_ROOM // BURST_ROOM
    return (max(1, last - depth + 1) if depth else 1), last


@compiled
def _hear(world: Any, now: int, frame: Any) -> None:
    kind, flow = frame[0], frame[1]
    if kind == Frame.ACKNACK:
        hear_acknack(world, now, frame)
        return
    if kind in (Frame.FRAGMENT, Frame.BURST) and not is_whole(world, frame):
        return
    if kind in (Frame.DATA, Frame.BURST):
        hear_samples(world, frame)
    elif kind == Frame.GAP:
        hear_gap(world, frame)
    first, last = _heartbeat_of(world, frame)
    if last:
        hear_heartbeat(world, now, flow, first, last)
    if world.timing[TimingColumn.REORDER_MOST]:
        drop_overflow(world, flow)
    _serve(world, now, world.flows[flow, FlowColumn.SERVER])


@compiled
def _step(world: Any, now: int, kind: int, argument: int, frame: Any) -> None:
    if kind == Event.SENT:
        host = world.on_air[argument, 10]
        if sent_frame(world, now, argument, frame):
            _hear(world, now, frame)
        send_unsent(world, now, world.on_air[argument, 10] if world.on_air[argument, 0] else host)
    elif kind == Event.ARRIVED:
        arrived_frame(world, argument, frame)
        _hear(world, now, frame)
    elif kind == Event.SERVED:
        _served(world, now, argument)
    elif kind == Event.PUBLISH:
        write(world, now, argument)
        again = now + world.flows[argument, FlowColumn.PERIOD_NS]
        push(world.heap, world.heap_sizes, again, Event.PUBLISH, argument)
    elif kind == Event.ACKNACK:
        world.reader[argument, R.ARMED] = 0
        request(world, now, argument)
    elif kind == Event.HEARTBEAT:
        heartbeat(world, now, argument)
    else:
        repair(world, now, argument)


@compiled
def advance(world: Any, until: int) -> int:
    """Run a `World` to its next watched delivery, and return its time; to `until` without any, and return -1.

    Publications end with the run's duration. Events at `until`, in nanoseconds, are left for the next call.
    """
    frame = world.scratch[0]
    end = world.timing[TimingColumn.DURATION_NS]
    while world.heap_sizes[0] > 0 and world.heap[0, 0] < until:
        now, kind, argument = pop(world.heap, world.heap_sizes)
        if now >= end and kind == Event.PUBLISH:
            continue
        world.counts[Count.EVENTS] += 1
        _step(world, now, kind, argument, frame)
        if world.delivery[D.FRESH]:
            world.delivery[D.FRESH] = 0
            return int(now)
    return -1


@compiled
def publish(world: Any, now: int, flow: int, value: int) -> bool:
    """Publish a value, by its number, at `now` ns, and return whether the local cache let it pass."""
    held = world.counts[Count.HELD]
    world.writer[flow, W.VALUE] = value
    write(world, now, flow)
    return bool(world.counts[Count.HELD] == held)
