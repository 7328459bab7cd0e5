"""The fleet of the experiment: agents behind routers, two parties in the global domain, and what all use.

Every party publishes and subscribes all names, so that a router that asked only whether somebody wants a topic
would let everything cross. Knows how to start, order and end processes; refuses to know what is measured.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.fleet.router.node import RouterConfig
from sfglab.lab.checks.routing import NEAR_MISSES, in_table_1
from sfglab.lab.workers.test_peer import TRANSFORMS, PeerConfig, TopicUse
from sfglab.names import TF, TF_STATIC, Resource, RosFqnBuilder, Scope, dds_topic
from sfglab.processes import Member, ProcessGroup

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from sfglab.component import Report
    from sfglab.lab.testbed import Testbed

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
    yield Topic(name=TF_STATIC, type=TRANSFORMS, publishers=everybody, subscribers=everybody, latched=True)
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
    crossing, local = (_name(scope, party, Resource.GET_METADATA) for scope in (Scope.GLOBAL, Scope.LOCAL))
    return crossing, local, f"/globally/{party}/{Resource.GET_METADATA.value}"


def _name(scope: Scope, party: str | None, resource: Resource) -> str:
    builder = RosFqnBuilder().scope(scope)
    builder = builder.without_agent() if party is None else builder.agent(party)
    return str(builder.resource(resource).build())


def parties_of(agents: int) -> tuple[PartyRow, ...]:
    """Return who takes part: agents in domains of their own, then the others in the global one."""
    behind = [PartyRow(party=f"agent_{i}", domain=i, host=f"agent_{i}") for i in range(1, agents + 1)]
    return (*behind, *(PartyRow(party=name, domain=GLOBAL_DOMAIN, host=name) for name in OTHERS))


class Stage(ProcessGroup):
    """Everybody's processes, each party's on a host of its own."""

    def __init__(self, config: Any, testbed: Testbed) -> None:
        self.parties = parties_of(config.agents)  #: Who takes part.
        self._agents = tuple(p for p in self.parties if p.domain != GLOBAL_DOMAIN)
        #: What they use.
        self.topics = tuple(topics([p.party for p in self._agents], OTHERS, busy=config.busy))
        self._rate_hz, self._testbed = config.rate_hz, testbed
        router, peer = "sfglab.fleet.router.node", "sfglab.lab.workers.test_peer"
        routers = (
            Member(name=f"router of {p.party}", host=p.host, module=router, config=self._router(p))
            for p in self._agents
        )
        peers = (Member(name=p.party, host=p.host, module=peer, config=self._peer(p)) for p in self.parties)
        super().__init__(testbed.argv, (*routers, *peers))

    async def talk(self, seconds: float) -> dict[str, int]:
        """Let everybody talk, and return how many rounds of messages each has sent when all is quiet.

        Goes on beyond the seconds, within limits, until whoever should hear somebody does: on a busy machine
        paths form slowly, and that is not what is asked here.
        """
        self.order([p.party for p in self.parties], do="talk")
        await asyncio.sleep(seconds)
        for _ in range(round(PATIENCE_S / POLL_S)):
            if self._all_heard(await self.ask_all("told", do="tell")):
                break
            await asyncio.sleep(POLL_S)
        reports = await self.ask_all("hushed", do="hush")
        return {party: report["sent"] for party, report in reports.items()}

    def _all_heard(self, told: dict[str, dict[str, Any]]) -> bool:
        heard = {(p, entry["name"], entry["source"]) for p, r in told.items() for entry in r["heard"]}
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

    def _local(self, party: PartyRow) -> BusAddress:
        return BusAddress(domain_id=party.domain, interface="lo")

    def _router(self, party: PartyRow) -> RouterConfig:
        return RouterConfig(agent=party.party, local=self._local(party), remote=self._global(party))

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
            address=self._local(party) if behind else self._global(party),
            behind_router=behind,
            topics=uses,
            serves=service_names(party.party),
            rate_hz=self._rate_hz,
        )
