"""This module explores all states of a gateway core with its surroundings, up to a bound (claim C-FSM).

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


class _Found:
    """The global states found so far, in the order of the search, and the steps to them."""

    def __init__(self, first: World) -> None:
        #: State and description of the step that first led to each state.
        self.reached_by: dict[World, tuple[World, str] | None] = {first: None}
        #: States from which a step leads to each state.
        self.predecessors: dict[World, list[World]] = {first: []}
        self.steps = 0

    def trace(self, world: World) -> tuple[str, ...]:
        """Return the steps of a shortest path to a state."""
        lines = []
        reached = self.reached_by[world]
        while reached is not None:
            before, line = reached
            lines.append(line)
            reached = self.reached_by[before]
        return tuple(reversed(lines))

    def trapped(self, bound: Bound) -> list[World]:
        """Return the states from which the end cannot be reached, in the order of the search."""
        can_finish: set[World] = set()
        waiting = [world for world in self.reached_by if is_finished(world, bound)]
        while waiting:
            world = waiting.pop()
            if world not in can_finish:
                can_finish.add(world)
                waiting.extend(self.predecessors[world])
        return [world for world in self.reached_by if world not in can_finish]


def explore(bound: Bound, table: Table = TABLE, *, limit: int = 1_000_000) -> Exploration:
    """Explore a core that follows a table, until all is explored or a property is violated.

    Args:
        bound: Numbers of messages and processes.
        table: Behaviour of the core.
        limit: Largest number of global states.

    Raises:
        SfglabError: There are more global states than the limit.
    """
    found = _Found(first_world(bound))
    violation = _search(found, bound, table, limit)
    trapped = [] if violation else found.trapped(bound)
    if trapped:
        violation = _trap(found, trapped, bound, table)
    return Exploration(
        worlds=len(found.reached_by),
        steps=found.steps,
        visited=frozenset(world.state for world in found.reached_by),
        counterexample=violation,
    )


def walk(bound: Bound, rng: np.random.Generator, table: Table = TABLE) -> tuple[Step, ...]:
    """Return one interleaving, which is sampled at random and ends when all messages are received.

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


def _search(found: _Found, bound: Bound, table: Table, limit: int) -> Counterexample | None:
    """Find all global states, breadth first, or the first fault."""
    waiting = deque(found.reached_by)
    while waiting:
        world = waiting.popleft()
        for step in steps(world, bound, table):
            line = f"{step.actor} {step.what}"
            if isinstance(step.after, Fault):
                trace = (*found.trace(world), line)
                return Counterexample(property=step.after.text, trace=trace, last=world)
            found.steps += 1
            if step.after not in found.reached_by:
                found.reached_by[step.after] = (world, line)
                found.predecessors[step.after] = []
                waiting.append(step.after)
            found.predecessors[step.after].append(world)
        if len(found.reached_by) > limit:
            raise SfglabError(
                f"exploration of {bound}: more than {limit} global states; lower the bound or raise the limit"
            )
    return None


def _trap(found: _Found, trapped: list[World], bound: Bound, table: Table) -> Counterexample:
    """Return why the end cannot be reached: a message is lost, or none can move on."""
    stuck = [world for world in trapped if not any(steps(world, bound, table))]
    world = (stuck + trapped)[0]
    in_transit = {(message.publisher, message.number) for message in in_flight(world)}
    lost = []
    for publisher, sent in enumerate(world.sent):
        received_by_all = min(received[publisher] for received in world.received)
        numbers = range(received_by_all, sent)
        lost += [f"{publisher}.{n}" for n in numbers if (publisher, n) not in in_transit]
    if lost:
        text = f"lost: {', '.join(lost)}"
    elif stuck:
        text = "deadlock: messages are in flight and no step is possible"
    else:
        text = "livelock: steps are possible, such as polling, and none of them leads to the end"
    return Counterexample(property=text, trace=found.trace(world), last=world)
