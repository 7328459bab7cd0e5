"""The fleet of the routing experiment: agents behind routers, two parties in the global domain.

Knows how to start, order and end processes; refuses to know what is measured.
"""

from __future__ import annotations

import asyncio
import sys
from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.component import argument_of
from sfglab.fleet.router.node import RouterConfig
from sfglab.lab.experiments.routing.probes import in_table_1, service_names, topics
from sfglab.lab.experiments.routing.rows import PartyRow
from sfglab.lab.staging import Staged
from sfglab.lab.workers.test_peer import PeerConfig, TopicUse
from sfglab.names import dds_topic
from sfglab.processes import LineProcess

if TYPE_CHECKING:
    from sfglab.lab.experiments.routing.config import Config
    from sfglab.lab.experiments.routing.probes import Topic
    from sfglab.lab.testbed import Testbed


GLOBAL_DOMAIN = 0
OTHERS = ("ground_1", "ground_2")
START_S = 40.0
ANSWER_S = 30.0
PATIENCE_S, POLL_S = 15.0, 0.5


def parties_of(config: Config) -> tuple[PartyRow, ...]:
    """Return who takes part: agents in domains of their own, then the others in the global one."""
    agents = [PartyRow(party=f"agent_{i}", domain=i, host=f"agent_{i}") for i in range(1, config.agents + 1)]
    return (*agents, *(PartyRow(party=name, domain=GLOBAL_DOMAIN, host=name) for name in OTHERS))


class Stage(Staged):
    """Everybody's processes; an async context manager that starts and ends them.

    Args:
        config: The experiment.
        testbed: A host for every party.

    Attributes:
        parties: Who takes part.
        topics: What they use.
    """

    def __init__(self, config: Config, testbed: Testbed) -> None:
        super().__init__()
        self.parties = parties_of(config)
        agents = [p.party for p in self.parties if p.domain != GLOBAL_DOMAIN]
        self.topics: tuple[Topic, ...] = tuple(topics(agents, OTHERS, busy=config.busy))
        self._config = config
        self._testbed = testbed
        self._talkers: dict[str, LineProcess] = {}

    async def talk(self, seconds: float) -> dict[str, int]:
        """Let everybody talk, and return how many rounds of messages each has sent when all is quiet.

        Goes on beyond the seconds, within limits, until whoever should hear somebody does: on a busy machine
        paths form slowly, and that is not what is asked here.
        """
        for talker in self._talkers.values():
            talker.order(do="talk")
        await asyncio.sleep(seconds)
        for _ in range(round(PATIENCE_S / POLL_S)):
            if self._all_heard(await self.ask("told", do="tell")):
                break
            await asyncio.sleep(POLL_S)
        reports = await self.ask("hushed", do="hush")
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

    async def ask(self, answer: str, **order: Any) -> dict[str, dict[str, Any]]:
        """Give everybody the same order and return their reports by party."""
        for talker in self._talkers.values():
            talker.order(**order)
        waits = [talker.expect(answer, timeout_s=ANSWER_S) for talker in self._talkers.values()]
        return dict(zip(self._talkers, await asyncio.gather(*waits), strict=True))

    async def _start(self) -> None:
        routers = [self._launch(p, "sfglab.fleet.router.node", self._router(p)) for p in self._agents]
        talkers = [self._launch(p, "sfglab.lab.workers.test_peer", self._party(p)) for p in self.parties]
        started = await asyncio.gather(*routers, *talkers)
        for process in started[: len(routers)]:
            await process.expect("ready", timeout_s=START_S)
        self._talkers = dict(zip((p.party for p in self.parties), started[len(routers) :], strict=True))
        for talker in self._talkers.values():
            await talker.expect("ready", timeout_s=START_S)

    @property
    def _agents(self) -> tuple[PartyRow, ...]:
        return tuple(p for p in self.parties if p.domain != GLOBAL_DOMAIN)

    async def _launch(self, party: PartyRow, module: str, config: str) -> LineProcess:
        argv = self._testbed.argv(party.host, [sys.executable, "-m", module, config])
        process = await LineProcess.start(f"{party.party}, {module}", argv)
        self._stack.push_async_callback(process.close)
        return process

    def _global(self, party: PartyRow) -> BusAddress:
        return BusAddress(domain_id=GLOBAL_DOMAIN, interface=self._testbed.interface(party.host))

    def _local(self, party: PartyRow) -> BusAddress:
        return BusAddress(domain_id=party.domain, interface="lo")

    def _router(self, party: PartyRow) -> str:
        return argument_of(
            RouterConfig(agent=party.party, local=self._local(party), remote=self._global(party))
        )

    def _party(self, party: PartyRow) -> str:
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
        config = PeerConfig(
            party=party.party,
            address=self._local(party) if behind else self._global(party),
            behind_router=behind,
            topics=uses,
            serves=service_names(party.party),
            rate_hz=self._config.rate_hz,
        )
        return argument_of(config)
