"""Life cycle of one remote agent as a transition table: paper A, section 4.2, Fig. 3.

A state combines two facts: what local consumers have been told about the agent, and whether its description is
being queried. There is never a second query. This rule, the timers and the events are the paper's (`STATED`).
Restarts, changes and failed queries are ours. The module does not depend on messages or clocks.
"""

from __future__ import annotations

from enum import Enum, auto

from sfglab.machine import step, transitions


class Announced(Enum):
    """Last announcement about an agent to local consumers: the rows of the grid."""

    NOTHING = auto()  #: The agent was never announced, or it has been forgotten since.
    PRESENT = auto()  #: The agent is present.
    LOST = auto()  #: The agent was present, and its heartbeats stopped.


class QueryState(Enum):
    """State of the query for an agent's description: the columns of the grid."""

    NONE = auto()  #: No query is needed.
    QUERYING = auto()  #: One query is outstanding.
    BACKING_OFF = auto()  #: The last query failed; the next one waits.


class State(Enum):
    """State of a remote agent."""

    #: Nothing is known about the agent. This is the first state, and the state of a forgotten agent.
    UNKNOWN = Announced.NOTHING, QueryState.NONE
    #: A heartbeat was received; the description is being queried.
    QUERYING = Announced.NOTHING, QueryState.QUERYING
    #: The agent sends heartbeats, and its description is still unknown.
    BACKING_OFF = Announced.NOTHING, QueryState.BACKING_OFF
    ACTIVE = Announced.PRESENT, QueryState.NONE  #: The agent is present; its description is known.
    #: The agent is present; its description is outdated and is being queried.
    REFRESHING = Announced.PRESENT, QueryState.QUERYING
    #: The agent is present; its description is outdated.
    REFRESH_BACK_OFF = Announced.PRESENT, QueryState.BACKING_OFF
    LOST = Announced.LOST, QueryState.NONE  #: The agent's heartbeats stopped.
    #: The agent sends heartbeats again, and has changed; its description is being queried.
    REJOINING = Announced.LOST, QueryState.QUERYING
    #: The agent sends heartbeats again; its new description is still unknown.
    REJOIN_BACK_OFF = Announced.LOST, QueryState.BACKING_OFF

    @property
    def announced(self) -> Announced:
        """The last announcement to local consumers."""
        return self.value[0]

    @property
    def query(self) -> QueryState:
        """The state of the query for the description."""
        return self.value[1]


class Input(Enum):
    """Input of the life cycle: an event of a remote agent."""

    HEARD = auto()  #: A heartbeat without news.
    #: A heartbeat of the same incarnation with another revision of the description.
    CHANGED = auto()
    RESTARTED = auto()  #: A heartbeat of another incarnation of the agent.
    #: An answer from the announced incarnation, or the first answer.
    ANSWERED = auto()
    ANSWERED_ANEW = auto()  #: An answer from another incarnation than the announced one.
    FAILED = auto()  #: The query failed, timed out, or got an answer that does not match.
    RETRY = auto()  #: The wait before the next query is over.
    SILENT = auto()  #: No heartbeat arrived for too long.
    EXPIRED = auto()  #: The agent has been useless for too long, or its place is needed.


class Action(Enum):
    """Action of the discoverer that a transition of the life cycle requires."""

    QUERY = auto()  #: Query the agent's description.
    ABANDON = auto()  #: Abandon the outstanding query; a later answer is ignored.
    BACK_OFF = auto()  #: Wait before the next query.
    DISCOVERED = auto()  #: Announce that an agent was seen for the first time.
    UPDATED = auto()  #: Announce that a known agent has another description.
    LOST = auto()  #: Announce that an agent's heartbeats stopped.
    RETURNED = auto()  #: Announce that the same incarnation of a lost agent is back.
    RESTARTED = auto()  #: Announce that an agent is back as another incarnation.
    FORGET = auto()  #: Delete all data about the agent.


ANNOUNCEMENTS = frozenset(
    {Action.DISCOVERED, Action.UPDATED, Action.LOST, Action.RETURNED, Action.RESTARTED}
)
"""Actions that are discovery events. Their names are those of ``AgentDiscoveryEvent``'s constants."""

TRANSITIONS = transitions(
    State,
    Input,
    Action,
    """
    UNKNOWN           HEARD          QUERYING          QUERY

    QUERYING          HEARD          QUERYING
    QUERYING          CHANGED        QUERYING
    QUERYING          RESTARTED      QUERYING          ABANDON QUERY
    QUERYING          ANSWERED       ACTIVE            DISCOVERED
    QUERYING          FAILED         BACKING_OFF       BACK_OFF
    QUERYING          SILENT         UNKNOWN           ABANDON FORGET

    BACKING_OFF       HEARD          BACKING_OFF
    BACKING_OFF       CHANGED        BACKING_OFF
    BACKING_OFF       RESTARTED      QUERYING          QUERY
    BACKING_OFF       RETRY          QUERYING          QUERY
    BACKING_OFF       SILENT         UNKNOWN           FORGET
    BACKING_OFF       EXPIRED        UNKNOWN           FORGET

    ACTIVE            HEARD          ACTIVE
    ACTIVE            CHANGED        REFRESHING        QUERY
    ACTIVE            RESTARTED      REFRESHING        QUERY
    ACTIVE            SILENT         LOST              LOST

    REFRESHING        HEARD          REFRESHING
    REFRESHING        CHANGED        REFRESHING
    REFRESHING        RESTARTED      REFRESHING        ABANDON QUERY
    REFRESHING        ANSWERED       ACTIVE            UPDATED
    REFRESHING        ANSWERED_ANEW  ACTIVE            RESTARTED
    REFRESHING        FAILED         REFRESH_BACK_OFF  BACK_OFF
    REFRESHING        SILENT         LOST              ABANDON LOST

    REFRESH_BACK_OFF  HEARD          REFRESH_BACK_OFF
    REFRESH_BACK_OFF  CHANGED        REFRESH_BACK_OFF
    REFRESH_BACK_OFF  RESTARTED      REFRESHING        QUERY
    REFRESH_BACK_OFF  RETRY          REFRESHING        QUERY
    REFRESH_BACK_OFF  SILENT         LOST              LOST

    LOST              HEARD          ACTIVE            RETURNED
    LOST              CHANGED        REJOINING         QUERY
    LOST              RESTARTED      REJOINING         QUERY
    LOST              EXPIRED        UNKNOWN           FORGET

    REJOINING         HEARD          REJOINING
    REJOINING         CHANGED        REJOINING
    REJOINING         RESTARTED      REJOINING         ABANDON QUERY
    REJOINING         ANSWERED       ACTIVE            RETURNED
    REJOINING         ANSWERED_ANEW  ACTIVE            RESTARTED
    REJOINING         FAILED         REJOIN_BACK_OFF   BACK_OFF
    REJOINING         SILENT         LOST              ABANDON

    REJOIN_BACK_OFF   HEARD          REJOIN_BACK_OFF
    REJOIN_BACK_OFF   CHANGED        REJOIN_BACK_OFF
    REJOIN_BACK_OFF   RESTARTED      REJOINING         QUERY
    REJOIN_BACK_OFF   RETRY          REJOINING         QUERY
    REJOIN_BACK_OFF   SILENT         LOST
    """,
)
"""State, input, next state, and the actions in order; all other inputs are illegal and change nothing.

Heartbeats during a query keep the agent alive, and cause no second query. After a restart, the incarnation that
was queried is gone.
"""

STATED = {
    (State.UNKNOWN, Input.HEARD): "asynchronous ROS 2 service futures ... to track agents",
    (State.QUERYING, Input.HEARD): "prevent redundant metadata queries",
    (State.QUERYING, Input.ANSWERED): "discovering a new agent ... fires agent discovery events",
    (State.ACTIVE, Input.HEARD): "by subscribing to the global heartbeat ... an active cache",
    (State.ACTIVE, Input.SILENT): "timers to track agents ... via discovery events",
}
"""Transitions that the paper states in sections 4.2 and 4.3 and in the caption, with its words."""


class Lifecycle:
    """State of one remote agent. Error messages contain its name."""

    __slots__ = ("_agent", "state")

    def __init__(self, agent: str) -> None:
        self.state = State.UNKNOWN  #: Current state.
        self._agent = agent

    def feed(self, given: Input) -> tuple[Action, ...]:
        """Process an input and return the actions in order.

        Raises:
            IllegalInputError: The table has no transition for this input in the current state.
        """
        self.state, actions = step(f"agent {self._agent!r}", TRANSITIONS, self.state, given)
        return actions
