"""Configuration and tables of the experiment on heartbeats and the life cycle of remote agents."""

from __future__ import annotations

from dataclasses import dataclass, field

from sfglab.fleet.discovery.config import Timing
from sfglab.fleet.status.heartbeat import Schedule
from sfglab.lab.bench import TableRow
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.units import NS_PER_S

ROBOT, STATION = "robot", "station"
"""The two hosts. The station is also the agent whose discoverer is led through its table."""


def timing(backoff_s: float) -> Timing:
    """Return short waits of a discoverer; `backoff_s` is the first wait after a failed query, s."""
    return Timing(
        slack_ns=300_000_000,
        backoff_ns=round(backoff_s * NS_PER_S),
        backoff_max_ns=2 * round(backoff_s * NS_PER_S),
        # Longer than the process of a lost agent takes to start again.
        forget_ns=3 * NS_PER_S,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """Agents, periods and waits of the run."""

    #: Number of status providers whose heartbeats are timed, each behind a router, as in the paper.
    #: Transitions are run without routers.
    agents: int = 3
    #: Periods of the heartbeats: the paper's except in ``smoke``. The paper does not state the
    #: duration of the start-up phase; the default is shorter than the status provider's.
    schedule: Schedule = field(default_factory=lambda: Schedule(startup_s=5.0))
    steady_beats: int = 3  #: Number of intervals in the steady state that are timed per agent.
    #: Largest deviation of a median period from the announced or stated one, relative to it.
    tolerance: float = 0.05
    walker_period_s: float = 0.5  #: Period of the agent that is stopped and killed, s.
    #: Waits of the discoverer that is led through its table: short, so that the run takes seconds.
    timing: Timing = field(default_factory=lambda: timing(1.0))
    query_timeout_s: float = 1.0  #: Time limit of its queries, s.
    #: Number of attempts at a transition that was missed, as happens on a machine that stalls.
    attempts: int = 3
    seed: int = 0  #: Without effect; nothing is random.


exp = Experiment(
    "lifecycle",
    Config,
    where="A 4.2",
    smoke={
        "agents": 2,
        "schedule": Schedule(startup_period_s=0.1, steady_period_s=0.5, startup_s=0.5),
        "tolerance": 0.2,
        "walker_period_s": 0.3,
        "timing": timing(0.6),
        "query_timeout_s": 0.6,
    },
    paper={"agents": 6, "schedule": Schedule(), "steady_beats": 24, "walker_period_s": 1.0},
    hosts=(ROBOT, STATION),
    actors=(
        Actor(
            "status provider", ROBOT, "sends heartbeats, serves its metadata", count="agents + 1"
        ),
        Actor("router", ROBOT, "joins the agent's domain with the global one", count="agents"),
        Actor("made-up agents", ROBOT, "send heartbeats and answer as ordered, or do not"),
        Actor("discoverer", STATION, "follows its table"),
        Actor("listener", STATION, "records heartbeats and events", count="2, one joins late"),
    ),
    links=(
        Link("status provider", "router", "heartbeats, metadata"),
        Link("router", "listener", "heartbeats, metadata", boundary="domain, network"),
        Link("listener", "router", "metadata calls", boundary="domain, network"),
        Link("router", "status provider", "metadata calls"),
        Link("status provider", "discoverer", "heartbeats, metadata", boundary="network"),
        Link("discoverer", "status provider", "metadata calls", boundary="network"),
        Link("made-up agents", "discoverer", "heartbeats, metadata", boundary="network"),
        Link("discoverer", "made-up agents", "metadata calls", boundary="network"),
        Link("discoverer", "listener", "discovery events"),
    ),
    removed={"routed": {"quick": True, "paper": True}},
)


@exp.table("beat")
class BeatRow(TableRow):
    """A heartbeat as a listener on another host received it."""

    listener: str  #: ``first``, or ``late`` for the one that joined in the steady state.
    agent: str  #: Agent that sent it.
    incarnation: int  #: Start of the agent.
    phase: int  #: 0 start-up, 1 steady state.
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
    incarnation: int  #: Start of the agent that the answer describes.
    took_s: float  #: Time from the call to the answer, discovery of the service included, s.


@exp.table("move")
class MoveRow(TableRow):
    """A transition that a discoverer took."""

    agent: str  #: Remote agent.
    before: str  #: State before.
    given: str  #: Input.
    after: str  #: State after.
    actions: str  #: Actions, joined by ``;``.
    t_ns: int  #: Time, ns since the epoch.


@exp.table("query")
class QueryRow(TableRow):
    """A query that arrived at an agent that does not run."""

    agent: str  #: Agent that was queried.
    t_ns: int  #: Time of arrival, ns since the epoch.
