"""Commands of the rendered Compose projects, run over DDS between machines that are network namespaces.

An agent's container is a namespace on the bridge of its machine. Images, users and Docker's own rules are not
part of this.
"""

from __future__ import annotations

import asyncio
import re
import signal
import subprocess
import sys
from contextlib import AsyncExitStack, suppress
from typing import TYPE_CHECKING

import yaml

from sfglab.bus.address import BusAddress
from sfglab.deploy.deployment import FLEET_FILE, Deployment
from sfglab.lab.experiments.deployment.facts import DISCOVERY, INSIDE, OUTSIDE
from sfglab.lab.hosts import Host, Network
from sfglab.lab.workers.peer import PeerConfig
from sfglab.processes import LineProcess, Member, ProcessGroup

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from sfglab.deploy.bundle import Bundle

    Pairs = Sequence[tuple[Deployment, Bundle]]

OUTSIDER = "outsider"
MEETING_S = 120.0  #: Time limit of discovery, s.
LOOKING_S = 2.0  #: Time for which the observing node stays in each domain, s.
_GRACE_S = 10.0
_SFGLAB = (sys.executable, "-c", "from sfglab.cli import main; main()")
_HEARTBEAT = "rt/global/agent_heartbeat"
_GLOBAL = re.compile(r"r[tqr]/(global/.*|tf|tf_static)")


async def ask_containers(pairs: Pairs, folder: Path) -> dict[str, str]:
    """Run the commands of agents' Compose projects, observe all domains from another host, and return the faults.

    The result has one fault per fact; it is empty if the fact holds.

    Raises:
        ProcessFailedError: An agent's container ended.
    """
    names = {deployment.agent.name for deployment, _ in pairs}
    with Network() as network:
        hosts = {name: network.add_host(name) for name in (*sorted(names), OUTSIDER)}
        fleet = folder / "fleet.yaml"
        text = pairs[0][0].release.fleet_text
        of_hosts = rf"\1: {Host.interface}"
        fleet.write_text(re.sub(r"\b(interface|global_interface): \w+", of_hosts, text), "utf-8")
        async with AsyncExitStack() as stack:
            waiting = []
            for deployment, bundle in pairs:
                name = deployment.agent.name
                agent = await _start(stack, deployment, bundle, hosts[name], fleet)
                waiting.append(_undiscovered(agent, names - {name}))
            missing = await asyncio.gather(*waiting)
            seen = await _look(hosts[OUTSIDER], pairs)
    shown = seen.pop(pairs[0][0].fleet.global_domain)
    foreign = {topic for topic in shown if not _GLOBAL.fullmatch(topic)}
    return {
        DISCOVERY: ", ".join(sorted(set().union(*missing))),
        INSIDE: ", ".join(sorted(set().union(*seen.values()))),
        OUTSIDE: ", ".join(sorted(foreign | ({_HEARTBEAT} - shown))),
    }


async def _start(
    stack: AsyncExitStack, deployment: Deployment, bundle: Bundle, host: Host, fleet: Path
) -> LineProcess:
    """Start both containers of an agent, and return the process in the agent's container."""
    services = yaml.safe_load(bundle.members["compose.yaml"].text)["services"]
    commands = {}
    for name, service in services.items():
        words = [str(fleet) if word == FLEET_FILE else word for word in service["command"]]
        commands[name] = [*_SFGLAB, *words]
    enter = (sys.executable, "-m", "sfglab.lab.workers.container", deployment.bridge)
    # Compose makes the network before any container; a router that starts without it fails.
    await asyncio.to_thread(host.run, enter, MEETING_S, check=True)
    host.popen(commands["router"], stdout=subprocess.DEVNULL)
    agent = await LineProcess.start("agent", host.argv([*enter, *commands["agent"], "--json"]))
    stack.push_async_callback(agent.close, grace_s=_GRACE_S)
    stack.callback(agent.signal, signal.SIGTERM)
    return agent


async def _undiscovered(agent: LineProcess, wanted: set[str]) -> set[str]:
    """Wait until an agent's discoverer has reported other agents; return those that it did not report."""
    missing = set(wanted)
    with suppress(TimeoutError):
        async with asyncio.timeout(MEETING_S):
            while missing:
                match await agent.expect("report", timeout_s=None):
                    case {"report": {"event": "DISCOVERED", "agent": str(name)}}:
                        missing.discard(name)
    return missing


async def _look(outside: Host, pairs: Pairs) -> dict[int, set[str]]:
    """Return the DDS topics of all endpoints that another host discovers, by domain."""
    domains = {deployment.agent.domain for deployment, _ in pairs}
    domains.add(pairs[0][0].fleet.global_domain)
    members = []
    for domain in sorted(domains):
        address = BusAddress(domain_id=domain, interface=outside.interface)
        config = PeerConfig(name="onlooker", address=address)
        members.append(Member(name=str(domain), module="sfglab.lab.workers.peer", config=config))
    async with ProcessGroup(
        members, wrap_command=lambda _, command: outside.argv(command), start_s=MEETING_S
    ) as group:
        await asyncio.sleep(LOOKING_S)
        reports = await group.ask("told", timeout_s=MEETING_S, do="tell")
    return {int(name): {topic for topic, *_ in r["endpoints"]} for name, r in reports.items()}
