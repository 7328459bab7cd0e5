"""The module `medium` has the compiled medium: queues of frames at hosts, frames on air, frames in flight, losses.

The rules are those of `channel`, the sizes are those of `frames`, and a frame is a record of `state.FrameFields`. In
all functions `world` is the state of the run and `now` is the time in nanoseconds.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sfglab.rtps.channel import (
    BLOCK,
    DISPLACES,
    JOINS,
    admission,
    after_stall_ns,
    airtime_ns,
    is_blocked,
    is_lost,
    next_sender,
)
from sfglab.rtps.frames import INFO_DST_BYTES, NETWORK_BYTES, fragments, frame_bytes
from sfglab.rtps.state import BITMAP_WORDS, Count, Event, Frame
from sfglab.rtps.world import GOLDEN, compiled, push, scattered

_airtime_ns = compiled(airtime_ns)
_next_sender = compiled(next_sender)
_admission = compiled(admission)
_is_blocked = compiled(is_blocked)
_after_stall_ns = compiled(after_stall_ns)
_is_lost = compiled(is_lost)
_frame_bytes = compiled(frame_bytes)
fragment_count = compiled(fragments)


@compiled
def uniform(random: Any) -> float:
    """Return the next number of [0, 1), such that a seed gives the same run on every machine."""
    random[0] += GOLDEN
    return float(scattered(random[0]) >> np.uint64(11)) / 9007199254740992.0


@compiled
def message_bytes(size: int) -> int:
    """Return the bytes that Fast DDS counts for a sample's RTPS message; Fast DDS leaves out the statistics."""
    return int(_frame_bytes(Frame.DATA, size, 1, 0) - NETWORK_BYTES + INFO_DST_BYTES)


@compiled
def burst_most(size: int, message_bytes: int) -> int:
    """Return how many samples of a size fit into one message of retransmissions with a heartbeat."""
    around = _frame_bytes(Frame.BURST, size, 0, 1) - NETWORK_BYTES
    one = _frame_bytes(Frame.BURST, size, 1, 0) - _frame_bytes(Frame.BURST, size, 0, 0)
    return max(1, (message_bytes - around) // one)


@compiled
def copy_frame(target: Any, frame: Any) -> None:
    """Copy a frame to another frame's place, because Numba's own assignment of records copies byte by byte."""
    target.kind = frame.kind
    target.flow = frame.flow
    target.sample = frame.sample
    target.samples = frame.samples
    target.heartbeats = frame.heartbeats
    target.final = frame.final
    target.oldest = frame.oldest
    target.newest = frame.newest
    for word in range(BITMAP_WORDS):
        target.bits[word] = frame.bits[word]


@compiled
def new_frame(world: Any, kind: int, flow: int) -> Any:
    """Return an empty frame of a kind and flow; the frame is valid until the next call."""
    frame = world.scratch[1]
    copy_frame(frame, world.scratch[3])
    frame.kind = kind
    frame.flow = flow
    return frame


@compiled
def has_bit(bits: Any, place: int) -> bool:
    """Return whether a bitmap contains the sample at a place."""
    return bool((bits[place // 64] >> (place % 64)) & 1)


@compiled
def set_bit(bits: Any, place: int) -> None:
    """Add the sample at a place to a bitmap."""
    bits[place // 64] |= np.int64(1) << (place % 64)


@compiled
def has_room(world: Any, host: int) -> bool:
    """Return whether the queue of a host has room, so that the host's writers may send."""
    if world.timing.queue_rule != BLOCK:
        return True
    blocked = world.blocked[host] != 0
    world.blocked[host] = _is_blocked(blocked, world.waiting[host], world.timing.queue_frames)
    return not world.blocked[host]


@compiled
def enqueue(world: Any, now: int, host: int, frame: Any) -> None:
    """Put a frame into a host's queue, and send the oldest frame if the medium is free.

    Writers check `has_room` before the call. Periodic heartbeats and acknowledgements have room beyond the bound of a
    queue that blocks; an access point has no room beyond the bound, and drops the frames.
    """
    capacity = world.queue.shape[1]
    room = world.timing.queue_frames if host == world.timing.access_point else capacity
    result = _admission(world.timing.queue_rule, world.waiting[host], room)
    if result != JOINS:
        world.counts[Count.QUEUE_FULL] += 1
        if result != DISPLACES:
            return
        _remove_oldest(world, host)
    place = world.head[host] + world.waiting[host]
    if place >= capacity:
        place -= capacity
    world.waiting[host] += 1
    copy_frame(world.queue[host, place], frame)
    _send_next(world, now, 0 if world.timing.shared else host)


@compiled
def _remove_oldest(world: Any, host: int) -> None:
    place = world.head[host] + 1
    world.head[host] = 0 if place == world.queue.shape[1] else place
    world.waiting[host] -= 1


@compiled
def _choose_host(world: Any, transmitter: int) -> tuple[int, int]:
    """Return the host that sends next, -1 if no host has a frame, and how many hosts contend."""
    if not world.timing.shared:
        return (transmitter if world.waiting[transmitter] else -1), 1
    medium = world.transmitter[0]
    host, contenders = _next_sender(world.waiting, medium.turn, 0)
    if contenders > 1 and world.timing.random_turns:
        passed = int(uniform(world.random) * contenders)
        host = _next_sender(world.waiting, medium.turn, passed)[0]
    if host >= 0:
        medium.turn = host + 1
    return host, contenders


@compiled
def _send_next(world: Any, now: int, transmitter: int) -> None:
    """Send the next host's oldest frame, if the medium is free."""
    sender, timing = world.transmitter[transmitter], world.timing
    if sender.busy:
        return
    host, contenders = _choose_host(world, transmitter)
    if host < 0:
        return
    frame = world.queue[host, world.head[host]]
    copy_frame(world.on_air[transmitter], frame)
    _remove_oldest(world, host)
    size = _frame_bytes(
        frame.kind, world.flows[frame.flow].size_bytes, frame.samples, frame.heartbeats
    )
    size += timing.extra_bytes
    airtime = _airtime_ns(size, contenders, timing.overhead_ns, timing.rate_bps, timing.contention)
    world.counts[Count.AIRTIME_NS] += airtime
    sender.busy = 1
    sender.host = host
    sender.began_ns = _after_stall_ns(now, timing.stall_every_ns, timing.stall_ns)
    push(world.heap, world.heap_sizes, sender.began_ns + airtime, Event.SENT, transmitter)


@compiled
def _traced(world: Any, now: int, transmitter: int, drawn: bool) -> bool:  # noqa: FBT001 - compiled
    """Record a frame that leaves the air, and return whether the frame is lost: by chance, or because of a wish."""
    number = world.trace_end[0]
    world.trace_end[0] += 1
    copy_frame(world.traced[number], world.on_air[transmitter])
    row = world.trace[number]
    lost = row.wish == 1 or (drawn and row.wish == 0)
    row.began_ns = world.transmitter[transmitter].began_ns
    row.ended_ns = now
    row.lost = lost
    return bool(lost)


@compiled
def sent_frame(world: Any, now: int, transmitter: int) -> bool:
    """Move a frame from the air into the first scratch; return False if the frame is lost or in flight."""
    sender, frame = world.transmitter[transmitter], world.scratch[0]
    copy_frame(frame, world.on_air[transmitter])
    sender.busy = 0
    there = False
    host = sender.host
    bad = world.bad[host] != 0
    lost = _is_lost(bad, uniform(world.random), world.timing.loss, world.timing.burst_frames)
    world.bad[host] = lost
    is_first_hop = 0 <= world.timing.access_point != host
    if world.trace_end[0] < world.trace.shape[0]:
        lost = _traced(world, now, transmitter, lost)
    if lost:
        world.counts[Count.LOST] += 1
    elif is_first_hop:
        enqueue(world, now, world.timing.access_point, frame)
    elif world.timing.latency_ns == 0:
        there = True
    else:
        _fly(world, now, transmitter, frame)
    _send_next(world, now, transmitter)
    return there


@compiled
def _fly(world: Any, now: int, transmitter: int, frame: Any) -> None:
    """Let a frame arrive after the medium's latency."""
    sender, capacity = world.transmitter[transmitter], world.flight.shape[1]
    if sender.in_flight == capacity:
        raise IndexError(
            "medium: more frames in flight than the state has room for; raise its capacity"
        )
    place = (sender.flight_head + sender.in_flight) % capacity
    copy_frame(world.flight[transmitter, place], frame)
    sender.in_flight += 1
    arrives = now + world.timing.latency_ns
    push(world.heap, world.heap_sizes, arrives, Event.ARRIVED, transmitter)


@compiled
def arrived_frame(world: Any, transmitter: int) -> None:
    """Move the oldest frame in flight into the first scratch; with a constant latency no frame overtakes another."""
    sender = world.transmitter[transmitter]
    copy_frame(world.scratch[0], world.flight[transmitter, sender.flight_head])
    sender.flight_head = (sender.flight_head + 1) % world.flight.shape[1]
    sender.in_flight -= 1
