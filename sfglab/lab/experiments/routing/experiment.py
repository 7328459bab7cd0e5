"""Runs of routing: the policy's checks, then who hears what of whom, and what is seen in the global domain.

Every party publishes and subscribes all names: a router that asked only who wants them would let all cross.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.bus.api import entries
from sfglab.fleet.router.node import RouterConfig
from sfglab.fleet.router.plan import ROUTER_KEY
from sfglab.lab.checks import CheckRow
from sfglab.lab.checks.routing import NEAR_MISSES, in_table_1
from sfglab.lab.checks.routing import checks as policy_checks
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.workers.test_peer import TRANSFORMS, PeerConfig, TopicUse
from sfglab.names import (
    TF,
    TF_STATIC,
    Resource,
    ResourceKind,
    RosFqnBuilder,
    Scope,
    dds_names,
    dds_topic,
)
from sfglab.processes import Member, ProcessGroup
from sfglab.units import NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from sfglab.component import Report
    from sfglab.lab.bench import Bench
    from sfglab.lab.testbed import Testbed

LATE_S = 5.0


# --- The fleet ------------------------------------------------------------------------------------------------

STRING = "std_msgs/msg/String"
DEEP = "/global/deeper/than/the/schema/goes/x"
"""Crosses by ``rt/global/*``, whose ``*`` stands for slashes too."""

GLOBAL_DOMAIN = 0
OTHERS = ("ground_1", "ground_2")
ANSWER_S = 90.0
PATIENCE_S, POLL_S = 15.0, 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class PartyRow:
    """A test peer that publishes and subscribes."""

    party: str  #: Its name.
    domain: int  #: Its DDS domain; 0 is the global one.
    host: str  #: Where it runs.


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """A topic of the experiment."""

    name: str  #: ROS name.
    type: str  #: ROS type.
    publishers: tuple[str, ...]  #: Parties that publish it.
    subscribers: tuple[str, ...]  #: Parties that subscribe it.
    latched: bool = False  #: Published once, transient local.


def topics(agents: Sequence[str], others: Sequence[str], *, busy: int) -> Iterator[Topic]:
    """Yield every topic of a run: of agents behind routers, each with further local ones, and of others."""
    everybody = (*agents, *others)
    yield Topic(name=TF, type=TRANSFORMS, publishers=everybody, subscribers=everybody)
    yield Topic(
        name=TF_STATIC, type=TRANSFORMS, publishers=everybody, subscribers=everybody, latched=True
    )
    for name in (_name(Scope.GLOBAL, None, Resource.MAP), DEEP, *NEAR_MISSES):
        yield Topic(name=name, type=STRING, publishers=everybody, subscribers=everybody)
    for party in everybody:
        for scope in Scope:
            name = _name(scope, party, Resource.STATE)
            yield Topic(name=name, type=STRING, publishers=(party,), subscribers=everybody)
    for agent in agents:
        for number in range(busy):
            name = f"{_name(Scope.LOCAL, agent, Resource.STATUS)}{number}"
            yield Topic(name=name, type=STRING, publishers=(agent,), subscribers=(agent, *others))


def service_names(party: str) -> tuple[str, str, str]:
    """Return the services that a party serves: one that crosses, a local one, and a near miss."""
    crossing, local = (
        _name(scope, party, Resource.GET_METADATA) for scope in (Scope.GLOBAL, Scope.LOCAL)
    )
    return crossing, local, f"/globally/{party}/{Resource.GET_METADATA.value}"


def _name(scope: Scope, party: str | None, resource: Resource) -> str:
    builder = RosFqnBuilder().scope(scope)
    builder = builder.without_agent() if party is None else builder.agent(party)
    return str(builder.resource(resource).build())


def parties_of(agents: int) -> tuple[PartyRow, ...]:
    """Return who takes part: agents in domains of their own, then the others in the global one."""
    behind = [
        PartyRow(party=f"agent_{i}", domain=i, host=f"agent_{i}") for i in range(1, agents + 1)
    ]
    return (*behind, *(PartyRow(party=name, domain=GLOBAL_DOMAIN, host=name) for name in OTHERS))


def _local(party: PartyRow) -> BusAddress:
    return BusAddress(domain_id=party.domain, interface="lo")


class Stage(ProcessGroup):
    """Everybody's processes, each party's on a host of its own."""

    def __init__(self, config: Any, testbed: Testbed) -> None:
        self.parties = parties_of(config.agents)  #: Who takes part.
        self._agents = tuple(p for p in self.parties if p.domain != GLOBAL_DOMAIN)
        #: What they use.
        self.topics = tuple(topics([p.party for p in self._agents], OTHERS, busy=config.busy))
        self._rate_hz, self._testbed = config.rate_hz, testbed
        router, peer = "sfglab.fleet.router.node", "sfglab.lab.workers.test_peer"
        configs = (
            RouterConfig(agent=p.party, local=_local(p), remote=self._global(p))
            for p in self._agents
        )
        routers = (
            Member(
                name=f"router of {config.agent}", host=config.agent, module=router, config=config
            )
            for config in configs
        )
        peers = (
            Member(name=p.party, host=p.host, module=peer, config=self._peer(p))
            for p in self.parties
        )
        super().__init__((*routers, *peers), wrap_command=testbed.argv)

    async def talk(self, seconds: float) -> dict[str, int]:
        """Let everybody talk, and return how many rounds of messages each has sent when all is quiet.

        Goes on beyond the seconds, within limits, until whoever should hear somebody does.
        """
        self.order([p.party for p in self.parties], do="talk")
        await asyncio.sleep(seconds)
        for _ in range(round(PATIENCE_S / POLL_S)):
            if self._all_heard(await self.ask_all("told", do="tell")):
                break
            await asyncio.sleep(POLL_S)
        return {
            party: report["sent"]
            for party, report in (await self.ask_all("hushed", do="hush")).items()
        }

    def _all_heard(self, told: dict[str, dict[str, Any]]) -> bool:
        heard = {
            (p, entry["name"], entry["source"]) for p, r in told.items() for entry in r["heard"]
        }
        return all(
            (hearer, topic.name, source) in heard
            for topic in self.topics
            if in_table_1(dds_topic(topic.name))
            for source in topic.publishers
            for hearer in topic.subscribers
        )

    async def ask_all(self, answer: str, **order: Any) -> dict[str, Report]:
        """Give everybody the same order and return their reports by party."""
        names = [p.party for p in self.parties]
        for name in names:
            self[name].order(**order)
        return await self.expect(answer, names, timeout_s=ANSWER_S)

    def _global(self, party: PartyRow) -> BusAddress:
        return BusAddress(domain_id=GLOBAL_DOMAIN, interface=self._testbed.interface(party.host))

    def _peer(self, party: PartyRow) -> PeerConfig:
        behind = party.domain != GLOBAL_DOMAIN
        uses = tuple(
            TopicUse(
                name=topic.name,
                type=topic.type,
                latched=topic.latched,
                publish=party.party in topic.publishers,
                subscribe=party.party in topic.subscribers,
            )
            for topic in self.topics
            if party.party in (*topic.publishers, *topic.subscribers)
        )
        return PeerConfig(
            party=party.party,
            address=_local(party) if behind else self._global(party),
            behind_router=behind,
            topics=uses,
            serves=service_names(party.party),
            rate_hz=self._rate_hz,
        )


# --- The runs -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    #: Agents behind a router each; two parties in the global domain come in addition.
    agents: int = 3
    seconds: float = 6.0  #: How long everybody talks at least, seconds.
    rate_hz: float = 10.0  #: Messages a second of every party on every topic.
    busy: int = 20  #: Further local topics of every agent.
    random_names: int = 20_000  #: Random DDS names that the policy is asked about.
    call_s: float = 1.0  #: How long a caller waits for a server that it must not reach, seconds.
    seed: int = 0  #: Seed of the random names.


exp = Experiment(
    "routing",
    Config,
    where="A 4.1",
    smoke={"agents": 2, "seconds": 2.5, "busy": 3, "random_names": 500, "call_s": 0.5},
    paper={"agents": 6, "seconds": 20.0, "busy": 50, "random_names": 200_000},
    hosts=lambda config: [party.host for party in parties_of(config.agents)],
    actors=(
        Actor("router", "agent_i", "at the border of D_i and D_0", count="one an agent"),
        Actor(
            "agent", "agent_i", "publishes, subscribes, serves and calls every name", count="2 to 6"
        ),
        Actor("ground", "ground_i", "the same in the global domain", count="2"),
    ),
    links=(
        Link("agent", "router", "all names"),
        Link("router", "agent", "what Table 1 names"),
        Link("router", "ground", "what Table 1 names", boundary="the border"),
        Link("ground", "router", "all names", boundary="the border"),
    ),
)
exp.table("policy")(CheckRow)
exp.table("party")(PartyRow)


@exp.table("heard")
class HeardRow:
    """What one party heard of another under one name."""

    name: str  #: ROS name.
    dds_topic: str  #: The same on the wire.
    source: str  #: Who published.
    hearer: str  #: Who subscribed.
    source_domain: int  #: Where the source is.
    hearer_domain: int  #: Where the hearer is.
    sent: int  #: Messages that the source published.
    received: int  #: Messages that arrived, repeated ones counted again.
    repeated: int  #: Messages that arrived more than once.
    disordered: int  #: Messages that arrived after a later one.
    restamped: int  #: Messages whose source time stamp is not the publisher's.
    missing: int  #: Messages missing between the first and the last that arrived.
    misnamed: int  #: Transforms whose frame does not bear its source's prefix.
    #: Median time from publishing to receiving, milliseconds; NaN when nothing arrived.
    age_ms: float


@exp.table("endpoint")
class EndpointRow:
    """An endpoint that somebody in the global domain saw there and that is no party's own."""

    seen_by: str  #: Who saw it.
    dds_topic: str  #: Its topic on the wire.
    kind: str  #: ``publisher`` or ``subscription``.
    router: str  #: Which pair of domains its router serves; empty when it is no router's.


@exp.table("call")
class CallRow:
    """One call of a service."""

    name: str  #: ROS name.
    caller: str  #: Who called.
    server: str  #: Who serves.
    caller_domain: int  #: Where the caller is.
    server_domain: int  #: Where the server is.
    answered: bool  #: Whether an answer of that server came.


@exp.table("latched")
class LatchedRow:
    """What a party that subscribed static transforms late heard of one that had published them once."""

    source: str  #: Who published.
    hearer: str  #: Who came late.
    received: int  #: Messages that arrived.


@exp.part("policy", timed=False)
def check_policy(bench: Bench[Config]) -> None:
    """Check the policy by itself."""
    bench.write_all("policy", policy_checks.rows(bench.config.random_names, bench.config.seed))


@exp.part("fleet", total=3)
async def observe(bench: Bench[Config]) -> None:
    """Let everybody talk, join late, call, and tell."""
    config = bench.config
    async with Stage(config, bench.testbed) as stage:
        bench.write_all("party", stage.parties)
        sent = await stage.talk(config.seconds)
        bench.advance("talked")
        late = await stage.ask_all("late", do="late", expected=len(stage.parties), timeout_s=LATE_S)
        calls = await _call(stage, config.call_s)
        bench.advance("called")
        told = await stage.ask_all("told", do="tell")
        bench.write_all("call", calls)
        for hearer, report in late.items():
            for name in (party.party for party in stage.parties):
                row = {
                    "source": name,
                    "hearer": hearer,
                    "received": report["received"].get(name, 0),
                }
                bench.write("latched", row)
        bench.write_all("heard", _heard_rows(stage, sent, told))
        bench.write_all("endpoint", _endpoint_rows(stage, told))
        bench.advance("told")


def halves(service: str) -> tuple[str, ...]:
    """Return the names of a service's request and reply on the wire."""
    return dds_names(service, ResourceKind.SERVICE)


def may_cross(service: str) -> bool:
    """Return whether Table 1 names both halves of a service."""
    return all(map(in_table_1, halves(service)))


async def _call(stage: Stage, call_s: float) -> list[dict[str, Any]]:
    """Let everybody call everybody else's services: first those that must answer, however late."""
    servers = {name: party for party in stage.parties for name in service_names(party.party)}
    answers: dict[str, dict[str, str]] = {party.party: {} for party in stage.parties}
    for must, timeout_s in ((True, ANSWER_S / 2), (False, call_s)):
        names = [name for name in servers if may_cross(name) is must]
        reports = await stage.ask_all("called", do="call", names=names, timeout_s=timeout_s)
        for caller, report in reports.items():
            answers[caller] |= zip(names, report["answers"], strict=True)
    return [
        {
            "name": name,
            "caller": caller.party,
            "server": server.party,
            "caller_domain": caller.domain,
            "server_domain": server.domain,
            "answered": answers[caller.party][name] == server.party,
        }
        for caller in stage.parties
        for name, server in servers.items()
        if caller != server
    ]


def _heard_rows(
    stage: Stage, sent: dict[str, int], told: dict[str, Report]
) -> Iterator[dict[str, Any]]:
    parties = {party.party: party for party in stage.parties}
    heard = {
        (p, entry["name"], entry["source"]): entry for p, r in told.items() for entry in r["heard"]
    }
    for topic in stage.topics:
        for source in topic.publishers:
            for hearer in topic.subscribers:
                entry = heard.get((hearer, topic.name, source), {})
                count = 1 if topic.latched else sent[source]
                yield _heard_row(topic.name, parties[source], parties[hearer], count, entry)


def _heard_row(
    name: str, source: PartyRow, hearer: PartyRow, sent: int, entry: Report
) -> dict[str, Any]:
    age_ns = entry.get("age_ns")
    counts = ("received", "repeated", "disordered", "restamped", "missing", "misnamed")
    return {
        "name": name,
        "dds_topic": dds_topic(name),
        "source": source.party,
        "hearer": hearer.party,
        "source_domain": source.domain,
        "hearer_domain": hearer.domain,
        "sent": sent,
        "age_ms": float("nan") if age_ns is None else age_ns / NS_PER_MS,
        **{key: entry.get(key, 0) for key in counts},
    }


def _endpoint_rows(stage: Stage, told: dict[str, Report]) -> Iterator[dict[str, Any]]:
    """Yield what parties in the global domain saw there beside each other's endpoints."""
    others = [party.party for party in stage.parties if party.domain == GLOBAL_DOMAIN]
    own = {told[party]["participant"] for party in others}
    for party in others:
        for dds, kind, owner, tag in told[party]["endpoints"]:
            if owner not in own:
                router = entries(tag.encode()).get(ROUTER_KEY, "")
                yield {"seen_by": party, "dds_topic": dds, "kind": kind, "router": router}
