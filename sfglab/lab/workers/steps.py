"""A receiver that notes when it has what: ``python -m sfglab.lab.workers.steps CONFIG``.

Without a type it takes plain datagrams at the port that its ``ready`` tells. Ordered ``{"do": "tell"}`` it
reports ``{"is": "told", "times"}``, of each message since: its number, when it was in hand and when it had been
read, by the steady clock, ns.
"""

from __future__ import annotations

import socket
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus import Node
from sfglab.bus.address import BusAddress
from sfglab.component import Orders, Reporter, run_component
from sfglab.fleet.decoder.pipeline import LOCAL_QOS

if TYPE_CHECKING:
    from sfglab.bus.api import Transport

IMAGE, TEXT = "sensor_msgs/msg/Image", "std_msgs/msg/String"


@dataclass(frozen=True, slots=True, kw_only=True)
class StepsConfig:
    """What a receiver is told."""

    address: BusAddress  #: Where.
    topic: str = ""  #: What it hears.
    type: str = ""  #: Its type, `IMAGE` or `TEXT`; empty: plain datagrams.
    transport: str = "dds"  #: By which transport.


async def serve(config: StepsConfig, report: Reporter, orders: Orders) -> None:
    """Receive and tell until cancelled."""
    times: list[tuple[int, int, int]] = []

    def see(message: Any) -> None:
        begun_ns = time.monotonic_ns()
        if config.type == TEXT:
            times.append((int(message.data), begun_ns, begun_ns))
            return
        np.bitwise_xor.reduce(message.data.view(np.uint64))
        times.append((message.header.stamp.sec, begun_ns, time.monotonic_ns()))

    def take(datagrams: socket.socket) -> None:
        while number := datagrams.recv(64):
            now_ns = time.monotonic_ns()
            times.append((int(number), now_ns, now_ns))

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as datagrams:
        datagrams.bind(("127.0.0.1", 0))
        threading.Thread(target=take, args=(datagrams,), daemon=True).start()
        async with Node("steps", **config.address.options()) as node:
            if config.type:
                transport: Transport = config.transport  # type: ignore[assignment]  # the argument carries text
                node.create_subscription(
                    config.type, config.topic, see, LOCAL_QOS, transport=transport, threaded=True
                )
            report({"is": "ready", "port": datagrams.getsockname()[1]})
            while await orders.get():
                told, times[:] = times[:], []
                report({"is": "told", "times": told})


if __name__ == "__main__":
    run_component(StepsConfig, serve)
