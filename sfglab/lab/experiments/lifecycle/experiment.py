"""Configuration and tables of the experiment on heartbeats and the life cycle of remote agents."""

from __future__ import annotations

from dataclasses import dataclass, field

from sfglab.fleet.status.heartbeat import Schedule
from sfglab.lab.bench import TableRow
from sfglab.lab.experiment import Experiment, Profiled

ROBOT, STATION = "robot", "station"
"""The two hosts. The station is also the agent whose discoverer is led through its table."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """Agents and periods of the run."""

    #: Number of status providers whose heartbeats are timed, each behind a router, as in the paper.
    #: Transitions are run without routers.
    agents: int = 3
    #: Periods of the heartbeats: the paper's except in ``smoke``. The paper does not state the
    #: duration of the start-up phase; the default is shorter than the status provider's.
    schedule: Schedule = field(default_factory=lambda: Schedule(startup_s=5.0))
    steady_beats: int = 3  #: Number of intervals in the steady state that are timed per agent.
    #: Largest deviation of a median period from the announced or stated one, relative to it.
    tolerance: float = 0.05
    seed: int = 0  #: Without effect; nothing is random.


exp = Experiment(
    "lifecycle",
    Config,
    where="A 4.2",
    smoke={
        "agents": 2,
        "schedule": Schedule(startup_period_s=0.1, steady_period_s=0.5, startup_s=0.5),
        "tolerance": 0.2,
    },
    paper={"agents": 6, "schedule": Schedule(), "steady_beats": 24},
    hosts=(ROBOT, STATION),
)


@exp.table("beat")
class BeatRow(TableRow):
    """A heartbeat as a listener on another host received it."""

    listener: str  #: ``first``, or ``late`` for the one that joined in the steady state.
    agent: str  #: Agent that sent the heartbeat.
    incarnation: int  #: Start time of the agent (incarnation), ns.
    phase: int  #: Phase: 0 for the startup, 1 for the steady state.
    period_s: float  #: Announced time until the next heartbeat, s.
    sent_ns: int  #: Time of publication, ns since the epoch.
    received_ns: int  #: Time of receipt, ns since the epoch.


@exp.table("join")
class JoinRow(TableRow):
    """A listener that joined the domain."""

    listener: str  #: Name of the listener.
    t_ns: int  #: Time of its subscription, ns since the epoch.


@exp.table("endpoint")
class WireEndpointRow(TableRow):
    """A publisher of heartbeats in the listener's graph."""

    topic: str  #: ROS topic.
    type: str  #: ROS type.
    reliability: str  #: Offered reliability.
    durability: str  #: Offered durability.


@exp.table("answer")
class AnswerRow(TableRow):
    """A call of an agent's metadata service from another host."""

    agent: str  #: Agent that was called.
    service: str  #: Name of the service.
    answered: bool  #: Whether an answer came.
    incarnation: int  #: Start time of the agent (incarnation) in the answer, ns.
    took_s: float  #: Time from the call to the answer, discovery of the service included, s.


@exp.table("move")
class MoveRow(TableRow):
    """A transition that a discoverer took."""

    agent: str  #: Remote agent.
    before: str  #: State before the transition.
    given: str  #: Input of the transition.
    after: str  #: State after the transition.
    actions: str  #: Actions, joined by ``;``.
    t_ns: int  #: Time, ns since the epoch.


@exp.table("query")
class QueryRow(TableRow):
    """A query that arrived at a simulated agent."""

    agent: str  #: Agent that was queried.
    t_ns: int  #: Time of arrival, ns since the epoch.
