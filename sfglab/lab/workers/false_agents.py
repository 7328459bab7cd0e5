"""False agents in a process of their own: ``python -m sfglab.lab.workers.false_agents CONFIG``.

They beat when they are told and answer as they are told: at once, never, too late, or not the truth. Every
query that arrives is reported: ``{"is": "asked", "agent", "t_ns"}``.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Any

from sfglab.bus import Node, Publisher
from sfglab.bus.address import BusAddress
from sfglab.component import Orders, Report, Reporter, run_component
from sfglab.fleet.status.description import AgentDescription
from sfglab.fleet.status.heartbeat import (
    AGENT_HEARTBEAT,
    GET_METADATA,
    Heartbeat,
    Phase,
    heartbeat_topic,
    metadata_service,
)
from sfglab.messages import service_type
from sfglab.qos import LATCHED


@dataclass(frozen=True, slots=True, kw_only=True)
class FakeConfig:
    """What the process is told."""

    address: BusAddress  #: Where its agents are.
    late_s: float  #: How long a late answer takes, seconds.


@dataclass(slots=True)
class _Fake:
    publisher: Publisher
    mode: str = "answer"
    incarnation: int = 0
    revision: int = 0
    changed: asyncio.Event = field(default_factory=asyncio.Event)


class _Fakes:
    """The agents, and what they do about their orders."""

    def __init__(self, node: Node, late_s: float, report: Reporter) -> None:
        self._node, self._late_s, self._report = node, late_s, report
        self._fakes: dict[str, _Fake] = {}

    def obey(self, order: Report) -> None:
        """Carry out an order: ``mode`` or ``beat``, for an agent that is made when it is new."""
        fake = self._fakes.get(order["agent"]) or self._make(order["agent"])
        if order["do"] == "mode":
            fake.mode = order["mode"]
            fake.changed.set()
            fake.changed = asyncio.Event()
        else:
            self._beat(fake, order)

    def _make(self, agent: str) -> _Fake:
        publisher = self._node.create_publisher(AGENT_HEARTBEAT, heartbeat_topic(), LATCHED)
        fake = self._fakes[agent] = _Fake(publisher)
        self._node.create_service(
            GET_METADATA, metadata_service(agent), lambda _: self._answer(agent, fake)
        )
        return fake

    def _beat(self, fake: _Fake, order: Report) -> None:
        fake.incarnation, fake.revision = order["incarnation"], order["revision"]
        heartbeat = Heartbeat(
            agent=str(order.get("bearing", order["agent"])),
            incarnation=fake.incarnation,
            revision=fake.revision,
            phase=Phase.STARTUP,
            period_s=order["period_s"],
            version="false agent",
        )
        for _ in range(order.get("times", 1)):
            fake.publisher.publish(heartbeat.to_message(self._node.get_clock().now_ns()))

    async def _answer(self, agent: str, fake: _Fake) -> Any:
        self._report({"is": "asked", "agent": agent, "t_ns": self._node.get_clock().now_ns()})
        if fake.mode == "late":
            await asyncio.sleep(self._late_s)
        while fake.mode == "mute":
            await fake.changed.wait()
        start = {"incarnation": fake.incarnation, "revision": fake.revision}
        description, now_ns = (
            AgentDescription(software=("false agent",)),
            self._node.get_clock().now_ns(),
        )
        metadata = description.to_message(agent, stamp_ns=now_ns, **start)
        refused = "told so" if fake.mode == "refuse" else ""
        return service_type(GET_METADATA).response(
            success=not refused, message=refused, metadata=metadata
        )


async def serve(config: FakeConfig, report: Reporter, orders: Orders) -> None:
    """Obey until cancelled."""
    async with Node("false_agents", **config.address.options()) as node:
        fakes = _Fakes(node, config.late_s, report)
        report({"is": "ready"})
        while True:
            fakes.obey(await orders.get())


if __name__ == "__main__":
    run_component(FakeConfig, serve)
