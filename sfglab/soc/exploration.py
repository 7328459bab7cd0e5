"""The module `exploration` explores all worlds of a gateway core with its surroundings, up to a bound (claim C-FSM).

A *state* is one of the gateway core's states (`sfglab.soc.gateway.State`). A *world* is one global state: the core's
state together with the core's messages, the queues, the topics and the subscribers (`World`).

The exploration follows all interleavings of the steps in `sfglab.soc.gateway_world`, breadth first. For the bound the
exploration shows two properties:

- Safety: no step leads to a `Fault`. Hence no message is doubled, overtaken, overwritten or echoed, and no message
  that the core holds is replaced. The core receives only inputs for which the core's state has a transition.
- From every reachable world a path leads to the end, in which all subscribers have received all messages. Hence no
  message is lost, and the model has no deadlock.

The core always reaches the end only if the processes are fair: the scheduler runs each process now and then, and
the arbiter of the HMT grants the core's claim now and then. A counterexample is a shortest path to the reported
violation, because the exploration is breadth first.
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
    """A `Counterexample` is a shortest sequence of steps to a violation."""

    property: str  #: Violated property.
    trace: tuple[str, ...]  #: Steps from the first world in order, each step with its process.
    #: Last world before the violation, or the world from which no path leads to the end.
    last: World

    def __str__(self) -> str:
        lines = [f"{number:3d}  {line}" for number, line in enumerate(self.trace, start=1)]
        return "\n".join([self.property, *lines])


@dataclass(frozen=True, slots=True, kw_only=True)
class Exploration:
    """An `Exploration` is the result of one exploration."""

    worlds: int  #: Number of reachable worlds.
    steps: int  #: Number of steps between the worlds.
    visited: frozenset[State]  #: States of the core that occur in the worlds.
    #: Violation of a property; None if all properties hold within the bound.
    counterexample: Counterexample | None


class _Found:
    """`_Found` has the worlds that the search has found so far, in their order, and the steps to these worlds."""

    def __init__(self, first: World) -> None:
        #: Previous world and description of the step that first led to each world.
        self.reached_by: dict[World, tuple[World, str] | None] = {first: None}
        #: Worlds from which a step leads to each world.
        self.predecessors: dict[World, list[World]] = {first: []}
        self.steps = 0

    def trace(self, world: World) -> tuple[str, ...]:
        """Return the steps of a shortest path to a world."""
        lines = []
        reached = self.reached_by[world]
        while reached is not None:
            before, line = reached
            lines.append(line)
            reached = self.reached_by[before]
        return tuple(reversed(lines))

    def trapped(self, bound: Bound) -> list[World]:
        """Return the worlds from which no path leads to the end, in the order of the search."""
        can_finish: set[World] = set()
        waiting = [world for world in self.reached_by if is_finished(world, bound)]
        while waiting:
            world = waiting.pop()
            if world not in can_finish:
                can_finish.add(world)
                waiting.extend(self.predecessors[world])
        return [world for world in self.reached_by if world not in can_finish]


def explore(bound: Bound, table: Table = TABLE, *, limit: int = 1_000_000) -> Exploration:
    """Explore the worlds of a core that follows a table, until a property is violated or no new world is left.

    Args:
        bound: Numbers of messages and processes.
        table: Behaviour of the core.
        limit: Largest number of worlds.

    Raises:
        SfglabError: The bound has more worlds than the limit.
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
    """Return one interleaving of steps, which `rng` samples and which ends when all messages are received.

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
    """Find all worlds, breadth first, or the first fault."""
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
                f"exploration of {bound}: more than {limit} worlds; lower the bound or raise the limit"
            )
    return None


def _trap(found: _Found, trapped: list[World], bound: Bound, table: Table) -> Counterexample:
    """Return why no path leads to the end: a message is lost, or the worlds form a deadlock or a livelock."""
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
