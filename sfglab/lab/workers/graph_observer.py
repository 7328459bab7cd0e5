"""Graph observer of DDS domains: ``python -m sfglab.lab.workers.graph_observer CONFIG``.

Joins domains on one interface, collects every endpoint that anybody shows there for a while, and reports one
JSON line, ``{"is": "seen", "domains": {"0": [...], ...}}``: names of topics, each as often as it has endpoints.
"""

from __future__ import annotations

import asyncio
import json
import sys
from contextlib import AsyncExitStack
from dataclasses import asdict, dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class ObserverConfig:
    """Where to look, and how long."""

    domains: tuple[int, ...]  #: DDS domains.
    interface: str  #: Network interface.
    seconds: float  #: For how long.

    def to_json(self) -> str:
        """Return the configuration as a process's argument."""
        return json.dumps(asdict(self))


async def look(config: ObserverConfig) -> dict[str, list[str]]:
    """Return the topics of all endpoints that were ever shown, by domain."""
    from sfglab.bus import Node

    seen: dict[str, dict[bytes, str]] = {str(domain): {} for domain in config.domains}
    async with AsyncExitStack() as stack:
        nodes = {
            str(domain): await stack.enter_async_context(
                Node("onlooker", domain_id=domain, interface=config.interface)
            )
            for domain in config.domains
        }
        end_s = asyncio.get_running_loop().time() + config.seconds
        while asyncio.get_running_loop().time() < end_s:
            for domain, node in nodes.items():
                seen[domain] |= {endpoint.gid: endpoint.topic for endpoint in node.graph.endpoints()}
            await asyncio.sleep(0.1)
    return {domain: sorted(topics.values()) for domain, topics in seen.items()}


def main(text: str) -> None:
    """Look and report."""
    values = json.loads(text)
    seen = asyncio.run(look(ObserverConfig(**(values | {"domains": tuple(values["domains"])}))))
    sys.stdout.write(json.dumps({"is": "seen", "domains": seen}) + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
