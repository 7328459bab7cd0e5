"""Traces of runs: every frame that was on air, when, what it said, and whether it was lost.

The compiled engine's own events (`medium`): a trace is written where the medium decides, and there somebody may
wish that a frame be lost or pass. Frames have names that stay when others are lost. Refuses to draw them.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.rtps.model import BURST_ROOM, compile_scenario, most_samples
from sfglab.rtps.session import outcome_of
from sfglab.rtps.state import Frame, TimingColumn, TraceColumn

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from sfglab.rtps.model import Scenario
    from sfglab.rtps.session import Outcome


@dataclass(frozen=True, slots=True, kw_only=True)
class AirFrame:
    """One frame on air."""

    #: Flow, kind and number, as in ``a/HEARTBEAT/2``; of DATA its sample's, and which repair: ``a/DATA/7.1``.
    name: str
    kind: Frame  #: Which submessages it carries.
    began_ns: int  #: When it went on air.
    ended_ns: int  #: When it left the air.
    lost: bool  #: Whether the medium lost it then.
    samples: tuple[int, ...]  #: Those it carries, asks for or declares to be gone, counted from 1.
    #: The newest sample that a heartbeat in it announces, the newest that an ACKNACK acknowledges; 0: neither.
    newest: int
    repairs: bool  #: Whether its samples were on air before.


def trace(
    scenario: Scenario, *, seed: int, lost: Mapping[str, bool] | None = None
) -> tuple[Outcome, tuple[AirFrame, ...]]:
    """Simulate a scenario as `run` does, and return every frame as well, as they left the air.

    Args:
        scenario: What.
        seed: Of losses and values.
        lost: Names of frames that are lost, or pass, whatever the seed draws for them.
    """
    wishes: dict[int, bool] = {}
    # A wish changes what follows, so that each is granted where its frame turns up: the earliest first.
    while True:
        outcome, frames = _run(scenario, seed, wishes)
        ungranted = [i for i, f in enumerate(frames) if (lost or {}).get(f.name, f.lost) != f.lost]
        if not ungranted:
            return outcome, frames
        wishes[ungranted[0]] = not frames[ungranted[0]].lost


def _run(scenario: Scenario, seed: int, wishes: Mapping[int, bool]) -> tuple[Outcome, tuple[AirFrame, ...]]:
    from sfglab.rtps.engine import advance
    from sfglab.rtps.world import World

    room = 1024
    while True:
        params, state = compile_scenario(scenario, samples=most_samples(scenario), seed=seed, trace=room)
        for number, is_lost in wishes.items():
            state.trace[number, TraceColumn.WISH] = 1 if is_lost else 2
        until_ns = params.timing[[TimingColumn.DURATION_NS, TimingColumn.DRAIN_NS]].sum()
        advance(World(params, state), int(until_ns))
        if state.trace_end[0] < room:
            rows, names = state.trace[: state.trace_end[0]], [flow.name for flow in scenario.flows]
            return outcome_of(scenario.flows, params, state), tuple(_frames(rows, names))
        room *= 8


def _frames(rows: NDArray[np.int64], flows: Sequence[str]) -> Iterator[AirFrame]:
    before: Counter[str] = Counter()
    for row in rows.tolist():
        kind, flow = Frame(row[0]), flows[row[1]]
        is_data = kind is Frame.DATA
        name = f"{flow}/{kind.name}" + (f"/{row[2]}" if is_data else "")
        number = before[name]
        before[name] += 1
        samples, newest = _said(kind, row)
        yield AirFrame(
            name=(f"{name}.{number}" if number else name) if is_data else f"{name}/{number + 1}",
            kind=kind,
            began_ns=row[TraceColumn.BEGAN],
            ended_ns=row[TraceColumn.ENDED],
            lost=bool(row[TraceColumn.LOST]),
            samples=samples,
            newest=newest,
            repairs=kind is Frame.BURST or (is_data and number > 0),
        )


def _said(kind: Frame, row: Sequence[int]) -> tuple[tuple[int, ...], int]:
    """Return the samples that a frame, as `medium.enqueue` has it, is about, and `AirFrame.newest`."""
    asked = tuple(row[2] + i for i in range(256) if row[4 + i // 64] >> i % 64 & 1)
    if kind is Frame.ACKNACK:
        return asked, row[2] - 1
    if kind is Frame.BURST:
        return asked, row[3] // BURST_ROOM
    if kind is Frame.DATA:
        return (row[2],), row[5] if row[3] else 0
    return tuple(range(row[2], row[3])), row[5]  # a heartbeat's is empty
