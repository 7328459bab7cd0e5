"""One end of flows between two agents: ``python -m sfglab.lab.workers.flows CONFIG``.

The process publishes on, or subscribes to, a flow of each kind at each address. The name of a flow is that of its
place and its kind. Messages are not deserialized. The order ``{"do": "send", "flow", "rate_hz", "seconds"}`` is
answered by ``sent``. The order ``{"do": "tell"}`` is answered by ``told``, with the messages since the last such
order by flow: source time stamp and time of reception (Unix time, ns).
"""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Literal

import numpy as np

from sfglab.bus import Node
from sfglab.bus.address import BusAddress
from sfglab.component import Orders, Reporter, beside, run_component
from sfglab.messages import default_message, serialize

if TYPE_CHECKING:
    from sfglab.bus import Publisher, Subscription

Kind = Literal["message", "image"]
TYPES: dict[Kind, str] = {"message": "std_msgs/msg/String", "image": "sensor_msgs/msg/Image"}
_LETTERS = 55  # 64 bytes of CDR
_PIXELS_BYTES = 640 * 480 * 3


@dataclass(frozen=True, slots=True, kw_only=True)
class FlowsConfig:
    """Configuration of one end of the flows."""

    places: dict[str, BusAddress]  #: Address of each place.
    publishes: bool  #: Whether the process publishes; otherwise it subscribes.


def serialized(kind: Kind) -> bytes:
    """Return the CDR of a message: a text of 64 B in all, or an image with 921,600 B of pixels."""
    data = "x" * _LETTERS if kind == "message" else np.zeros(_PIXELS_BYTES, np.uint8)
    return serialize(default_message(TYPES[kind], data=data))


async def _send(publisher: Publisher, cdr: bytes, rate_hz: float, seconds: float) -> None:
    loop = asyncio.get_running_loop()
    begin_s = loop.time()
    for number in range(round(seconds * rate_hz)):
        await asyncio.sleep(begin_s + number / rate_hz - loop.time())
        publisher.publish_raw(cdr)


async def _receive(subscription: Subscription, times_ns: list[tuple[int, int]]) -> None:
    while True:
        _, info = await subscription.take_with_info()
        times_ns.append((info.source_timestamp_ns, info.received_timestamp_ns))


async def serve(config: FlowsConfig, report: Reporter, orders: Orders) -> None:
    """Publish or receive as ordered until cancelled."""
    publishers: dict[str, tuple[Publisher, bytes]] = {}
    times_ns: dict[str, list[tuple[int, int]]] = {}
    bodies = []
    async with AsyncExitStack() as stack:
        for (place, address), kind in product(config.places.items(), TYPES):
            flow, topic = f"{place} {kind}", f"/global/agent_1/flow/{kind}"
            node = await stack.enter_async_context(Node("flows", **address.options()))
            if config.publishes:
                publisher = node.create_publisher(TYPES[kind], topic)
                publishers[flow] = publisher, serialized(kind)
            else:
                subscription = node.create_subscription(TYPES[kind], topic, raw=True)
                times_ns[flow] = []
                bodies.append(_receive(subscription, times_ns[flow]))
        await stack.enter_async_context(beside(*bodies))
        report({"is": "ready"})
        while True:
            order = await orders.get()
            if order["do"] == "send":
                await _send(*publishers[order["flow"]], order["rate_hz"], order["seconds"])
                report({"is": "sent"})
            else:
                report({"is": "told", **times_ns})
                for received in times_ns.values():
                    received.clear()


if __name__ == "__main__":
    run_component(FlowsConfig, serve)
