"""Exhaustive exploration of a gateway core with its surroundings (claim C-FSM), up to a bound.

The exploration follows all interleavings of the steps in `sfglab.soc.gateway_world`, breadth first. It shows for
the bound:

- Safety: no step is a fault. No message is doubled, overtaken, overwritten or echoed, no held message is
  replaced, and the core receives only inputs that its state has a transition for.
- From every reachable state the end can be reached, in which all subscribers have received all messages. Hence
  no message is lost and nothing deadlocks.

That the end is always reached also needs fairness: each process runs now and then, and the arbiter of the HMT
grants the core's claim now and then. A counterexample is a shortest path to the violation that is reported,
because the search is breadth first.
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
    """A shortest sequence of steps to a violation."""

    property: str  #: Violated property.
    trace: tuple[str, ...]  #: Steps in order, each with its process.
    #: Last global state before the violation, or the one from which the end cannot be reached.
    last: World

    def __str__(self) -> str:
        lines = [f"{number:3d}  {line}" for number, line in enumerate(self.trace, start=1)]
        return "\n".join([self.property, *lines])


@dataclass(frozen=True, slots=True, kw_only=True)
class Exploration:
    """Result of an exploration."""

    worlds: int  #: Number of reachable global states.
    steps: int  #: Number of steps between them.
    visited: frozenset[State]  #: States of the core that occurred.
    counterexample: Counterexample | None  #: Violation; None: all properties hold within the bound.


class _Graph:
    """The global states found so far, numbered in the order of the search, and the steps to them."""

    def __init__(self, first: World) -> None:
        self.worlds = [first]
        self.predecessors: list[list[int]] = [[]]  #: States from which a step leads here, by state.
        self.with_steps: set[int] = set()  #: States in which a step is possible.
        self.steps = 0
        self._numbers = {first: 0}
        self._reached_by: list[tuple[int, str]] = [(0, "")]

    def add_step(self, source: int, line: str, world: World) -> bool:
        """Add a step from a state, and return whether it leads to a new state."""
        self.steps += 1
        self.with_steps.add(source)
        if world in self._numbers:
            self.predecessors[self._numbers[world]].append(source)
            return False
        self._numbers[world] = len(self.worlds)
        self.worlds.append(world)
        self.predecessors.append([source])
        self._reached_by.append((source, line))
        return True

    def trace(self, number: int) -> tuple[str, ...]:
        """Return the steps of a shortest path to a state."""
        lines = []
        while number:
            number, line = self._reached_by[number]
            lines.append(line)
        return tuple(reversed(lines))

    def trapped(self, bound: Bound) -> int | None:
        """Return a state from which the end cannot be reached, preferably one without any step."""
        can_finish = set()
        waiting = [n for n, world in enumerate(self.worlds) if is_finished(world, bound)]
        while waiting:
            number = waiting.pop()
            if number not in can_finish:
                can_finish.add(number)
                waiting.extend(self.predecessors[number])
        trapped = [n for n in range(len(self.worlds)) if n not in can_finish]
        stuck = [n for n in trapped if n not in self.with_steps]
        return next(iter(stuck + trapped), None)


def explore(bound: Bound, table: Table = TABLE, *, limit: int = 1_000_000) -> Exploration:
    """Explore a core that follows a table, until all is explored or a property is violated.

    Args:
        bound: Numbers of messages and processes.
        table: Behaviour of the core.
        limit: Largest number of global states.

    Raises:
        SfglabError: There are more global states than the limit.
    """
    graph = _Graph(first_world(bound))
    violation = _search(graph, bound, table, limit)
    if violation is None:
        trapped = graph.trapped(bound)
        if trapped is not None:
            violation = _trap(graph, trapped, bound)
    return Exploration(
        worlds=len(graph.worlds),
        steps=graph.steps,
        visited=frozenset(world.state for world in graph.worlds),
        counterexample=violation,
    )


def walk(bound: Bound, rng: np.random.Generator, table: Table = TABLE) -> tuple[Step, ...]:
    """Return one interleaving, sampled at random, until all messages are received.

    Raises:
        SfglabError: A property is violated, or no step is possible.
    """
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
    """Fill the graph, breadth first, and return the first fault."""
    waiting = deque([0])
    while waiting:
        number = waiting.popleft()
        world = graph.worlds[number]
        for step in steps(world, bound, table):
            line = f"{step.actor} {step.what}"
            if isinstance(step.after, Fault):
                trace = (*graph.trace(number), line)
                return Counterexample(property=step.after.text, trace=trace, last=world)
            if graph.add_step(number, line, step.after):
                waiting.append(len(graph.worlds) - 1)
        if len(graph.worlds) > limit:
            raise SfglabError(
                f"exploration of {bound}: more than {limit} global states; lower the bound or raise the limit"
            )
    return None


def _trap(graph: _Graph, number: int, bound: Bound) -> Counterexample:
    """Return why the end cannot be reached from a state: a message is lost, or none can move on."""
    world = graph.worlds[number]
    under_way = {(message.publisher, message.number) for message in in_flight(world)}
    lost = []
    for publisher, message_number in _not_received(world, bound):
        if (publisher, message_number) not in under_way:
            lost.append(f"{publisher}.{message_number}")
    if lost:
        text = f"lost: {', '.join(lost)}"
    elif number in graph.with_steps:
        text = "livelock: steps are possible, and none of them leads to the end"
    else:
        text = "deadlock: messages are in flight and no step is possible"
    return Counterexample(property=text, trace=graph.trace(number), last=world)


def _not_received(world: World, bound: Bound) -> list[tuple[int, int]]:
    """Return publisher and number of each message that is sent and not received by all subscribers."""
    missing: list[tuple[int, int]] = []
    for publisher in range(len(bound.totals)):
        received_by_all = min(received[publisher] for received in world.received)
        numbers = range(received_by_all, world.sent[publisher])
        missing.extend((publisher, number) for number in numbers)
    return missing
