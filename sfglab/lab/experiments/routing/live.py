"""Live part of routing: agents behind routers and two parties in the global domain use all names."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.bus.api import entries
from sfglab.fleet.router.config import RouterConfig
from sfglab.fleet.router.plan import ROUTER_KEY
from sfglab.lab.checks.routing import NEAR_MISSES, in_table_1
from sfglab.lab.experiments.routing.experiment import (
    GLOBAL_DOMAIN,
    OTHERS,
    CallRow,
    Config,
    EndpointRow,
    HeardRow,
    PartyRow,
    exp,
    may_cross,
    parties_of,
)
from sfglab.lab.workers.peer import TRANSFORMS, PeerConfig, TopicUse
from sfglab.names import TF, TF_STATIC, Resource, RosFqnBuilder, Scope, dds_topic
from sfglab.processes import Member, ProcessGroup

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from sfglab.component import Report
    from sfglab.lab.bench import Bench
    from sfglab.lab.testbed import Testbed

STRING = "std_msgs/msg/String"
DEEP = "/global/deeper/than/the/schema/goes/x"
"""Crosses by ``rt/global/*``, whose ``*`` stands for slashes too."""
ANSWER_S = 90.0  #: Longest time until a report comes.
PATIENCE_S = 15.0  #: Longest wait for messages that may cross, s.
POLL_S = 0.5  #: Time between two looks at what was heard.
_ROUTER = "sfglab.fleet.router.node"
_PEER = "sfglab.lab.workers.peer"


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """A topic of the experiment."""

    name: str  #: ROS name.
    type: str  #: ROS type.
    publishers: tuple[str, ...]  #: Parties that publish it.
    subscribers: tuple[str, ...]  #: Parties that subscribe it.
    latched: bool = False  #: Published once, transient local.

    def passages(self) -> Iterator[tuple[str, str, str]]:
        """Yield its subscribers with its name and each publisher."""
        for source, hearer in product(self.publishers, self.subscribers):
            yield hearer, self.name, source


def topics(agents: Sequence[str], others: Sequence[str], *, busy: int) -> Iterator[Topic]:
    """Yield every topic of a run; each agent has ``busy`` further local ones."""
    parties = (*agents, *others)
    every: dict[str, Any] = {"publishers": parties, "subscribers": parties}
    yield Topic(name=TF, type=TRANSFORMS, **every)
    yield Topic(name=TF_STATIC, type=TRANSFORMS, latched=True, **every)
    for name in (name_of(Scope.GLOBAL, None, Resource.MAP), DEEP, *NEAR_MISSES):
        yield Topic(name=name, type=STRING, **every)
    for party in parties:
        for scope in Scope:
            name = name_of(scope, party, Resource.STATE)
            yield Topic(name=name, type=STRING, publishers=(party,), subscribers=parties)
    for agent in agents:
        for number in range(busy):
            name = f"{name_of(Scope.LOCAL, agent, Resource.STATUS)}{number}"
            subscribers = (agent, *others)
            yield Topic(name=name, type=STRING, publishers=(agent,), subscribers=subscribers)


def service_names(party: str) -> tuple[str, str, str]:
    """Return the services that a party serves: one that crosses, a local one, and a near miss."""
    crossing = name_of(Scope.GLOBAL, party, Resource.GET_METADATA)
    local = name_of(Scope.LOCAL, party, Resource.GET_METADATA)
    return crossing, local, f"/globally/{party}/{Resource.GET_METADATA.value}"


def name_of(scope: Scope, party: str | None, resource: Resource) -> str:
    """Return a name of the schema; None: without an agent."""
    builder = RosFqnBuilder().scope(scope)
    builder = builder.without_agent() if party is None else builder.agent(party)
    return str(builder.resource(resource).build())


class Fleet(ProcessGroup):
    """The processes of all parties, each party on a host of its own."""

    def __init__(self, config: Config, testbed: Testbed) -> None:
        self.parties = parties_of(config.agents)  #: All parties.
        agents = [party.party for party in self.parties if party.domain != GLOBAL_DOMAIN]
        self.topics = tuple(topics(agents, OTHERS, busy=config.busy))  #: Topics of all parties.
        routers = []
        peers = []
        for party in self.parties:
            interface = testbed.interface(party.party)
            own = shared = BusAddress(domain_id=GLOBAL_DOMAIN, interface=interface)
            if party.party in agents:
                own = BusAddress(domain_id=party.domain, interface="lo")
                router = RouterConfig(agent=party.party, local=own, remote=shared)
                name = f"router of {party.party}"
                routers.append(Member(name=name, host=party.party, module=_ROUTER, config=router))
            peer = PeerConfig(
                name=party.party,
                address=own,
                behind_router=party.party in agents,
                topics=tuple(self._uses(party.party)),
                serves=service_names(party.party),
                rate_hz=config.rate_hz,
            )
            peers.append(Member(name=party.party, host=party.party, module=_PEER, config=peer))
        super().__init__((*routers, *peers), wrap_command=testbed.argv)

    def _uses(self, party: str) -> Iterator[TopicUse]:
        for topic in self.topics:
            publish, subscribe = party in topic.publishers, party in topic.subscribers
            if publish or subscribe:
                yield TopicUse(
                    name=topic.name,
                    type=topic.type,
                    latched=topic.latched,
                    publish=publish,
                    subscribe=subscribe,
                )

    async def ask_all(self, answer: str, **order: Any) -> dict[str, Report]:
        """Give all parties the same order and return their reports by party."""
        names = [party.party for party in self.parties]
        for name in names:
            self[name].order(**order)
        return await self.expect(answer, names, timeout_s=ANSWER_S)

    async def talk(self, seconds: float) -> dict[str, int]:
        """Let all publish, and return the number of messages that each has sent per topic.

        All go on beyond the seconds, within a limit, until each message that may cross was heard.
        """
        self.order([party.party for party in self.parties], do="talk")
        await asyncio.sleep(seconds)
        for _ in range(round(PATIENCE_S / POLL_S)):
            if self._is_all_heard(await self.ask_all("told", do="tell")):
                break
            await asyncio.sleep(POLL_S)
        reports = await self.ask_all("hushed", do="hush")
        return {party: report["sent"] for party, report in reports.items()}

    def _is_all_heard(self, told: dict[str, Report]) -> bool:
        crossing = [topic for topic in self.topics if in_table_1(dds_topic(topic.name))]
        wanted = {key for topic in crossing for key in topic.passages()}
        return wanted <= messages_heard(told).keys()


def messages_heard(told: dict[str, Report]) -> dict[tuple[str, str, str], int]:
    """Return how many messages parties report to have heard, by hearer, ROS name and source."""
    found = {}
    for hearer, report in told.items():
        for entry in report["heard"]:
            found[hearer, entry["name"], entry["source"]] = entry["received"]
    return found


@exp.part("fleet", total=3)
async def observe(bench: Bench[Config]) -> None:
    """Let all parties publish, subscribe, call services, and report what they heard."""
    config = bench.config
    async with Fleet(config, bench.testbed) as fleet:
        bench.write_all("party", fleet.parties)
        sent = await fleet.talk(config.seconds)
        bench.advance("talked")
        bench.write_all("call", await call_all(fleet, config.call_s))
        bench.advance("called")
        told = await fleet.ask_all("told", do="tell")
        bench.write_all("heard", heard_rows(fleet, sent, told))
        bench.write_all("endpoint", endpoint_rows(fleet.parties, told))
        bench.advance("told")


async def call_all(fleet: Fleet, call_s: float) -> list[CallRow]:
    """Let all parties call all services; return one row for each caller and each service of another party.

    Services that must answer come first, and may take long.
    """
    servers = {name: party for party in fleet.parties for name in service_names(party.party)}
    rows = []
    for must_answer, timeout_s in ((True, ANSWER_S / 2), (False, call_s)):
        names = [name for name in servers if may_cross(name) is must_answer]
        reports = await fleet.ask_all("called", do="call", names=names, timeout_s=timeout_s)
        for caller, name in product(fleet.parties, names):
            server = servers[name]
            if caller == server:
                continue
            answer = reports[caller.party]["answers"][names.index(name)]
            row = CallRow(
                name=name,
                caller=caller.party,
                server=server.party,
                caller_domain=caller.domain,
                server_domain=server.domain,
                answered=answer["message"] == server.party,
            )
            rows.append(row)
    return rows


def heard_rows(fleet: Fleet, sent: dict[str, int], told: dict[str, Report]) -> Iterator[HeardRow]:
    """Yield one row per topic, publisher and subscriber."""
    domains = {party.party: party.domain for party in fleet.parties}
    heard = messages_heard(told)
    for topic in fleet.topics:
        for hearer, name, source in topic.passages():
            yield HeardRow(
                name=name,
                dds_topic=dds_topic(name),
                source=source,
                hearer=hearer,
                source_domain=domains[source],
                hearer_domain=domains[hearer],
                sent=1 if topic.latched else sent[source],
                received=heard.get((hearer, name, source), 0),
            )


def endpoint_rows(parties: Sequence[PartyRow], told: dict[str, Report]) -> Iterator[EndpointRow]:
    """Yield endpoints that parties in the global domain discovered beside their own."""
    others = [party.party for party in parties if party.domain == GLOBAL_DOMAIN]
    own = {told[party]["participant"] for party in others}
    for party in others:
        for dds, kind, owner, tag in dict.fromkeys(map(tuple, told[party]["endpoints"])):
            if owner not in own:
                router = entries(tag.encode()).get(ROUTER_KEY, "")
                yield EndpointRow(seen_by=party, dds_topic=dds, kind=kind, router=router)
