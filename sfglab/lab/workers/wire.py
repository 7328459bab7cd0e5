"""A listener of its own process and host: ``python -m sfglab.lab.workers.wire CONFIG``.

It reports what arrives, as the bytes that arrived. Orders: ``{"do": "join"}`` subscribes, ``{"do": "look"}``
reports the publishers of the topics, ``{"do": "ask", "service"}`` calls a metadata service.
"""

from __future__ import annotations

import asyncio
import base64
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.bus.address import BusAddress
from sfglab.component import run_component
from sfglab.errors import SfglabError
from sfglab.fleet.status.heartbeat import GET_METADATA
from sfglab.messages import service_type
from sfglab.qos import Durability, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus import Node, Subscription
    from sfglab.component import Report


QOS = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=1000)
ASK_TIMEOUT_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WireConfig:
    """What a listener is told."""

    address: BusAddress  #: Where it listens.
    topics: dict[str, str]  #: Type by topic.


class Wire:
    """The listener's side of its orders."""

    def __init__(self, config: WireConfig, report: Callable[[Report], None]) -> None:
        self._config = config
        self._report = report
        self._listening: list[asyncio.Task[None]] = []

    async def run(self, orders: asyncio.Queue[Report]) -> None:
        """Obey until cancelled."""
        from sfglab.bus import Node

        self._report({"is": "ready"})
        await orders.get()  # to join: until then nothing of this process is in the domain
        async with Node("wire", **self._config.address.options()) as node:
            self._join(node)
            try:
                while True:
                    await self._obey(node, await orders.get())
            finally:
                for task in self._listening:
                    task.cancel()
                await asyncio.gather(*self._listening, return_exceptions=True)

    def _join(self, node: Node) -> None:
        now_ns = node.get_clock().now_ns()
        for topic, type_ in self._config.topics.items():
            subscription = node.create_subscription(type_, topic, qos=QOS, raw=True)
            self._listening.append(asyncio.create_task(self._listen(subscription)))
        self._report({"is": "joined", "t_ns": now_ns})

    async def _obey(self, node: Node, order: Report) -> None:
        if order["do"] == "ask":
            await self._ask(node, order["service"])
            return
        for topic in self._config.topics:
            for publisher in node.graph.publishers(topic):
                self._report(
                    {
                        "is": "publisher",
                        "topic": topic,
                        "type": publisher.type,
                        "reliability": publisher.qos.reliability.value,
                        "durability": publisher.qos.durability.value,
                        "gid": publisher.gid.hex(),
                    }
                )
        self._report({"is": "looked"})

    async def _listen(self, subscription: Subscription) -> None:
        while True:
            cdr, info = await subscription.take_with_info()
            self._report(
                {
                    "is": "heard",
                    "topic": subscription.topic_name,
                    "cdr": base64.b64encode(cdr).decode(),
                    "sent_ns": info.source_timestamp_ns,
                    "received_ns": info.received_timestamp_ns,
                    "gid": info.publisher_gid.hex(),
                }
            )

    async def _ask(self, node: Node, service: str) -> None:
        client = node.create_client(GET_METADATA, service)
        start_s = asyncio.get_running_loop().time()
        try:
            response = await client.call(service_type(GET_METADATA).request(), timeout_s=ASK_TIMEOUT_S)
            answer = {"answered": bool(response.success), "incarnation": int(response.metadata.incarnation)}
        except SfglabError:
            answer = {"answered": False, "incarnation": 0}
        finally:
            client.close()
        took_s = asyncio.get_running_loop().time() - start_s
        self._report({"is": "answer", "service": service, "took_s": took_s, **answer})


async def serve(config: WireConfig, report: Callable[[Report], None], orders: asyncio.Queue[Report]) -> None:
    """Be the process."""
    await Wire(config, report).run(orders)


if __name__ == "__main__":
    run_component(WireConfig, serve)
