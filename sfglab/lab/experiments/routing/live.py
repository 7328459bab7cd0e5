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
    domains_of,
    exp,
    may_cross,
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
"""Topic that the rule ``rt/global/*`` forwards, because ``*`` also stands for slashes."""
ANSWER_S = 90.0  #: Longest time until a report comes.
PATIENCE_S = 15.0  #: Longest wait for messages that may cross, s.
POLL_S = 0.5  #: Time between two checks of the received messages, s.
_ROUTER = "sfglab.fleet.router.node"
_PEER = "sfglab.lab.workers.peer"


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """A topic of the experiment, to which all parties subscribe."""

    name: str  #: ROS name.
    publishers: Sequence[str]  #: Parties that publish it.
    type: str = STRING  #: ROS type.
    latched: bool = False  #: Whether one message is published, with TRANSIENT_LOCAL durability.


def topics(parties: Sequence[str]) -> Iterator[Topic]:
    """Yield every topic of a run."""
    yield Topic(name=TF, type=TRANSFORMS, publishers=parties)
    yield Topic(name=TF_STATIC, type=TRANSFORMS, publishers=parties, latched=True)
    for name in (name_of(Scope.GLOBAL, None, Resource.MAP), DEEP, *NEAR_MISSES):
        yield Topic(name=name, publishers=parties)
    for party, scope in product(parties, Scope):
        yield Topic(name=name_of(scope, party, Resource.STATE), publishers=(party,))


def service_names(party: str) -> tuple[str, str, str]:
    """Return the services of a party: one that routers forward, a local one, and a near miss of the former."""
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
        self.domains = domains_of(config.agents)  #: Domains of all parties.
        self.topics = tuple(topics([*self.domains]))  #: Topics of all parties.
        routers = []
        peers = []
        for party, domain in self.domains.items():
            interface = testbed.interface(party)
            own = shared = BusAddress(domain_id=GLOBAL_DOMAIN, interface=interface)
            if domain != GLOBAL_DOMAIN:
                own = BusAddress(domain_id=domain, interface="lo")
                router = RouterConfig(agent=party, local=own, remote=shared)
                name = f"router of {party}"
                routers.append(Member(name=name, host=party, module=_ROUTER, config=router))
            uses = [
                TopicUse(
                    name=topic.name,
                    type=topic.type,
                    latched=topic.latched,
                    publish=party in topic.publishers,
                )
                for topic in self.topics
            ]
            peer = PeerConfig(
                name=party,
                address=own,
                behind_router=domain != GLOBAL_DOMAIN,
                topics=tuple(uses),
                serves=service_names(party),
                rate_hz=config.rate_hz,
            )
            peers.append(Member(name=party, host=party, module=_PEER, config=peer))
        super().__init__((*routers, *peers), wrap_command=testbed.argv)

    def passages(self) -> Iterator[tuple[Topic, str, str]]:
        """Yield each topic with each publisher and each subscriber."""
        for topic in self.topics:
            for source, hearer in product(topic.publishers, self.domains):
                yield topic, source, hearer

    async def ask_all(self, answer: str, **order: Any) -> dict[str, Report]:
        """Send all parties the same order, and return their reports of the kind `answer` by party."""
        for party in self.domains:
            self[party].order(**order)  # an order to call has a field that is called names
        return await self.expect(answer, self.domains, timeout_s=ANSWER_S)

    async def talk(self, seconds: float) -> dict[str, int]:
        """Let all parties publish, and return the number of messages that each has sent per topic.

        After `seconds`, the parties continue within a limit until messages have arrived on all topics that routers
        forward.
        """
        self.order(self.domains, do="talk")
        await asyncio.sleep(seconds)
        crossing = {
            (hearer, topic.name, source)
            for topic, source, hearer in self.passages()
            if in_table_1(dds_topic(topic.name))
        }
        for _ in range(round(PATIENCE_S / POLL_S)):
            heard = messages_heard(await self.ask_all("told", do="tell"))
            if crossing <= heard.keys():
                break
            await asyncio.sleep(POLL_S)
        reports = await self.ask_all("hushed", do="hush")
        return {party: report["sent"] for party, report in reports.items()}


def messages_heard(told: dict[str, Report]) -> dict[tuple[str, str, str], int]:
    """Return the number of messages that the parties report, by receiver, ROS name and source."""
    found = {}
    for hearer, report in told.items():
        for entry in report["heard"]:
            found[hearer, entry["name"], entry["source"]] = entry["received"]
    return found


@exp.part("fleet", total=3)
async def observe(bench: Bench[Config]) -> None:
    """Let all parties publish, subscribe and call services, and write the received messages into the log."""
    config = bench.config
    async with Fleet(config, bench.testbed) as fleet:
        for party, domain in fleet.domains.items():
            bench.write(PartyRow(party=party, domain=domain))
        sent = await fleet.talk(config.seconds)
        bench.advance("talked")
        bench.write_all("call", await call_all(fleet, config.call_s))
        bench.advance("called")
        told = await fleet.ask_all("told", do="tell")
        heard = messages_heard(told)
        for topic, source, hearer in fleet.passages():
            row = HeardRow(
                name=topic.name,
                source=source,
                hearer=hearer,
                sent=1 if topic.latched else sent[source],
                received=heard.get((hearer, topic.name, source), 0),
            )
            bench.write(row)
        bench.write_all("endpoint", endpoint_rows(told))
        bench.advance("told")


async def call_all(fleet: Fleet, call_s: float) -> list[CallRow]:
    """Let all parties call all services; return one row for each caller and each service of another party.

    Services that must answer come first, and may take long.
    """
    servers = {name: party for party in fleet.domains for name in service_names(party)}
    rows = []
    for must_answer, timeout_s in ((True, ANSWER_S / 2), (False, call_s)):
        names = [name for name in servers if may_cross(name) is must_answer]
        reports = await fleet.ask_all("called", do="call", names=names, timeout_s=timeout_s)
        for caller, report in reports.items():
            for name, answer in zip(names, report["answers"], strict=True):
                server = servers[name]
                answered = answer["message"] == server
                if caller != server:
                    row = CallRow(name=name, caller=caller, server=server, answered=answered)
                    rows.append(row)
    return rows


def endpoint_rows(told: dict[str, Report]) -> Iterator[EndpointRow]:
    """Yield endpoints that parties in the global domain discovered beside their own."""
    own = {told[party]["participant"] for party in OTHERS}
    for party in OTHERS:
        for dds, kind, owner, tag in dict.fromkeys(map(tuple, told[party]["endpoints"])):
            if owner not in own:
                router = entries(tag.encode()).get(ROUTER_KEY, "")
                yield EndpointRow(seen_by=party, dds_topic=dds, kind=kind, router=router)
