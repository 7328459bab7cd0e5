"""What a reader does, compiled: samples, heartbeats and gaps that arrive (RTPS 2.5, clause 8.4.12).

Knows the state of one flow's reader; what it answers stands in `answers`. Refuses to know how a frame came.
"""

from __future__ import annotations

from typing import Any

from sfglab.rtps.answers import answer, make_room_behind_gap
from sfglab.rtps.heap import push
from sfglab.rtps.state import (
    R_ARMED,
    R_FIRST,
    R_HEAD,
    R_KNOWN,
    R_NEWEST,
    R_NEXT,
    R_OLDEST,
    R_TAIL,
    R_WAITING,
    S_WAITING,
    W_LAST,
    Count,
    Event,
    Fate,
    FlowColumn,
    Frame,
    TimingColumn,
)
from sfglab.rtps.world import compiled

# Compiled code takes plain integers.
_ACKNACK = int(Event.ACKNACK)
_DATA = int(Frame.DATA)
_OVERWRITTEN, _LATE = int(Fate.OVERWRITTEN), int(Fate.LATE)
_C_DUPLICATE = int(Count.DUPLICATE)
_SERVER, _READER_DEPTH, _RELIABLE = (
    int(FlowColumn.SERVER),
    int(FlowColumn.READER_DEPTH),
    int(FlowColumn.RELIABLE),
)
_T_NACK, _T_ACK, _T_PROMPT, _T_REORDER = (
    int(TimingColumn.NACK_DELAY_NS),
    int(TimingColumn.ACK_DELAY_NS),
    int(TimingColumn.PROMPT),
    int(TimingColumn.REORDER_MOST),
)


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
            # A repair may be older than what was pushed out before.
            world.reader[flow, R_OLDEST] = min(world.reader[flow, R_OLDEST], sample)
            if sample == world.reader[flow, R_NEXT]:
                _advance(world, flow)
        if not apart:
            _make_room(world, flow)


@compiled
def hear_samples(world: Any, frame: Any) -> None:
    """Take the one sample of a DATA frame, or the several of a BURST.

    Args:
        world: The run.
        frame: The frame.
    """
    alone = frame[0] == _DATA
    for i in range(1 if alone else 256):
        if alone or (frame[4 + i // 64] >> (i % 64)) & 1:
            _hear_sample(world, frame[1], frame[2] + i)


@compiled
def hear_heartbeat(world: Any, now: int, flow: int, first: int, last: int) -> None:
    """Learn what there is, and answer: at once if the vendor is prompt, else after its delay.

    Args:
        world: The run.
        now: Nanoseconds.
        flow: Whose reader.
        first: The oldest sample that the writer still has.
        last: Its newest.
    """
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
def hear_gap(world: Any, frame: Any) -> None:
    """Give up what the writer no longer has.

    Args:
        world: The run.
        frame: The GAP.
    """
    flow = frame[1]
    for sample in range(max(frame[2], world.reader[flow, R_NEXT]), frame[3]):
        if world.arrived[flow, sample] == 0:
            world.arrived[flow, sample] = 2
    _advance(world, flow)
