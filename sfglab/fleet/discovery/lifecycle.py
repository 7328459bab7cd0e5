"""Life of one remote agent as a table: paper A, section 4.2, Fig. 3.

A state says what local consumers have been told of the agent, and how its description is being asked for: a
grid, in which there is never a second query. That, the timers and the events are the paper's (`STATED`); what
happens when an agent is started again, changes, or does not answer is ours. Refuses to know messages and
clocks.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from sfglab.machine import step


class Told(Enum):
    """What local consumers have been told of an agent: the rows of the grid."""

    NOTHING = auto()  #: They have never heard of it, or it has been forgotten since.
    PRESENT = auto()  #: It is there.
    LOST = auto()  #: It was there, and its heartbeats stopped.


class Asking(Enum):
    """How an agent's description is being asked for: the columns of the grid."""

    NO = auto()  #: There is nothing to ask.
    QUERYING = auto()  #: One query is outstanding.
    BACKING_OFF = auto()  #: The last query failed; the next one waits.


class State(Enum):
    """Where a remote agent stands."""

    #: Nothing is known of it: the first state, and that of who is forgotten.
    UNKNOWN = Told.NOTHING, Asking.NO
    QUERYING = Told.NOTHING, Asking.QUERYING  #: A heartbeat was heard; what it is, is being asked.
    BACKING_OFF = Told.NOTHING, Asking.BACKING_OFF  #: It is alive and has not said yet what it is.
    ACTIVE = Told.PRESENT, Asking.NO  #: It is there, and what it is, is known.
    #: It is there; what is known is out of date and asked again.
    REFRESHING = Told.PRESENT, Asking.QUERYING
    #: It is there; what is known of it is out of date.
    REFRESH_BACK_OFF = Told.PRESENT, Asking.BACKING_OFF
    LOST = Told.LOST, Asking.NO  #: Its heartbeats stopped.
    #: It is back, but not as it was; what it is now, is asked.
    REJOINING = Told.LOST, Asking.QUERYING
    #: It is back, and has not said yet what it is now.
    REJOIN_BACK_OFF = Told.LOST, Asking.BACKING_OFF

    @property
    def told(self) -> Told:
        """What local consumers have been told."""
        return self.value[0]

    @property
    def asking(self) -> Asking:
        """How its description is being asked for."""
        return self.value[1]


class Input(Enum):
    """What can happen to a remote agent."""

    HEARD = auto()  #: A heartbeat that says nothing new.
    #: A heartbeat of the same start of the agent, with another revision of its description.
    CHANGED = auto()
    RESTARTED = auto()  #: A heartbeat of another start of the agent.
    #: The query was answered by the start that was announced, or none was announced yet.
    ANSWERED = auto()
    #: The query was answered by another start than the one that was announced.
    ANSWERED_ANEW = auto()
    #: The query failed, came to nothing in time, or was answered with something else.
    FAILED = auto()
    RETRY = auto()  #: The wait before the next query is over.
    SILENT = auto()  #: No heartbeat came for too long.
    EXPIRED = auto()  #: It has been of no use for too long, or its place is needed.


class Action(Enum):
    """What has to be done after a transition."""

    QUERY = auto()  #: Ask the agent what it is.
    ABANDON = auto()  #: Give up the outstanding query; an answer that still comes is ignored.
    BACK_OFF = auto()  #: Wait before the next query.
    DISCOVERED = auto()  #: Announce that an agent was seen for the first time.
    UPDATED = auto()  #: Announce that a known agent has another description.
    LOST = auto()  #: Announce that an agent's heartbeats stopped.
    RETURNED = auto()  #: Announce that a lost agent is back, the same start of it.
    RESTARTED = auto()  #: Announce that an agent is back as another start of it.
    FORGET = auto()  #: Drop everything that is known of it.


ANNOUNCEMENTS = frozenset(
    {Action.DISCOVERED, Action.UPDATED, Action.LOST, Action.RETURNED, Action.RESTARTED}
)
"""Actions that are discovery events, by the names of ``AgentDiscoveryEvent``'s constants."""

_S, _I, _A = State, Input, Action

TRANSITIONS: dict[tuple[State, Input], tuple[State, tuple[Action, ...]]] = {
    (_S.UNKNOWN, _I.HEARD): (_S.QUERYING, (_A.QUERY,)),
    # Heartbeats while a query is outstanding are signs of life and no reason for another one.
    (_S.QUERYING, _I.HEARD): (_S.QUERYING, ()),
    (_S.QUERYING, _I.CHANGED): (_S.QUERYING, ()),
    # Whom the query was sent to is gone.
    (_S.QUERYING, _I.RESTARTED): (_S.QUERYING, (_A.ABANDON, _A.QUERY)),
    (_S.QUERYING, _I.ANSWERED): (_S.ACTIVE, (_A.DISCOVERED,)),
    (_S.QUERYING, _I.FAILED): (_S.BACKING_OFF, (_A.BACK_OFF,)),
    (_S.QUERYING, _I.SILENT): (_S.UNKNOWN, (_A.ABANDON, _A.FORGET)),
    (_S.BACKING_OFF, _I.HEARD): (_S.BACKING_OFF, ()),
    (_S.BACKING_OFF, _I.CHANGED): (_S.BACKING_OFF, ()),
    (_S.BACKING_OFF, _I.RESTARTED): (_S.QUERYING, (_A.QUERY,)),
    (_S.BACKING_OFF, _I.RETRY): (_S.QUERYING, (_A.QUERY,)),
    (_S.BACKING_OFF, _I.SILENT): (_S.UNKNOWN, (_A.FORGET,)),
    (_S.BACKING_OFF, _I.EXPIRED): (_S.UNKNOWN, (_A.FORGET,)),
    (_S.ACTIVE, _I.HEARD): (_S.ACTIVE, ()),
    (_S.ACTIVE, _I.CHANGED): (_S.REFRESHING, (_A.QUERY,)),
    (_S.ACTIVE, _I.RESTARTED): (_S.REFRESHING, (_A.QUERY,)),
    (_S.ACTIVE, _I.SILENT): (_S.LOST, (_A.LOST,)),
    (_S.REFRESHING, _I.HEARD): (_S.REFRESHING, ()),
    (_S.REFRESHING, _I.CHANGED): (_S.REFRESHING, ()),
    (_S.REFRESHING, _I.RESTARTED): (_S.REFRESHING, (_A.ABANDON, _A.QUERY)),
    (_S.REFRESHING, _I.ANSWERED): (_S.ACTIVE, (_A.UPDATED,)),
    (_S.REFRESHING, _I.ANSWERED_ANEW): (_S.ACTIVE, (_A.RESTARTED,)),
    (_S.REFRESHING, _I.FAILED): (_S.REFRESH_BACK_OFF, (_A.BACK_OFF,)),
    (_S.REFRESHING, _I.SILENT): (_S.LOST, (_A.ABANDON, _A.LOST)),
    (_S.REFRESH_BACK_OFF, _I.HEARD): (_S.REFRESH_BACK_OFF, ()),
    (_S.REFRESH_BACK_OFF, _I.CHANGED): (_S.REFRESH_BACK_OFF, ()),
    (_S.REFRESH_BACK_OFF, _I.RESTARTED): (_S.REFRESHING, (_A.QUERY,)),
    (_S.REFRESH_BACK_OFF, _I.RETRY): (_S.REFRESHING, (_A.QUERY,)),
    (_S.REFRESH_BACK_OFF, _I.SILENT): (_S.LOST, (_A.LOST,)),
    (_S.LOST, _I.HEARD): (_S.ACTIVE, (_A.RETURNED,)),
    (_S.LOST, _I.CHANGED): (_S.REJOINING, (_A.QUERY,)),
    (_S.LOST, _I.RESTARTED): (_S.REJOINING, (_A.QUERY,)),
    (_S.LOST, _I.EXPIRED): (_S.UNKNOWN, (_A.FORGET,)),
    (_S.REJOINING, _I.HEARD): (_S.REJOINING, ()),
    (_S.REJOINING, _I.CHANGED): (_S.REJOINING, ()),
    (_S.REJOINING, _I.RESTARTED): (_S.REJOINING, (_A.ABANDON, _A.QUERY)),
    (_S.REJOINING, _I.ANSWERED): (_S.ACTIVE, (_A.RETURNED,)),
    (_S.REJOINING, _I.ANSWERED_ANEW): (_S.ACTIVE, (_A.RESTARTED,)),
    (_S.REJOINING, _I.FAILED): (_S.REJOIN_BACK_OFF, (_A.BACK_OFF,)),
    (_S.REJOINING, _I.SILENT): (_S.LOST, (_A.ABANDON,)),
    (_S.REJOIN_BACK_OFF, _I.HEARD): (_S.REJOIN_BACK_OFF, ()),
    (_S.REJOIN_BACK_OFF, _I.CHANGED): (_S.REJOIN_BACK_OFF, ()),
    (_S.REJOIN_BACK_OFF, _I.RESTARTED): (_S.REJOINING, (_A.QUERY,)),
    (_S.REJOIN_BACK_OFF, _I.RETRY): (_S.REJOINING, (_A.QUERY,)),
    (_S.REJOIN_BACK_OFF, _I.SILENT): (_S.LOST, ()),
}
"""(state, input) -> (next state, actions in order). What is not listed is illegal and changes nothing."""

STATED: dict[tuple[State, Input], str] = {
    (_S.UNKNOWN, _I.HEARD): "asynchronous ROS 2 service futures ... to track agents",
    (_S.QUERYING, _I.HEARD): "prevent redundant metadata queries",
    (_S.QUERYING, _I.ANSWERED): "discovering a new agent ... fires agent discovery events",
    (
        _S.ACTIVE,
        _I.HEARD,
    ): "by subscribing to the global heartbeat ... an active cache of the fleet",
    (
        _S.ACTIVE,
        _I.SILENT,
    ): "timers to track agents ... exposing the resulting state ... via discovery events",
}
"""The transitions that the paper's words state, sections 4.2 and 4.3 and the caption; the others are ours."""


class Lifecycle:
    """One remote agent's state; its name is for messages."""

    __slots__ = ("_agent", "state")

    def __init__(self, agent: str) -> None:
        self.state = State.UNKNOWN  #: Where it stands.
        self._agent = agent

    def feed(self, given: Input) -> tuple[Action, ...]:
        """Take an input and return what has to be done, in order; `IllegalInputError` if it cannot happen."""
        self.state, actions = step(f"agent {self._agent!r}", TRANSITIONS, self.state, given)
        return actions


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """A state and its place in the grid."""

    state: State  #: The state.
    #: 0 for what local consumers have not heard of, 1 for what is there, 2 for what is lost.
    row: int
    #: 0 when nothing is asked, 1 while a query is outstanding, 2 while the next one waits.
    column: int


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
        Node(state=s, row=list(Told).index(s.told), column=list(Asking).index(s.asking))
        for s in State
    )
    edges = tuple(
        Edge(source=source, given=given, target=target, actions=actions)
        for (source, given), (target, actions) in TRANSITIONS.items()
    )
    return nodes, edges
