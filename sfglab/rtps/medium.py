"""The medium in compiled code: queues of frames at hosts, airtime, contention, loss and latency.

One half-duplex medium that all hosts share, as Wi-Fi is, or a sender of its own for each host, as an Ethernet
port is. Knows frames only by size and way.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sfglab.rtps.heap import push
from sfglab.rtps.state import Count, Drop, Event, FlowColumn, Frame, TimingColumn
from sfglab.rtps.world import compiled

# Bytes of a frame. Ethernet 14, IPv4 20, UDP 8; RTPS header 20; submessages: INFO_DST 16, INFO_TS 12, DATA 24
# and the payload, HEARTBEAT 32, ACKNACK 28 and a bitmap of 32, GAP 32 (RTPS 2.5, 9.4).
_BASE = 14 + 20 + 8 + 20
_DATA = _BASE + 12 + 24
_INFO_DST = 16
_HEARTBEAT = 32
_ACKNACK = _BASE + 16 + 28 + 32
_GAP = _BASE + 16 + 32

BURST_ROOM = 512
"""More than the samples of one BURST."""

_C_LOST, _C_FULL, _C_BYTES, _C_AIR = (
    int(Count.LOST),
    int(Count.QUEUE_FULL),
    int(Count.BYTES),
    int(Count.AIRTIME_NS),
)
_SENT, _ARRIVED = int(Event.SENT), int(Event.ARRIVED)
_F_DATA, _F_HB, _F_ACK, _F_BURST = int(Frame.DATA), int(Frame.HEARTBEAT), int(Frame.ACKNACK), int(Frame.BURST)
_D_MEDIUM, _D_QUEUE = int(Drop.MEDIUM), int(Drop.QUEUE)
_SIZE, _SOURCE, _TARGET = int(FlowColumn.SIZE_BYTES), int(FlowColumn.SOURCE), int(FlowColumn.TARGET)
_SHARED, _LATENCY, _OVERHEAD = (
    int(TimingColumn.SHARED),
    int(TimingColumn.LATENCY_NS),
    int(TimingColumn.OVERHEAD_NS),
)


@compiled
def uniform(random: Any) -> float:
    """Return the next number of [0, 1): SplitMix64, so that a seed gives the same run on every machine."""
    random[0] += np.uint64(0x9E3779B97F4A7C15)
    z = random[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) / 9007199254740992.0


@compiled
def _sample_bytes(size: int) -> int:
    """Return what one sample adds to a message: INFO_TS, DATA and the payload, padded as CDR is."""
    return int(_DATA - _BASE + (size + 3) // 4 * 4)


@compiled
def burst_most(size: int, message_bytes: int) -> int:
    """Return how many samples of a size fit into a message of repairs with a heartbeat."""
    return max(1, (message_bytes - 20 - _INFO_DST - _HEARTBEAT) // _sample_bytes(size))


@compiled
def _size_bytes(world: Any, kind: int, flow: int, riding: int) -> int:
    """Return the size of a frame; `riding` is its second argument, see `claim`."""
    size = world.flows[flow, _SIZE]
    if kind == _F_DATA:
        return int(_BASE + _sample_bytes(size) + (_HEARTBEAT if riding else 0))
    if kind == _F_BURST:
        rest = _BASE + _INFO_DST + (_HEARTBEAT if riding >= BURST_ROOM else 0)
        return int(rest + riding % BURST_ROOM * _sample_bytes(size))
    if kind == _F_HB:
        return _BASE + 16 + _HEARTBEAT
    return _ACKNACK if kind == _F_ACK else _GAP


@compiled
def _note_drop(world: Any, kind: int, flow: int, sample: int, where: int) -> None:
    if kind == _F_DATA and world.dropped[flow, sample] == 0 and world.arrived[flow, sample] == 0:
        world.dropped[flow, sample] = where


@compiled
def claim(world: Any, host: int, kind: int, flow: int, sample: int) -> int:
    """Return the place for a frame at the end of a host's queue, -1 when the queue is full.

    The caller writes the frame there, eight words: kind, flow, two arguments, four more; and then calls
    `send_next`. Arguments of DATA: sample, and whether a heartbeat rides along, 1 to be answered, 2 FINAL; of
    BURST: first sample of its bitmap, and the number of samples in it, to which `BURST_ROOM` times the newest
    sample is added if a heartbeat rides along. The sixth word of GAP is not 0 if one does.

    Args:
        world: The run.
        host: Whose queue.
        kind: Of the frame.
        flow: Of the frame.
        sample: Which one a DATA frame carries.
    """
    ends = world.queue_ends
    capacity = world.queue.shape[1]
    if ends[host, 1] == capacity:
        world.counts[_C_FULL] += 1
        _note_drop(world, kind, flow, sample, _D_QUEUE)
        return -1
    place = ends[host, 0] + ends[host, 1]
    ends[host, 1] += 1
    return int(place - capacity if place >= capacity else place)


@compiled
def _choose_host(world: Any, transmitter: int) -> tuple[int, int]:
    """Return whose turn it is, -1 for nobody's, and how many have something to send."""
    if not world.timing[_SHARED]:
        waiting = world.queue_ends[transmitter, 1]
        return (transmitter if waiting else -1), 1
    hosts = world.queue_ends.shape[0]
    chosen, contenders = -1, 0
    host = world.next_host[0] - 1
    for _ in range(hosts):
        host += 1
        if host == hosts:
            host = 0
        if world.queue_ends[host, 1]:
            contenders += 1
            if chosen < 0:
                chosen = host
    if chosen >= 0:
        world.next_host[0] = 0 if chosen + 1 == hosts else chosen + 1
    return chosen, contenders


@compiled
def send_next(world: Any, now: int, transmitter: int) -> None:
    """Send the next host's oldest frame, if the medium is free.

    Args:
        world: The run.
        now: Nanoseconds.
        transmitter: 0 where hosts share the medium, else the host.
    """
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
    size = _size_bytes(world, air[transmitter, 1], air[transmitter, 2], air[transmitter, 4])
    stretch = 1.0 + world.rates[2] * (contenders - 1)
    airtime = int((world.timing[_OVERHEAD] + size * 8e9 / world.rates[1]) * stretch)
    world.counts[_C_BYTES] += size
    world.counts[_C_AIR] += airtime
    air[transmitter, 0] = 1
    push(world.heap, world.heap_sizes, now + airtime, _SENT, transmitter)


@compiled
def sent_frame(world: Any, now: int, transmitter: int, frame: Any) -> bool:
    """Take a frame off the air into `frame`, and return whether it is there: neither lost nor under way."""
    air = world.on_air
    for k in range(8):
        frame[k] = air[transmitter, 1 + k]
    air[transmitter, 0] = 0
    there = False
    if uniform(world.random) < world.rates[0]:
        world.counts[_C_LOST] += 1
        _note_drop(world, frame[0], frame[1], frame[2], _D_MEDIUM)
    elif world.timing[_LATENCY] == 0:
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
        push(world.heap, world.heap_sizes, now + world.timing[_LATENCY], _ARRIVED, transmitter)
    send_next(world, now, transmitter)
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
