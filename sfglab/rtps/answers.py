"""What readers ask for and how repairs travel, compiled: ACKNACK, and the ways of a prompt vendor.

Knows the state of one flow. Refuses to know when a heartbeat is sent, and what happens to a sample in order.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sfglab.rtps.medium import BURST_ROOM, burst_most, claim, send_next
from sfglab.rtps.state import (
    R_ACKED,
    R_ACKED_AT,
    R_AGAIN,
    R_ASKED,
    R_HEAD,
    R_KNOWN,
    R_NACKED,
    R_NACKED_AT,
    R_NEWEST,
    R_NEXT,
    R_REPAIRED,
    R_TAIL,
    R_WAITING,
    S_WAITING,
    W_LAST,
    Count,
    Fate,
    FlowColumn,
    Frame,
    TimingColumn,
)
from sfglab.rtps.world import compiled

# Compiled code takes plain integers.
_ACK, _GAP, _BURST = int(Frame.ACKNACK), int(Frame.GAP), int(Frame.BURST)
_LATE = int(Fate.LATE)
_SHARED = int(TimingColumn.SHARED)
_SOURCE, _TARGET, _SERVER, _READER_DEPTH, _SIZE = (
    int(FlowColumn.SOURCE),
    int(FlowColumn.TARGET),
    int(FlowColumn.SERVER),
    int(FlowColumn.READER_DEPTH),
    int(FlowColumn.SIZE_BYTES),
)
_C_DATA, _C_REPEATED = int(Count.DATA), int(Count.REPEATED)
_T_BURST, _T_NACK, _T_ACK, _T_MOST, _T_REORDER = (
    int(TimingColumn.BURST_BYTES),
    int(TimingColumn.NACK_DELAY_NS),
    int(TimingColumn.ACK_DELAY_NS),
    int(TimingColumn.NACK_MOST),
    int(TimingColumn.REORDER_MOST),
)


@compiled
def request(world: Any, now: int, flow: int) -> None:
    """Acknowledge everything before the next sample, and ask for what is known to exist and is not here."""
    reader = world.reader
    base = reader[flow, R_NEXT]
    world.counts[_ACK] += 1
    host = world.flows[flow, _TARGET]
    place = claim(world, host, _ACK, flow, base)
    if place < 0:
        return
    frame = world.queue[host, place]
    frame[0], frame[1], frame[2] = _ACK, flow, base
    most = min(world.timing[_T_MOST], reader[flow, R_KNOWN] - base + 1)
    for k in range(4):
        start = base + 64 * k
        word = np.int64(0)
        for i in range(min(64, most - 64 * k)):
            word |= np.int64(world.arrived[flow, start + i] == 0) << i
        frame[4 + k] = word
    send_next(world, now, 0 if world.timing[_SHARED] else host)


@compiled
def answer(world: Any, now: int, flow: int) -> None:
    """Answer a heartbeat as a prompt reader does, or not at all.

    Something that no request has covered yet is asked for at once; the same again after the vendor's
    `nack_delay_ns`, or when repairs have come and did not bring it, once. An acknowledgement goes out only when
    the writer asks for it, and the same one again after `ack_delay_ns`.

    Args:
        world: The run.
        now: Nanoseconds.
        flow: Whose reader.
    """
    reader, timing = world.reader, world.timing
    base, known = reader[flow, R_NEXT], reader[flow, R_KNOWN]
    if base <= known:
        fresh = base >= reader[flow, R_NACKED]
        waited = now >= reader[flow, R_NACKED_AT] + timing[_T_NACK]
        vain = reader[flow, R_REPAIRED] and (waited or not reader[flow, R_AGAIN])
        if fresh or vain or waited:
            reader[flow, R_AGAIN] = 0 if fresh or vain else 1
            reader[flow, R_NACKED] = min(known + 1, base + timing[_T_MOST])
            reader[flow, R_NACKED_AT] = now
            _note_answer(world, now, flow)
            request(world, now, flow)
            return
    if reader[flow, R_ASKED] and (
        base > reader[flow, R_ACKED] or now >= reader[flow, R_ACKED_AT] + timing[_T_ACK]
    ):
        _note_answer(world, now, flow)
        frame = world.scratch[1]
        frame[:] = 0
        frame[0], frame[1], frame[2] = _ACK, flow, base
        world.counts[_ACK] += 1
        _put(world, now, world.flows[flow, _TARGET], frame)


@compiled
def _note_answer(world: Any, now: int, flow: int) -> None:
    reader = world.reader
    reader[flow, R_ASKED] = reader[flow, R_REPAIRED] = 0
    reader[flow, R_ACKED], reader[flow, R_ACKED_AT] = reader[flow, R_NEXT], now


@compiled
def make_room_behind_gap(world: Any, flow: int, sample: int) -> bool:
    """Return whether a sample can be kept; where too many wait behind a gap, the newest of all is dropped.

    Args:
        world: The run.
        flow: Whose reader.
        sample: What has arrived, for the first time.
    """
    reader, most = world.reader, world.timing[_T_REORDER]
    if sample == reader[flow, R_NEXT] or reader[flow, R_WAITING] < most:
        return True
    newest = reader[flow, R_NEWEST]
    if sample > newest:
        return False
    world.arrived[flow, newest] = 0
    reader[flow, R_WAITING] -= 1
    while newest > sample and world.arrived[flow, newest] != 1:
        newest -= 1
    reader[flow, R_NEWEST] = newest
    return True


@compiled
def drop_overflow(world: Any, flow: int) -> None:
    """Push the oldest samples out of a reader's history: what waited behind a gap comes all at once."""
    reader, depth = world.reader, world.flows[flow, _READER_DEPTH]
    while depth and reader[flow, R_TAIL] - reader[flow, R_HEAD] > depth:
        world.fate[flow, world.order[flow, reader[flow, R_HEAD]]] = _LATE
        reader[flow, R_HEAD] += 1
        world.server[world.flows[flow, _SERVER], S_WAITING] -= 1


@compiled
def repair_in_bursts(world: Any, now: int, flow: int, base: int, kept: int) -> None:
    """Send what was asked for, many samples a frame, and a heartbeat with the last one.

    Args:
        world: The run.
        now: Nanoseconds.
        flow: Whose writer; its request is in `State.repair`.
        base: First sample of the request.
        kept: The oldest sample in the writer's history.
    """
    last, most = world.writer[flow, W_LAST], burst_most(world.flows[flow, _SIZE], world.timing[_T_BURST])
    left = 0
    for i in range(256):
        left += _asked(world, flow, i) and kept <= base + i <= last
    frame = world.scratch[1]
    frame[:] = 0
    if base < kept:
        frame[0], frame[1], frame[2], frame[3] = _GAP, flow, base, kept
        frame[4], frame[5] = kept, last if left == 0 else 0
        world.counts[_GAP] += 1
        _put(world, now, world.flows[flow, _SOURCE], frame)
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
            _put(world, now, world.flows[flow, _SOURCE], frame)
            inside = 0


@compiled
def _put(world: Any, now: int, host: int, frame: Any) -> None:
    place = claim(world, host, frame[0], frame[1], frame[2])
    if place >= 0:
        for k in range(8):
            world.queue[host, place, k] = frame[k]
        send_next(world, now, 0 if world.timing[_SHARED] else host)


@compiled
def _asked(world: Any, flow: int, place: int) -> bool:
    return bool((world.repair[flow, 1 + place // 64] >> (place % 64)) & 1)
