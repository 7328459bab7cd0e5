"""Runs of the life cycle: paper A, section 4.2, at three lengths; heartbeats first, then every transition."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.fleet.discovery.config import DiscoveryConfig, DiscoverySettings, Timing
from sfglab.fleet.discovery.listener import DISCOVERY_EVENT, discovery_topic
from sfglab.fleet.discovery.validation import Limits
from sfglab.fleet.router.config import RouterConfig
from sfglab.fleet.status.config import StatusConfig, StatusSettings
from sfglab.fleet.status.heartbeat import (
    AGENT_HEARTBEAT,
    Schedule,
    heartbeat_topic,
    metadata_service,
)
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.experiments.lifecycle.stage import (
    FAKES,
    STEP_S,
    WALKER,
    Stage,
    crowd,
    puppet_show,
    walk,
)
from sfglab.lab.workers.false_agents import FakeConfig
from sfglab.lab.workers.wire import WireConfig
from sfglab.processes import Member
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.lab.bench import Bench

ROBOT, STATION, GATE = "robot", "station", "gate"
PLACES = 3

GLOBAL_DOMAIN = 0
LOOPBACK_DOMAIN = 93
"""Stands for the global domain where all hosts are one, and other runs may be using domain 0."""
FIRST_LOCAL_DOMAIN = 94
"""The domain of the first agent behind a router; on the loopback interface of its host."""


def _timing(backoff_s: float) -> Timing:
    backoff = {
        "backoff_ns": round(backoff_s * NS_PER_S),
        "backoff_max_ns": 2 * round(backoff_s * NS_PER_S),
    }
    # A lost agent must be remembered for longer than its process takes to start again.
    return Timing(slack_ns=300_000_000, forget_ns=3 * NS_PER_S, **backoff)


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    agents: int = 3  #: Status providers whose heartbeats are timed.
    #: Whether each of them is in a domain of its own behind a router, as the paper has it, so that what is
    #: timed has crossed its agent's border; else they are in the global domain themselves. The transitions are
    #: always run there, without routers in between.
    routed: bool = True
    #: Their schedule. The periods are the paper's in every profile but ``smoke``; the length of the start-up
    #: phase, which the paper does not state, is shortened.
    schedule: Schedule = field(default_factory=lambda: Schedule(startup_s=5.0))
    steady_beats: int = 3  #: Heartbeats in the steady state that are waited for, per agent.
    #: How far a median period may be from the one announced or stated, relative to it.
    tolerance: float = 0.05
    #: Period of the status process that is stopped and killed, seconds.
    walker_period_s: float = 0.5
    #: The discoverer's waits while it is led through its transitions: short, so that all of them fit into
    #: seconds.
    timing: Timing = field(default_factory=lambda: _timing(1.0))
    query_timeout_s: float = 1.0  #: Its time limit for answers, seconds.
    #: How often the false agents try a transition that was missed, as on a machine that stalls.
    attempts: int = 3
    seed: int = 0  #: Kept for the record; nothing is drawn.

    @property
    def at_paper_periods(self) -> bool:
        """Whether heartbeats come at the paper's 1 s and 5 s."""
        paper = Schedule()
        mine = (self.schedule.startup_period_s, self.schedule.steady_period_s)
        return mine == (paper.startup_period_s, paper.steady_period_s)


exp = Experiment(
    "lifecycle",
    Config,
    where="A 4.2",
    smoke={
        "agents": 2,
        "routed": False,
        "schedule": Schedule(startup_period_s=0.1, steady_period_s=0.5, startup_s=0.5),
        "tolerance": 0.2,
        "walker_period_s": 0.3,
        "timing": _timing(0.6),
        "query_timeout_s": 0.6,
    },
    paper={"agents": 6, "schedule": Schedule(), "steady_beats": 24, "walker_period_s": 1.0},
    hosts=(ROBOT, STATION),
    actors=(
        Actor(
            "status provider",
            ROBOT,
            "beats, answers for its description",
            count="agents; one killed",
        ),
        Actor("router", ROBOT, "own domain to the global one", count="agents, where routed"),
        Actor("false agents", ROBOT, "beat and answer as told, or not at all"),
        Actor("discoverer", STATION, "follows its table", count="2, one after the other"),
        Actor("listener", STATION, "notes what is on the wire", count="2: first, late"),
    ),
    links=(
        Link("status provider", "router", "heartbeats, metadata"),
        Link("router", "listener", "heartbeats, metadata", boundary="border, network"),
        Link("listener", "router", "metadata calls", boundary="border, network"),
        Link("router", "status provider", "metadata calls"),
        Link("status provider", "discoverer", "heartbeats, metadata", boundary="network"),
        Link("status provider", "listener", "heartbeats", boundary="network"),
        Link("discoverer", "status provider", "metadata calls", boundary="network"),
        Link("false agents", "discoverer", "heartbeats, metadata", boundary="network"),
        Link("false agents", "listener", "heartbeats", boundary="network"),
        Link("discoverer", "false agents", "metadata calls", boundary="network"),
        Link("discoverer", "listener", "discovery events"),
    ),
)


@exp.table("beat")
class BeatRow:
    """A heartbeat as a listener on another host heard it."""

    listener: str  #: ``first``, or ``late`` for the one that joined in the steady state.
    agent: str  #: Who sent it.
    incarnation: int  #: Which start of the agent.
    revision: int  #: Which revision of its description.
    phase: int  #: 0 start-up, 1 steady.
    period_s: float  #: The time that it announces until the next one, seconds.
    sent_ns: int  #: When it was published, nanoseconds since the epoch.
    received_ns: int  #: When the listener took it.
    gid: str  #: The publisher's GUID, hexadecimal.


@exp.table("join")
class JoinRow:
    """A listener that joined the domain."""

    listener: str  #: Which one.
    t_ns: int  #: When it made its subscription, nanoseconds since the epoch.


@exp.table("endpoint")
class WireEndpointRow:
    """A publisher of heartbeats as the listener's graph showed it."""

    topic: str  #: ROS topic.
    type: str  #: ROS type.
    reliability: str  #: What is offered.
    durability: str  #: What is offered.
    gid: str  #: Its GUID, hexadecimal.


@exp.table("answer")
class AnswerRow:
    """A call of an agent's metadata service from another host."""

    agent: str  #: Who was asked.
    service: str  #: Under which name.
    answered: bool  #: Whether an answer came.
    incarnation: int  #: Which start of the agent it describes.
    took_s: float  #: From the call to the answer, finding the service included, seconds.


@exp.table("move")
class MoveRow:
    """A transition that a discoverer took."""

    discoverer: str  #: The agent that it belongs to.
    agent: str  #: The remote agent.
    before: str  #: State before.
    given: str  #: Input.
    after: str  #: State after.
    actions: str  #: What was done, joined by ``;``.
    t_ns: int  #: When, nanoseconds since the epoch.


@exp.table("query")
class QueryRow:
    """A query that arrived at a false agent."""

    agent: str  #: Who was asked.
    t_ns: int  #: When it arrived, nanoseconds since the epoch.


@exp.table("fault")
class FaultRow:
    """Something that was done to provoke a transition."""

    agent: str  #: To whom.
    what: str  #: What was done.
    t_ns: int  #: When, nanoseconds since the epoch.


@exp.table("count")
class CountRow:
    """One of a discoverer's counters at the end."""

    discoverer: str  #: The agent that it belongs to.
    name: str  #: The counter.
    count: int  #: Its value.


def _address(bench: Bench[Config], host: str) -> BusAddress:
    """Return where on the bus a host stands: in the domain that all share."""
    domain_id = GLOBAL_DOMAIN if bench.testbed.separate else LOOPBACK_DOMAIN
    return BusAddress(domain_id=domain_id, interface=bench.testbed.interface(host))


def _listener(bench: Bench[Config], name: str, topics: dict[str, str]) -> Member:
    config = WireConfig(address=_address(bench, STATION), topics=topics)
    return Member(name=name, host=STATION, module="sfglab.lab.workers.wire", config=config)


def _status(agent: str, schedule: Schedule, address: BusAddress) -> Member:
    # Descriptions are queried over the paper's metadata service, as Fig. 3 has it.
    settings = StatusSettings(agent=agent, schedule=schedule, publish_description=False)
    config = StatusConfig(address=address, settings=settings, detect=False)
    return Member(name=agent, host=ROBOT, module="sfglab.fleet.status.node", config=config)


def _discovering(
    bench: Bench[Config], own: str, topics: dict[str, str], limits: Limits
) -> tuple[Member, ...]:
    """Return the discoverer of agent `own`, false agents to discover, and a listener to topics."""
    timing, timeout_s = bench.config.timing, bench.config.query_timeout_s
    waits: dict[str, Any] = {"timing": timing, "limits": limits, "query_timeout_s": timeout_s}
    settings = DiscoverySettings(
        agent=own, max_queries=32, use_published_descriptions=False, **waits
    )
    config = DiscoveryConfig(address=_address(bench, STATION), settings=settings, report_moves=True)
    fakes = FakeConfig(address=_address(bench, ROBOT), late_s=1.5 * timeout_s)
    return (
        _listener(bench, "first", topics),
        Member(name=own, host=STATION, module="sfglab.fleet.discovery.node", config=config),
        Member(name=FAKES, host=ROBOT, module="sfglab.lab.workers.false_agents", config=fakes),
    )


# What is done with it. Processes of one part are gone before the next, and with them what they had latched.


@exp.part("heartbeats", total=2)
async def time_heartbeats(bench: Bench[Config]) -> None:
    """Let agents beat, and listen from the start and from the middle on."""
    config = bench.config
    agents = [f"robot{number + 1}" for number in range(config.agents)]
    local = {
        a: BusAddress(domain_id=FIRST_LOCAL_DOMAIN + n, interface="lo")
        for n, a in enumerate(agents)
    }
    topics = {heartbeat_topic(): AGENT_HEARTBEAT}
    async with Stage(
        bench, *(_listener(bench, name, topics) for name in ("first", "late"))
    ) as stage:
        if config.routed:
            remote, module = _address(bench, ROBOT), "sfglab.fleet.router.node"
            routers = [RouterConfig(agent=a, local=local[a], remote=remote) for a in agents]
            start = [
                Member(name=f"router of {r.agent}", host=ROBOT, module=module, config=r)
                for r in routers
            ]
            await stage.start(*start)
        where = local if config.routed else dict.fromkeys(agents, _address(bench, ROBOT))
        await stage.start(*(_status(agent, config.schedule, where[agent]) for agent in agents))
        bench.advance("start-up")
        await _beats(stage, config, agents, 2)
        # Somewhere between two heartbeats: what is heard at once then is the last one, not the next.
        await asyncio.sleep(0.3 * config.schedule.steady_period_s)
        await stage.join("late")
        for agent in agents:
            await stage.ask_metadata(agent, metadata_service(agent))
        await stage.ask("looked", ["first"], timeout_s=STEP_S, do="look")
        bench.advance("steady state")
        await _beats(stage, config, agents, config.steady_beats + 1)


async def _beats(stage: Stage, config: Config, agents: list[str], steady: int) -> None:
    """Return when every agent has beaten so many times in the steady state."""
    schedule = config.schedule
    limit_s = 20 + schedule.startup_s + (steady + 1) * schedule.steady_period_s
    what = f"{steady} heartbeats in the steady state"
    await stage.until(
        what, lambda: all(stage.steady[agent] >= steady for agent in agents), timeout_s=limit_s
    )


@exp.part("transitions")
async def lead_discoverer(bench: Bench[Config]) -> None:
    """Lead a discoverer through its table, with a real status process and with false agents."""
    period_s = bench.config.walker_period_s
    pace = Schedule(startup_period_s=period_s, steady_period_s=period_s, startup_s=0)
    topics = {heartbeat_topic(): AGENT_HEARTBEAT, discovery_topic(STATION): DISCOVERY_EVENT}
    async with Stage(bench, *_discovering(bench, STATION, topics, Limits())) as stage:
        walker = _status(WALKER, pace, _address(bench, ROBOT))
        await stage.together(
            walk(walker, stage), puppet_show(stage, attempts=bench.config.attempts)
        )
        await stage.count(STATION, "answered")


@exp.part("crowd")
async def crowd_discoverer(bench: Bench[Config]) -> None:
    """Send a discoverer with few places more agents than it can hold."""
    topics = {discovery_topic(GATE): DISCOVERY_EVENT}
    async with Stage(bench, *_discovering(bench, GATE, topics, Limits(max_agents=PLACES))) as stage:
        await crowd(GATE, stage, places=PLACES)
        await stage.count(GATE, "dropped_flood")
