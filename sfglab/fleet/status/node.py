"""Status provider: heartbeats and description of an agent. Paper A, section 4.2.

Heartbeats are latched, so a late joiner receives the last one immediately. The same holds for the description
where it is published. As a process (``python -m sfglab.fleet.status.node CONFIG``; see `sfglab.component`) it
reports ``ready``. The order ``{"description": {...}}`` replaces the description. The sender of the order
validates the types of its values; a description that the agent must not have is answered with
``{"is": "refused", "why"}``.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from sfglab import __version__
from sfglab.component import Orders, Reporter, beside, is_set_before, run_component
from sfglab.errors import SfglabError
from sfglab.fields import from_json
from sfglab.fleet.status.config import StatusConfig, StatusSettings
from sfglab.fleet.status.description import AgentDescription, accelerators, software
from sfglab.fleet.status.heartbeat import (
    AGENT_HEARTBEAT,
    AGENT_METADATA,
    GET_METADATA,
    MAX_SAMPLE_BYTES,
    MIN_PERIOD_S,
    Heartbeat,
    heartbeat_topic,
    metadata_service,
    metadata_topic,
)
from sfglab.messages import service_type
from sfglab.qos import LATCHED

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus import Node, Publisher


class StatusProvider:
    """Node that publishes an agent's heartbeats and description."""

    def __init__(self, node: Node, settings: StatusSettings) -> None:
        self._node = node
        self._settings = settings
        self.description = settings.description  #: Current description of the agent.
        self._described_ns = 0
        self._incarnation = 0
        self._revision = 0
        self._updated = asyncio.Event()
        self._metadata_publisher: Publisher | None = None

    def update(self, description: AgentDescription) -> None:
        """Replace the description, and send a heartbeat with the new revision immediately.

        Raises:
            DescriptionError: The description is invalid for this agent. The old one stays.
        """
        description.check(self._settings.agent)
        self.description = description
        self._described_ns = self._node.get_clock().now_ns()
        self._revision += 1
        if self._metadata_publisher is not None:
            self._metadata_publisher.publish(self._metadata())
        self._updated.set()

    async def run(self, on_ready: Callable[[], None] = lambda: None) -> None:
        """Serve until cancelled. `on_ready` is called before the first heartbeat, which is sent immediately."""
        self._incarnation = self._described_ns = self._node.get_clock().now_ns()
        # Service and description come first, because the first heartbeat causes queries.
        service = self._node.create_service(
            GET_METADATA, metadata_service(self._settings.agent), lambda _: self._answer()
        )
        closing = [service.close]
        if self._settings.publish_description:
            description = self._node.create_publisher(AGENT_METADATA, metadata_topic(), LATCHED)
            description.publish(self._metadata())
            self._metadata_publisher = description
            closing.append(description.close)
        heartbeats = self._node.create_publisher(AGENT_HEARTBEAT, heartbeat_topic(), LATCHED)
        closing.append(heartbeats.close)
        try:
            on_ready()
            await self._beat(heartbeats)
        finally:
            self._metadata_publisher = None
            for close in reversed(closing):
                close()

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


async def run_status(config: StatusConfig, report: Reporter, orders: Orders) -> None:
    """Run a status provider until cancelled.

    Raises:
        BusError: The domain cannot be joined.
    """
    from sfglab.bus import Node

    settings = config.settings
    if config.detect:
        settings = replace(settings, description=replace(settings.description, software=software()))
    # Any participant can send requests, hence the bound on their size.
    async with Node(
        "agent_status_provider", **config.address.options(), max_sample_bytes=MAX_SAMPLE_BYTES
    ) as node:
        provider = StatusProvider(node, settings)
        bodies = [_update_description(provider, report, orders)]
        if config.detect:
            bodies.append(_detect(provider))
        async with beside(*bodies):
            await provider.run(on_ready=lambda: report({"is": "ready"}))


async def _update_description(provider: StatusProvider, report: Reporter, orders: Orders) -> None:
    """Replace the description at each order."""
    while True:
        order = await orders.get()
        try:
            provider.update(from_json(AgentDescription, order["description"]))
        except SfglabError as error:
            report({"is": "refused", "why": str(error)})


async def _detect(provider: StatusProvider) -> None:
    found = await asyncio.to_thread(accelerators)
    if found != provider.description.accelerators:
        provider.update(replace(provider.description, accelerators=found))


def main() -> None:
    """Run the process."""
    run_component(StatusConfig, run_status)


if __name__ == "__main__":
    main()
