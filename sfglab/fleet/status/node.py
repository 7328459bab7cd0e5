"""Status provider: an agent's heartbeats and the answer to what it is. Paper A, section 4.2.

Heartbeats are latched, so whoever joins late hears the last one at once; so is the description, where it is
offered. As a process (``python -m sfglab.fleet.status.node CONFIG``; see `sfglab.component`) it reports, beside
``ready``, every heartbeat, ``{"is": "beat", "revision", "phase", "period_s", "t_ns"}``, if so configured. The
order ``{"description": {...}}`` replaces the description, or is answered with ``{"is": "refused", "why"}``.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from sfglab import __version__
from sfglab.bus.address import BusAddress
from sfglab.component import Orders, Report, Reporter, beside, is_set_before, run_component
from sfglab.fleet.status.description import (
    AgentDescription,
    DescriptionError,
    accelerators,
    software,
)
from sfglab.fleet.status.heartbeat import (
    AGENT_HEARTBEAT,
    AGENT_METADATA,
    GET_METADATA,
    MAX_SAMPLE_BYTES,
    MIN_PERIOD_S,
    Heartbeat,
    Schedule,
    heartbeat_topic,
    metadata_service,
    metadata_topic,
)
from sfglab.messages import service_type
from sfglab.names import validate_agent
from sfglab.qos import LATCHED

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus import Node, Publisher


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusSettings:
    """What a status provider says, and when."""

    agent: str  #: The agent's name.
    description: AgentDescription = field(default_factory=AgentDescription)  #: What it is.
    schedule: Schedule = field(default_factory=Schedule)  #: When it beats.
    #: Whether the description is published, too; the paper's way is to be asked for it.
    offers: bool = False

    def __post_init__(self) -> None:
        validate_agent(self.agent)
        self.description.check(self.agent)


class StatusProvider:
    """The node that says that an agent is alive, and what it is; `on_beat` hears every heartbeat."""

    def __init__(
        self,
        node: Node,
        settings: StatusSettings,
        *,
        on_beat: Callable[[Heartbeat], None] = lambda _: None,
    ) -> None:
        self._node = node
        self._settings = settings
        self._on_beat = on_beat
        self.description = settings.description  #: What the agent is now.
        self._described_ns = 0
        self._incarnation = 0
        self._revision = 0
        self._updated = asyncio.Event()
        self._offer: Publisher | None = None

    def update(self, description: AgentDescription) -> None:
        """Replace the description, and say at once that it has changed.

        Raises:
            DescriptionError: It would be of no use to others; the old one stays.
        """
        description.check(self._settings.agent)
        self.description = description
        self._described_ns = self._node.get_clock().now_ns()
        self._revision += 1
        if self._offer is not None:
            self._offer.publish(self._metadata())
        self._updated.set()

    async def run(self, on_ready: Callable[[], None] = lambda: None) -> None:
        """Serve until cancelled; `on_ready` is called before the first heartbeat, which is sent at once."""
        self._incarnation = self._described_ns = self._node.get_clock().now_ns()
        # The service first: who hears the first heartbeat asks at once.
        service = self._node.create_service(
            GET_METADATA, metadata_service(self._settings.agent), lambda _: self._answer()
        )
        publisher = self._node.create_publisher(AGENT_HEARTBEAT, heartbeat_topic(), LATCHED)
        if self._settings.offers:
            self._offer = self._node.create_publisher(AGENT_METADATA, metadata_topic(), LATCHED)
            self._offer.publish(self._metadata())
        try:
            on_ready()
            await self._beat(publisher)
        finally:
            if self._offer is not None:
                self._offer.close()
                self._offer = None
            publisher.close()
            service.close()

    async def _beat(self, publisher: Publisher) -> None:
        start_s = asyncio.get_running_loop().time()
        elapsed_ns = 0
        while True:
            next_ns = self._settings.schedule.next_ns(elapsed_ns)
            self._updated.clear()
            self._publish(publisher, elapsed_ns, next_ns)
            updated = await is_set_before(self._updated, start_s + next_ns / 1e9)
            elapsed_ns = round((asyncio.get_running_loop().time() - start_s) * 1e9)
            if not updated:
                elapsed_ns = max(elapsed_ns, next_ns)  # a timer may be early by its resolution

    def _publish(self, publisher: Publisher, elapsed_ns: int, next_ns: int) -> None:
        heartbeat = Heartbeat(
            agent=self._settings.agent,
            incarnation=self._incarnation,
            revision=self._revision,
            phase=self._settings.schedule.phase(elapsed_ns),
            period_s=max((next_ns - elapsed_ns) / 1e9, MIN_PERIOD_S),
            version=__version__,
        )
        publisher.publish(heartbeat.to_message(self._node.get_clock().now_ns()))
        self._on_beat(heartbeat)

    def _metadata(self) -> Any:
        return self.description.to_message(
            self._settings.agent,
            incarnation=self._incarnation,
            revision=self._revision,
            stamp_ns=self._described_ns,
        )

    def _answer(self) -> Any:
        return service_type(GET_METADATA).response(
            success=True, message="", metadata=self._metadata()
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusConfig:
    """What a status provider's process is told."""

    address: BusAddress  #: The agent's local domain.
    settings: StatusSettings  #: What is said, and when.
    #: Whether software and accelerators are found out, in place of those described. Trying the accelerators
    #: takes a while; heartbeats do not wait for it, the description is updated.
    detect: bool = True
    report_beats: bool = False  #: Whether every heartbeat is reported.


async def run_status(config: StatusConfig, report: Reporter, orders: Orders) -> None:
    """Run a provider until cancelled and all it started has ended; `BusError` if it cannot join the domain."""
    from sfglab.bus import Node

    settings = config.settings
    if config.detect:
        settings = replace(settings, description=replace(settings.description, software=software()))
    bound = MAX_SAMPLE_BYTES  # anybody can send requests
    async with Node(
        "agent_status_provider", **config.address.options(), max_sample_bytes=bound
    ) as node:

        def beat(heartbeat: Heartbeat) -> None:
            if config.report_beats:
                said: Report = {"revision": heartbeat.revision, "phase": int(heartbeat.phase)}
                said |= {"period_s": heartbeat.period_s, "t_ns": node.get_clock().now_ns()}
                report({"is": "beat", **said})

        provider = StatusProvider(node, settings, on_beat=beat)
        detecting = [_detect(provider)] if config.detect else []
        async with beside(_obey(provider, report, orders), *detecting):
            await provider.run(on_ready=lambda: report({"is": "ready"}))


async def _obey(provider: StatusProvider, report: Reporter, orders: Orders) -> None:
    while True:
        order = await orders.get()
        try:
            provider.update(AgentDescription.from_values(order.get("description", {})))
        except DescriptionError as error:
            report({"is": "refused", "why": str(error)})


async def _detect(provider: StatusProvider) -> None:
    found = await asyncio.to_thread(accelerators)
    if found != provider.description.accelerators:
        provider.update(replace(provider.description, accelerators=found))


def main() -> None:
    """Be the process: serve until told to end."""
    run_component(StatusConfig, run_status)


if __name__ == "__main__":
    main()
