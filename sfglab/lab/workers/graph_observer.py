"""Graph observer of DDS domains: ``python -m sfglab.lab.workers.graph_observer CONFIG``.

Joins domains on one interface, collects every endpoint that anybody shows there for a while, and reports one
JSON line, ``{"is": "seen", "domains": {"0": [...], ...}}``: names of topics, each as often as it has endpoints.
"""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from dataclasses import dataclass

from sfglab.bus import Node
from sfglab.bus.address import BusAddress
from sfglab.component import Orders, Reporter, run_component


@dataclass(frozen=True, slots=True, kw_only=True)
class ObserverConfig:
    """Where to look, and how long."""

    addresses: tuple[BusAddress, ...]  #: DDS domains.
    seconds: float  #: For how long.


async def look(config: ObserverConfig) -> dict[str, list[str]]:
    """Return the topics of all endpoints that were ever shown, by domain."""
    seen: dict[str, dict[bytes, str]] = {str(address.domain_id): {} for address in config.addresses}
    async with AsyncExitStack() as stack:
        nodes = {
            str(address.domain_id): await stack.enter_async_context(
                Node("onlooker", **address.options())
            )
            for address in config.addresses
        }
        end_s = asyncio.get_running_loop().time() + config.seconds
        while asyncio.get_running_loop().time() < end_s:
            for domain, node in nodes.items():
                seen[domain] |= {
                    endpoint.gid: endpoint.topic for endpoint in node.graph.endpoints()
                }
            await asyncio.sleep(0.1)
    return {domain: sorted(topics.values()) for domain, topics in seen.items()}


async def serve(config: ObserverConfig, report: Reporter, _: Orders) -> None:
    """Look and report."""
    report({"is": "seen", "domains": await look(config)})


if __name__ == "__main__":
    run_component(ObserverConfig, serve)
