"""The reader, compiled: samples, heartbeats and gaps that arrive, and its answers (RTPS 2.5, clause 8.4.12).

In all functions `world` is the run, `now` is nanoseconds, and `flow` is whose reader it is.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sfglab.rtps.medium import enqueue, fragment_count, note_drop
from sfglab.rtps.state import Count, Drop, Event, Fate, FlowColumn, Frame, R, S, TimingColumn, W
from sfglab.rtps.world import compiled, push


@compiled
def _make_room(world: Any, flow: int) -> None:
    """Push the oldest sample out of a reader's history that is over its bound, in order or behind a gap."""
    reader = world.reader
    depth = world.flows[flow, FlowColumn.READER_DEPTH]
    held = reader[flow, R.TAIL] - reader[flow, R.HEAD]
    if depth == 0 or held + reader[flow, R.WAITING] <= depth:
        return
    if held > 0:
        oldest = world.order[flow, reader[flow, R.HEAD]]
        reader[flow, R.HEAD] += 1
        world.server[world.flows[flow, FlowColumn.SERVER], S.WAITING] -= 1
    else:
        oldest = max(reader[flow, R.OLDEST], reader[flow, R.NEXT])
        while world.arrived[flow, oldest] != 1:
            oldest += 1
        reader[flow, R.OLDEST] = oldest + 1
        reader[flow, R.WAITING] -= 1
        world.arrived[flow, oldest] = 2
    world.fate[flow, oldest] = Fate.LATE


@compiled
def _keep(world: Any, flow: int, sample: int) -> None:
    """Hand a sample to the reader's history, from which the executor takes it."""
    reader = world.reader
    world.order[flow, reader[flow, R.TAIL]] = sample
    reader[flow, R.TAIL] += 1
    world.server[world.flows[flow, FlowColumn.SERVER], S.WAITING] += 1


@compiled
def _advance(world: Any, flow: int) -> None:
    """Deliver in order what is there, and give up what the writer no longer has."""
    reader = world.reader
    last = world.writer[flow, W.LAST]
    sample = reader[flow, R.NEXT]
    while sample <= last:
        if world.arrived[flow, sample] == 1:
            reader[flow, R.WAITING] -= 1
            _keep(world, flow, sample)
        elif world.arrived[flow, sample] == 2 or sample < reader[flow, R.FIRST]:
            if world.fate[flow, sample] == 0:
                world.fate[flow, sample] = Fate.OVERWRITTEN
        else:
            break
        sample += 1
    reader[flow, R.NEXT] = sample


@compiled
def _make_room_behind_gap(world: Any, flow: int, sample: int) -> bool:
    """Return whether a sample can be kept; where too many wait behind a gap, the newest of all is dropped."""
    reader, most = world.reader, world.timing[TimingColumn.REORDER_MOST]
    if sample == reader[flow, R.NEXT] or reader[flow, R.WAITING] < most:
        return True
    newest = reader[flow, R.NEWEST]
    if sample > newest:
        return False
    world.arrived[flow, newest] = 0
    reader[flow, R.WAITING] -= 1
    while newest > sample and world.arrived[flow, newest] != 1:
        newest -= 1
    reader[flow, R.NEWEST] = newest
    return True


@compiled
def _hear_sample(world: Any, flow: int, sample: int) -> None:
    apart = world.timing[TimingColumn.REORDER_MOST] != 0
    if world.arrived[flow, sample] or sample < world.reader[flow, R.NEXT]:
        world.counts[Count.DUPLICATE] += 1
    elif not apart or _make_room_behind_gap(world, flow, sample):
        world.arrived[flow, sample] = 1
        world.reader[flow, R.NEWEST] = max(world.reader[flow, R.NEWEST], sample)
        if not world.flows[flow, FlowColumn.RELIABLE]:
            _keep(world, flow, sample)
            world.reader[flow, R.NEXT] = sample + 1
        else:
            world.reader[flow, R.WAITING] += 1
            if sample == world.reader[flow, R.NEXT]:
                _advance(world, flow)
            elif (
                sample < world.reader[flow, R.OLDEST]
            ):  # a repair, older than what was pushed out before
                world.reader[flow, R.OLDEST] = sample
        if not apart:
            _make_room(world, flow)


@compiled
def is_whole(world: Any, frame: Any) -> bool:
    """Note a FRAGMENT, and return whether there are samples: of a BURST, whether all frames before it came."""
    reader, flow = world.reader, frame[1]
    if frame[0] == Frame.FRAGMENT:
        follows = frame[2] == 0 or reader[flow, R.FRAGMENTS] == frame[2]
        reader[flow, R.FRAGMENTS] = frame[2] + 1 if follows else -1
        return False
    before = fragment_count(world.flows[flow, FlowColumn.SIZE_BYTES], frame[3])
    if before and reader[flow, R.FRAGMENTS] != before:
        note_drop(world, frame, Drop.MEDIUM)
        return False
    return True


@compiled
def hear_samples(world: Any, frame: Any) -> None:
    """Take the one sample of a DATA frame, or the several of a BURST."""
    alone = frame[0] == Frame.DATA
    for i in range(1 if alone else 256):
        if alone or (frame[4 + i // 64] >> (i % 64)) & 1:
            _hear_sample(world, frame[1], frame[2] + i)


@compiled
def hear_heartbeat(world: Any, now: int, flow: int, first: int, last: int) -> None:
    """Learn what there is, and answer: at once if the vendor is prompt, else after its delay."""
    reader = world.reader
    reader[flow, R.FIRST] = max(reader[flow, R.FIRST], first)
    reader[flow, R.KNOWN] = max(reader[flow, R.KNOWN], last)
    _advance(world, flow)
    if world.timing[TimingColumn.PROMPT]:
        _answer(world, now, flow)
    elif not reader[flow, R.ARMED]:
        reader[flow, R.ARMED] = 1
        lacks = reader[flow, R.NEXT] <= reader[flow, R.KNOWN]
        delay = (
            world.timing[TimingColumn.NACK_DELAY_NS]
            if lacks
            else world.timing[TimingColumn.ACK_DELAY_NS]
        )
        push(world.heap, world.heap_sizes, now + delay, Event.ACKNACK, flow)


@compiled
def hear_gap(world: Any, frame: Any) -> None:
    """Give up what the writer no longer has."""
    flow = frame[1]
    for sample in range(max(frame[2], world.reader[flow, R.NEXT]), frame[3]):
        if world.arrived[flow, sample] == 0:
            world.arrived[flow, sample] = 2
    _advance(world, flow)


@compiled
def drop_overflow(world: Any, flow: int) -> None:
    """Push the oldest samples out of a reader's history: what waited behind a gap comes all at once."""
    reader, depth = world.reader, world.flows[flow, FlowColumn.READER_DEPTH]
    while depth and reader[flow, R.TAIL] - reader[flow, R.HEAD] > depth:
        world.fate[flow, world.order[flow, reader[flow, R.HEAD]]] = Fate.LATE
        reader[flow, R.HEAD] += 1
        world.server[world.flows[flow, FlowColumn.SERVER], S.WAITING] -= 1


@compiled
def request(world: Any, now: int, flow: int) -> None:
    """Acknowledge everything before the next sample, and ask for what is known to exist and is not here."""
    base = world.reader[flow, R.NEXT]
    most = min(world.timing[TimingColumn.NACK_MOST], world.reader[flow, R.KNOWN] - base + 1)
    frame = world.scratch[1]
    for k in range(4):
        start = base + 64 * k
        word = np.int64(0)
        for i in range(min(64, most - 64 * k)):
            word |= np.int64(world.arrived[flow, start + i] == 0) << i
        frame[4 + k] = word
    _acknowledge(world, now, flow, frame)


@compiled
def _acknowledge(world: Any, now: int, flow: int, frame: Any) -> None:
    frame[0], frame[1], frame[2], frame[3] = Frame.ACKNACK, flow, world.reader[flow, R.NEXT], 0
    world.counts[Frame.ACKNACK] += 1
    enqueue(world, now, world.flows[flow, FlowColumn.TARGET], frame)


@compiled
def _answer(world: Any, now: int, flow: int) -> None:
    """Answer a heartbeat as a prompt reader does, or not at all.

    Something that no request has covered yet is asked for at once; the same again after the vendor's
    `nack_delay_ns`, or when repairs have come and did not bring it, once. An acknowledgement goes out only when
    the writer asks for it, and the same one again after `ack_delay_ns`.
    """
    reader, timing = world.reader, world.timing
    base, known = reader[flow, R.NEXT], reader[flow, R.KNOWN]
    if base <= known:
        fresh = base >= reader[flow, R.NACKED]
        waited = now >= reader[flow, R.NACKED_AT] + timing[TimingColumn.NACK_DELAY_NS]
        vain = reader[flow, R.REPAIRED] and (waited or not reader[flow, R.AGAIN])
        if fresh or vain or waited:
            reader[flow, R.AGAIN] = 0 if fresh or vain else 1
            reader[flow, R.NACKED] = min(known + 1, base + timing[TimingColumn.NACK_MOST])
            reader[flow, R.NACKED_AT] = now
            _note_answer(world, now, flow)
            request(world, now, flow)
            return
    if reader[flow, R.ASKED] and (
        base > reader[flow, R.ACKED]
        or now >= reader[flow, R.ACKED_AT] + timing[TimingColumn.ACK_DELAY_NS]
    ):
        _note_answer(world, now, flow)
        frame = world.scratch[1]
        frame[4:] = 0
        _acknowledge(world, now, flow, frame)


@compiled
def _note_answer(world: Any, now: int, flow: int) -> None:
    reader = world.reader
    reader[flow, R.ASKED] = reader[flow, R.REPAIRED] = 0
    reader[flow, R.ACKED], reader[flow, R.ACKED_AT] = reader[flow, R.NEXT], now
