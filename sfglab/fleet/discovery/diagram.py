"""The state machine of `lifecycle` as nodes and edges, from which its figure is drawn."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.fleet.discovery.lifecycle import TRANSITIONS, Action, Asking, Input, State, Told


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """A state and its place in the grid."""

    state: State  #: The state.
    row: int  #: 0 for what local consumers have not heard of, 1 for what is there, 2 for what is lost.
    column: int  #: 0 when nothing is asked, 1 while a query is outstanding, 2 while the next one waits.


@dataclass(frozen=True, slots=True, kw_only=True)
class Edge:
    """A transition."""

    source: State  #: Where it starts.
    given: Input  #: What happened.
    target: State  #: Where it ends.
    actions: tuple[Action, ...]  #: What is done.

    @property
    def label(self) -> str:
        """The edge in UML's syntax, "event / action; action", with spaces for underscores."""
        done = "; ".join(action.name.lower() for action in self.actions)
        return (self.given.name.lower() + (f" / {done}" if done else "")).replace("_", " ")


def diagram() -> tuple[tuple[Node, ...], tuple[Edge, ...]]:
    """Return the states and the transitions of the table, in its order."""
    nodes = tuple(
        Node(state=s, row=list(Told).index(s.told), column=list(Asking).index(s.asking)) for s in State
    )
    edges = tuple(
        Edge(source=source, given=given, target=target, actions=actions)
        for (source, given), (target, actions) in TRANSITIONS.items()
    )
    return nodes, edges
