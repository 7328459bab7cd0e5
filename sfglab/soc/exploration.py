"""Every interleaving of a gateway core and its surroundings, up to a bound.

Breadth first, so a counterexample is a shortest one. Shown for the bound: no step is a fault (nothing doubled,
overtaken, overwritten or echoed), and from every moment the end can be reached in which all have everything
(nothing lost, no deadlock, no trap). That it is reached also takes fairness: each side runs now and then, and
the arbiter grants the core's claim now and then. Refuses to know what a step means.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.errors import SfglabError
from sfglab.soc.gateway import TABLE, State, Table
from sfglab.soc.gateway_world import (
    Bound,
    Fault,
    Step,
    World,
    first_world,
    in_flight,
    is_finished,
    steps,
)

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class Counterexample:
    """A shortest way to something that must not happen."""

    property: str  #: What is violated, in words.
    trace: tuple[str, ...]  #: The steps that lead there, in order, each with its actor.
    last: World  #: The last world before the violation, or the first one without a way to the end.

    def __str__(self) -> str:
        return "\n".join(
            [self.property, *(f"{i:3d}  {line}" for i, line in enumerate(self.trace, start=1))]
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Exploration:
    """What an exploration found."""

    worlds: int  #: Reachable moments.
    steps: int  #: Steps between them.
    depth: int  #: Length of the longest of the shortest ways.
    visited: frozenset[State]  #: The core's states that occurred.
    #: A violation; None: every property holds within the bound.
    counterexample: Counterexample | None


class _Graph:
    """The worlds found so far, how each was reached first, and every step backwards."""

    def __init__(self, first: World) -> None:
        self.worlds = [first]
        self.depths = [0]
        self.sources: list[list[int]] = [[]]
        self.moving: set[int] = set()
        self.steps = 0
        self._number = {first: 0}
        self._reached: list[tuple[int, str]] = [(0, "")]

    def add(self, source: int, line: str, world: World) -> bool:
        """Add a step, and return whether it leads to a new world."""
        self.steps += 1
        self.moving.add(source)
        number = self._number.setdefault(world, len(self.worlds))
        if number < len(self.worlds):
            self.sources[number].append(source)
            return False
        self.worlds.append(world)
        self.depths.append(self.depths[source] + 1)
        self.sources.append([source])
        self._reached.append((source, line))
        return True

    def trace(self, number: int) -> tuple[str, ...]:
        """Return the steps of a shortest way to a world."""
        lines = []
        while number:
            number, line = self._reached[number]
            lines.append(line)
        return tuple(reversed(lines))

    def trapped(self, bound: Bound) -> int | None:
        """Return a world without a way to the end, one where nothing moves first; None: there is none."""
        waiting = [i for i, world in enumerate(self.worlds) if is_finished(world, bound)]
        saved = set(waiting)
        while waiting:
            new = [source for source in self.sources[waiting.pop()] if source not in saved]
            saved.update(new)
            waiting.extend(set(new))
        lost = [i for i in range(len(self.worlds)) if i not in saved]
        return next((i for i in lost if i not in self.moving), lost[0] if lost else None)


def explore(bound: Bound, table: Table = TABLE, *, limit: int = 1_000_000) -> Exploration:
    """Follow every interleaving of a core's behaviour up to a fault; SfglabError beyond `limit` worlds."""
    graph = _Graph(first_world(bound))
    fault = _search(graph, bound, table, limit)
    if fault is None and (trapped := graph.trapped(bound)) is not None:
        fault = _trap(graph, trapped, bound)
    return Exploration(
        worlds=len(graph.worlds),
        steps=graph.steps,
        depth=graph.depths[-1],
        visited=frozenset(world.state for world in graph.worlds),
        counterexample=fault,
    )


def walk(bound: Bound, rng: np.random.Generator, table: Table = TABLE) -> tuple[Step, ...]:
    """Return one drawn interleaving until everybody has everything; SfglabError at a fault or a deadlock."""
    world = first_world(bound)
    done: list[Step] = []
    while not is_finished(world, bound):
        possible = list(steps(world, bound, table))
        if not possible:
            raise SfglabError(f"walk of {bound}: nothing can move after {len(done)} steps")
        step = possible[rng.integers(len(possible))]
        if isinstance(step.after, Fault):
            raise SfglabError(f"walk of {bound}: {step.after.text}")
        done.append(step)
        world = step.after
    return tuple(done)


def _search(graph: _Graph, bound: Bound, table: Table, limit: int) -> Counterexample | None:
    """Fill the graph, breadth first, up to the first fault."""
    waiting = deque([0])
    while waiting:
        number = waiting.popleft()
        world = graph.worlds[number]
        for step in steps(world, bound, table):
            line = f"{step.actor} {step.what}"
            if isinstance(step.after, Fault):
                return Counterexample(
                    property=step.after.text, trace=(*graph.trace(number), line), last=world
                )
            if graph.add(number, line, step.after):
                waiting.append(len(graph.worlds) - 1)
        if len(graph.worlds) > limit:
            raise SfglabError(
                f"exploration of {bound}: more than {limit} worlds; lower the bound or raise the limit"
            )
    return None


def _trap(graph: _Graph, number: int, bound: Bound) -> Counterexample:
    """Say why the end is out of reach: a message is nowhere any more, or nothing can move it."""
    world = graph.worlds[number]
    missing = _missing(world, bound)
    under_way = {(message.publisher, message.number) for message in in_flight(world)}
    lost = [f"{publisher}.{n}" for publisher, n in missing if (publisher, n) not in under_way]
    stuck = "can move any more" if number not in graph.moving else "that moves brings them on"
    text = (
        f"lost: {', '.join(lost)}"
        if lost
        else f"deadlock: messages are under way and nothing {stuck}"
    )
    return Counterexample(property=text, trace=graph.trace(number), last=world)


def _missing(world: World, bound: Bound) -> list[tuple[int, int]]:
    """Return (publisher, number) of what was sent and is not with everybody."""
    seen = [min(counts) for counts in zip(world.smt_seen, *world.hmt_seen, strict=True)]
    return [(p, n) for p in range(len(bound.totals)) for n in range(seen[p], world.sent[p])]
