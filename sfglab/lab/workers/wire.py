"""A listener of its own process and host: ``python -m sfglab.lab.workers.wire CONFIG``.

It reports what arrives, as the bytes that arrived. Orders: ``{"do": "join"}`` subscribes, ``{"do": "look"}``
reports the publishers of the topics, ``{"do": "ask", "service"}`` calls a metadata service.
"""

from __future__ import annotations

import asyncio
import base64
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.bus import Node, Subscription
from sfglab.bus.address import BusAddress
from sfglab.component import Orders, Reporter, run_component
from sfglab.errors import SfglabError
from sfglab.fleet.status.heartbeat import GET_METADATA
from sfglab.messages import service_type
from sfglab.qos import Durability, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Iterable

QOS = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=1000)
ASK_TIMEOUT_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WireConfig:
    """What a listener is told."""

    address: BusAddress  #: Where it listens.
    topics: dict[str, str]  #: Type by topic.


async def serve(config: WireConfig, report: Reporter, orders: Orders) -> None:
    """Obey until cancelled."""
    report({"is": "ready"})
    await orders.get()  # to join: until then nothing of this process is in the domain
    async with Node("wire", **config.address.options()) as node, asyncio.TaskGroup() as listening:
        now_ns = node.get_clock().now_ns()
        for topic, type_ in config.topics.items():
            listening.create_task(
                _listen(node.create_subscription(type_, topic, qos=QOS, raw=True), report)
            )
        report({"is": "joined", "t_ns": now_ns})
        while True:
            order = await orders.get()
            if order["do"] == "ask":
                await _ask(node, order["service"], report)
            else:
                _look(node, config.topics, report)


def _look(node: Node, topics: Iterable[str], report: Reporter) -> None:
    for topic in topics:
        for publisher in node.graph.publishers(topic):
            report(
                {
                    "is": "publisher",
                    "topic": topic,
                    "type": publisher.type,
                    "reliability": publisher.qos.reliability.value,
                    "durability": publisher.qos.durability.value,
                    "gid": publisher.gid.hex(),
                }
            )
    report({"is": "looked"})


async def _listen(subscription: Subscription, report: Reporter) -> None:
    while True:
        cdr, info = await subscription.take_with_info()
        report(
            {
                "is": "heard",
                "topic": subscription.topic_name,
                "cdr": base64.b64encode(cdr).decode(),
                "sent_ns": info.source_timestamp_ns,
                "received_ns": info.received_timestamp_ns,
                "gid": info.publisher_gid.hex(),
            }
        )


async def _ask(node: Node, service: str, report: Reporter) -> None:
    client = node.create_client(GET_METADATA, service)
    start_s = asyncio.get_running_loop().time()
    try:
        response = await client.call(service_type(GET_METADATA).request(), timeout_s=ASK_TIMEOUT_S)
        answer = {
            "answered": bool(response.success),
            "incarnation": int(response.metadata.incarnation),
        }
    except SfglabError:
        answer = {"answered": False, "incarnation": 0}
    finally:
        client.close()
    took_s = asyncio.get_running_loop().time() - start_s
    report({"is": "answer", "service": service, "took_s": took_s, **answer})


if __name__ == "__main__":
    run_component(WireConfig, serve)
