"""The medium in compiled code: queues of frames at hosts, airtime, contention, loss and latency.

All hosts share a half-duplex medium, as Wi-Fi is, or each has its sender, as an Ethernet port is. `model` has
sizes, airtime and turns. Knows frames only by size and way.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sfglab.rtps.model import (
    BURST_ROOM,
    INFO_DST_BYTES,
    NETWORK_BYTES,
    QUEUE_RULES,
    after_stall_ns,
    airtime_ns,
    fragments,
    frame_bytes,
    is_lost,
    next_sender,
)
from sfglab.rtps.state import Count, Drop, Event, FlowColumn, Frame, TimingColumn, TraceColumn
from sfglab.rtps.world import compiled, push


@compiled
def uniform(random: Any) -> float:
    """Return the next number of [0, 1): SplitMix64, so that a seed gives the same run on every machine."""
    random[0] += np.uint64(0x9E3779B97F4A7C15)
    z = random[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) / 9007199254740992.0


_frame_bytes, _airtime_ns, _next_sender = (
    compiled(frame_bytes),
    compiled(airtime_ns),
    compiled(next_sender),
)
fragment_count = compiled(fragments)
_after_stall_ns, _is_lost = compiled(after_stall_ns), compiled(is_lost)
_TAIL, _HEAD, _BLOCK = range(len(QUEUE_RULES))


@compiled
def message_bytes(size: int) -> int:
    """Return what Fast DDS counts of a sample's RTPS message: all but statistics, which it puts behind it."""
    return int(_frame_bytes(Frame.DATA, size, 0) - NETWORK_BYTES + INFO_DST_BYTES)


@compiled
def burst_most(size: int, message_bytes: int) -> int:
    """Return how many samples of a size fit into a message of repairs with a heartbeat."""
    one = _frame_bytes(Frame.BURST, size, 1)
    around = _frame_bytes(Frame.BURST, size, BURST_ROOM) - NETWORK_BYTES
    return max(1, (message_bytes - around) // (one - _frame_bytes(Frame.BURST, size, 0)))


@compiled
def note_drop(world: Any, frame: Any, where: int) -> None:
    """Note of a frame's samples that they were lost here, if never before; a BURST's were, but for a queue."""
    flow, alone = frame[1], frame[0] == Frame.DATA
    if not alone and (frame[0] != Frame.BURST or not world.timing[TimingColumn.QUEUES]):
        return
    for i in range(1 if alone else 256):
        sample = frame[2] + i
        asked = alone or (frame[4 + i // 64] >> (i % 64)) & 1
        if asked and world.dropped[flow, sample] == 0 and world.arrived[flow, sample] == 0:
            world.dropped[flow, sample] = where


@compiled
def has_room(world: Any, host: int) -> bool:
    """Return whether a host's queue lets who sends go on: once full, when half has left (sock_writeable)."""
    if world.timing[TimingColumn.QUEUE_RULE] != _BLOCK:
        return True
    ends, most = world.queue_ends, world.timing[TimingColumn.QUEUE_FRAMES]
    ends[host, 2] = ends[host, 1] >= most or (ends[host, 2] and 2 * ends[host, 1] > most)
    return not ends[host, 2]


@compiled
def enqueue(world: Any, now: int, host: int, frame: Any) -> None:
    """Put a frame at the end of a host's queue, unless that is full, and send if the medium is free.

    A full one drops it, or what came first; one that blocks was asked before (`has_room`), but for the access
    point's, which cannot block and drops.

    A frame is eight words: kind, flow, two arguments, four more. Arguments of DATA: sample, and whether a
    heartbeat rides along, 1 to be answered, 2 FINAL; of BURST: first sample of its bitmap, and what
    `BURST_ROOM` says. The sixth word of GAP is not 0 if a heartbeat rides along.
    """
    ends = world.queue_ends
    capacity = world.queue.shape[1]
    most = capacity
    if host == world.timing[TimingColumn.ACCESS_POINT]:
        most = world.timing[TimingColumn.QUEUE_FRAMES]
    if ends[host, 1] == most:
        world.counts[Count.QUEUE_FULL] += 1
        if world.timing[TimingColumn.QUEUE_RULE] != _HEAD:
            note_drop(world, frame, Drop.QUEUE)
            return
        note_drop(world, world.queue[host, ends[host, 0]], Drop.QUEUE)
        ends[host, 0] = 0 if ends[host, 0] + 1 == capacity else ends[host, 0] + 1
        ends[host, 1] -= 1
    place = ends[host, 0] + ends[host, 1]
    ends[host, 1] += 1
    if place >= capacity:
        place -= capacity
    for k in range(8):
        world.queue[host, place, k] = frame[k]
    _send_next(world, now, 0 if world.timing[TimingColumn.SHARED] else host)


@compiled
def _choose_host(world: Any, transmitter: int) -> tuple[int, int]:
    """Return whose turn it is, -1 for nobody's, and how many have something to send."""
    if not world.timing[TimingColumn.SHARED]:
        waiting = world.queue_ends[transmitter, 1]
        return (transmitter if waiting else -1), 1
    chosen, contenders = _next_sender(world.queue_ends[:, 1], world.next_host[0])
    if contenders > 1 and world.timing[TimingColumn.RANDOM_TURNS]:
        for _ in range(int(uniform(world.random) * contenders)):
            chosen = _next_sender(world.queue_ends[:, 1], chosen + 1)[0]
    if chosen >= 0:
        world.next_host[0] = chosen + 1
    return chosen, contenders


@compiled
def _send_next(world: Any, now: int, transmitter: int) -> None:
    """Send the next host's oldest frame, if the medium is free."""
    air = world.on_air
    if air[transmitter, 0]:
        return
    host, contenders = _choose_host(world, transmitter)
    if host < 0:
        return
    place = world.queue_ends[host, 0]
    for k in range(8):
        air[transmitter, 1 + k] = world.queue[host, place, k]
    world.queue_ends[host, 0] = 0 if place + 1 == world.queue.shape[1] else place + 1
    world.queue_ends[host, 1] -= 1
    kind, flow, timing = air[transmitter, 1], air[transmitter, 2], world.timing
    size = _frame_bytes(kind, world.flows[flow, FlowColumn.SIZE_BYTES], air[transmitter, 4])
    size += timing[TimingColumn.EXTRA_BYTES]
    near = host  # the end of this crossing that is not the access point
    if host == timing[TimingColumn.ACCESS_POINT]:
        near = world.flows[flow, FlowColumn.SOURCE if kind == Frame.ACKNACK else FlowColumn.TARGET]
    overhead = timing[TimingColumn.OVERHEAD_NS]
    airtime = _airtime_ns(size, contenders, overhead, world.host_bps[near], world.rates[1])
    world.counts[Count.BYTES] += size
    world.counts[Count.AIRTIME_NS] += airtime
    begin = _after_stall_ns(now, timing[TimingColumn.STALL_EVERY_NS], timing[TimingColumn.STALL_NS])
    air[transmitter, 0], air[transmitter, 9], air[transmitter, 10] = 1, begin, host
    push(world.heap, world.heap_sizes, begin + airtime, Event.SENT, transmitter)


@compiled
def _traced(world: Any, now: int, transmitter: int, drawn: bool) -> bool:  # noqa: FBT001 - compiled
    """Note a frame that leaves the air, and return whether it is lost: as drawn, if nobody wished otherwise."""
    row = world.trace[world.trace_end[0]]
    world.trace_end[0] += 1
    for k in range(8):
        row[k] = world.on_air[transmitter, 1 + k]
    lost = row[TraceColumn.WISH] == 1 or (drawn and row[TraceColumn.WISH] == 0)
    row[TraceColumn.BEGAN], row[TraceColumn.ENDED] = world.on_air[transmitter, 9], now
    row[TraceColumn.LOST] = lost
    return bool(lost)


@compiled
def sent_frame(world: Any, now: int, transmitter: int, frame: Any) -> bool:
    """Take a frame off the air into `frame`, and return whether it is there: neither lost nor under way."""
    air = world.on_air
    for k in range(8):
        frame[k] = air[transmitter, 1 + k]
    air[transmitter, 0] = 0
    there = False
    host = air[transmitter, 10]
    lost = _is_lost(world.bad[host] != 0, uniform(world.random), world.rates[0], world.rates[2])
    world.bad[host] = lost
    first_crossing = 0 <= world.timing[TimingColumn.ACCESS_POINT] != host
    if world.trace_end[0] < world.trace.shape[0]:
        lost = _traced(world, now, transmitter, lost)
    if lost:
        world.counts[Count.LOST] += 1
        note_drop(world, frame, Drop.MEDIUM)
    elif first_crossing:
        enqueue(world, now, world.timing[TimingColumn.ACCESS_POINT], frame)
    elif world.timing[TimingColumn.LATENCY_NS] == 0:
        there = True
    else:
        ends = world.flight_ends
        capacity = world.flight.shape[1]
        place = (ends[transmitter, 0] + ends[transmitter, 1]) % capacity
        if ends[transmitter, 1] == capacity:
            raise IndexError("more frames under way than the state has room for")
        for k in range(8):
            world.flight[transmitter, place, k] = frame[k]
        ends[transmitter, 1] += 1
        arrives = now + world.timing[TimingColumn.LATENCY_NS]
        push(world.heap, world.heap_sizes, arrives, Event.ARRIVED, transmitter)
    _send_next(world, now, transmitter)
    return there


@compiled
def arrived_frame(world: Any, transmitter: int, frame: Any) -> None:
    """Take the oldest frame under way into `frame`; latency is constant, so none overtakes another."""
    ends = world.flight_ends
    place = ends[transmitter, 0]
    for k in range(8):
        frame[k] = world.flight[transmitter, place, k]
    ends[transmitter, 0] = (place + 1) % world.flight.shape[1]
    ends[transmitter, 1] -= 1
