"""The module `engine` has the compiled events of writers and readers with KEEP_LAST (RTPS 2.5, clause 8.4).

The engine runs one event after the other: publications, frames, heartbeats, requests, retransmissions, and samples
that executors take.
"""

from __future__ import annotations

from typing import Any

from sfglab.rtps.medium import arrived_frame, sent_frame
from sfglab.rtps.reader import (
    drop_overflow,
    hear_gap,
    hear_heartbeat,
    hear_samples,
    is_whole,
    request,
)
from sfglab.rtps.state import Count, Event, Fate, Frame
from sfglab.rtps.world import compiled, pop, push
from sfglab.rtps.writer import hear_acknack, heartbeat, repair, send_unsent, write

# --- The executor ------------------------------------------------------------------------------


@compiled
def _serve(world: Any, now: int, number: int) -> None:
    """Take one sample of the next flow that has a sample; an executor takes flows in turn."""
    server = world.server[number]
    if server.busy or server.waiting == 0:
        return
    flows = world.flows.shape[0]
    flow = server.next
    for _ in range(flows):
        if flow == flows:
            flow = 0
        reader = world.reader[flow]
        if world.flows[flow].server == number and reader.head < reader.tail:
            break
        flow += 1
    settings = world.flows[flow]
    sample = world.order[flow, reader.head]
    value = world.value[flow, sample]
    server.same = value == reader.value
    skips = server.same and settings.compare_ns >= 0
    world.counts[Count.COMPARED] += skips
    reader.head += 1
    reader.value = value
    server.waiting -= 1
    server.busy = 1
    server.flow = flow
    server.sample = sample
    server.next = flow + 1
    cost = settings.compare_ns if skips else settings.service_ns
    push(world.heap, world.heap_sizes, now + cost, Event.SERVED, number)


@compiled
def _served(world: Any, now: int, number: int) -> None:
    """Deliver the sample that an executor has processed, and let the executor take the next sample."""
    server = world.server[number]
    flow, sample = server.flow, server.sample
    server.busy = 0
    world.fate[flow, sample] = Fate.DELIVERED
    world.received_ns[flow, sample] = now
    if world.delivery.watched and not server.same:
        world.delivery.fresh = 1
        world.delivery.flow = flow
        world.delivery.sample = sample
    chain = world.flows[flow].chain
    if chain >= 0:
        world.writer[chain].value = world.value[flow, sample] - 1
        write(world, now, chain)
    _serve(world, now, number)


# --- The world ---------------------------------------------------------------------------------


@compiled
def _hear(world: Any, now: int, frame: Any) -> None:
    """Give a received frame to the reader, or a received ACKNACK to the writer."""
    flow = frame.flow
    if frame.kind == Frame.ACKNACK:
        hear_acknack(world, now, frame)
        return
    if frame.kind in (Frame.FRAGMENT, Frame.BURST) and not is_whole(world, frame):
        return
    if frame.kind in (Frame.DATA, Frame.BURST):
        hear_samples(world, frame)
    elif frame.kind == Frame.GAP:
        hear_gap(world, frame)
    if frame.heartbeats:
        hear_heartbeat(world, now, frame)
    if world.timing.reorder_most:
        drop_overflow(world, flow)
    _serve(world, now, world.flows[flow].server)


@compiled
def _step(world: Any, now: int, kind: int, argument: int) -> None:
    """Run one event."""
    frame = world.scratch[0]
    if kind == Event.SENT:
        sender = world.transmitter[argument]
        host = sender.host
        if sent_frame(world, now, argument):
            _hear(world, now, frame)
        send_unsent(world, now, sender.host if sender.busy else host)
    elif kind == Event.ARRIVED:
        arrived_frame(world, argument)
        _hear(world, now, frame)
    elif kind == Event.SERVED:
        _served(world, now, argument)
    elif kind == Event.PUBLISH:
        write(world, now, argument)
        again = now + world.flows[argument].period_ns
        push(world.heap, world.heap_sizes, again, Event.PUBLISH, argument)
    elif kind == Event.ACKNACK:
        world.reader[argument].armed = 0
        request(world, now, argument)
    elif kind == Event.HEARTBEAT:
        heartbeat(world, now, argument)
    else:
        repair(world, now, argument)


@compiled
def advance(world: Any, until: int) -> int:
    """Run a `World` to its next watched delivery, and return the delivery's time; without a delivery run to `until`.

    Without a delivery the function returns -1. Publications end with the run's duration. Events at the time `until`,
    in nanoseconds, remain for the next call.
    """
    while world.heap_sizes[0] > 0 and world.heap[0, 0] < until:
        now, kind, argument = pop(world.heap, world.heap_sizes)
        if now >= world.timing.duration_ns and kind == Event.PUBLISH:
            continue
        world.counts[Count.EVENTS] += 1
        _step(world, now, kind, argument)
        if world.delivery.fresh:
            world.delivery.fresh = 0
            return int(now)
    return -1
