"""The commands of the rendered Compose projects, run over DDS between machines that are network namespaces.

An agent's container is a namespace on its machine's bridge. Images, users and Docker's rules are not in it.
"""

from __future__ import annotations

import asyncio
import json
import re
import sys
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from typing import TYPE_CHECKING

import yaml

from sfglab.bus.address import BusAddress
from sfglab.deploy.deployment import FLEET_FILE, Deployment
from sfglab.lab.checks import CheckRow
from sfglab.lab.hosts import Host, Network
from sfglab.lab.workers.peer import PeerConfig
from sfglab.processes import Member, ProcessFailedError, ProcessGroup

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Sequence
    from pathlib import Path

    from sfglab.deploy.bundle import Bundle

OUTSIDER = "outsider"
MEETING_S = 120.0
LOOKING_S = 2.0
_GRACE_S = 10.0
_SFGLAB = (sys.executable, "-c", "from sfglab.cli import main; main()")


async def container_checks(
    pairs: Sequence[tuple[Deployment, Bundle]], folder: Path
) -> list[CheckRow]:
    """Run two or more agents as their Compose projects say, and look at them from outside.

    Raises:
        ProcessFailedError: A container ended, or nobody met in time.
    """
    names = [deployment.agent.name for deployment, _ in pairs]
    with Network() as network:
        hosts = {name: network.add_host(name) for name in (*names, OUTSIDER)}
        outside = hosts[OUTSIDER]
        fleet = _fleet_file(pairs[0][0], folder, interface=outside.interface)
        async with AsyncExitStack() as stack:
            agents = {
                d.agent.name: await _start(stack, d, b, hosts[d.agent.name], fleet)
                for d, b in pairs
            }
            meetings = (_discovered(agent, {*names} - {name}) for name, agent in agents.items())
            found = await asyncio.gather(*meetings)
            seen = await _look(outside, pairs)
    return [_meeting_row(names, found), _inside_row(pairs, seen), _global_row(pairs, seen)]


async def _start(
    stack: AsyncExitStack, deployment: Deployment, bundle: Bundle, host: Host, fleet: Path
) -> asyncio.subprocess.Process:
    """Start both containers of an agent, and return the agent's."""
    # The commands of a Compose project's services, with the fleet file where it is here.
    commands = {
        name: [str(fleet) if part == FLEET_FILE else part for part in service["command"]]
        for name, service in yaml.safe_load(bundle.members["compose.yaml"].data)["services"].items()
    }
    enter = (sys.executable, "-m", "sfglab.lab.workers.container", deployment.network.bridge)
    inside = host.argv([*enter, *_SFGLAB, *commands["agent"], "--json"])
    agent = await stack.enter_async_context(_running(inside))
    await stack.enter_async_context(_running(host.argv([*_SFGLAB, *commands["router"]])))
    return agent


def _fleet_file(deployment: Deployment, folder: Path, *, interface: str) -> Path:
    """Write the fleet file as the containers read it, with the test hosts' interface as the way out."""
    text = deployment.release.fleet_text
    for name in {agent.global_interface for agent in deployment.fleet.agents} - {None}:
        text = text.replace(f"interface: {name}", f"interface: {interface}")
    path = folder / "fleet.yaml"
    path.write_text(text, encoding="utf-8")
    return path


@asynccontextmanager
async def _running(argv: Sequence[str]) -> AsyncIterator[asyncio.subprocess.Process]:
    process = await asyncio.create_subprocess_exec(
        *argv, stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, limit=1 << 20
    )
    try:
        yield process
    finally:
        if process.returncode is None:
            process.terminate()
        try:
            async with asyncio.timeout(_GRACE_S):
                await process.communicate()
        except TimeoutError:
            process.kill()
            await process.communicate()


async def _discovered(process: asyncio.subprocess.Process, wanted: set[str]) -> set[str]:
    """Return which agents an agent's discoverer reports, as soon as all wanted are there or the time is up."""
    found: set[str] = set()
    assert process.stdout is not None
    with suppress(TimeoutError):
        async with asyncio.timeout(MEETING_S):
            while not wanted <= found:
                line = await process.stdout.readline()
                if not line:
                    raise ProcessFailedError(
                        f"agent: its container ended with status {await process.wait()}"
                    )
                match json.loads(line):
                    case {
                        "component": "discoverer",
                        "report": {"event": "DISCOVERED", "agent": str(agent)},
                    }:
                        found.add(agent)
    return found


async def _look(outside: Host, pairs: Sequence[tuple[Deployment, Bundle]]) -> dict[int, list[str]]:
    """Return the DDS topics of all endpoints that are seen from outside, by domain."""
    domains = (pairs[0][0].network.global_domain, *(d.network.local_domain for d, _ in pairs))
    members = []
    for domain in dict.fromkeys(domains):
        address = BusAddress(domain_id=domain, interface=outside.interface)
        config = PeerConfig(name="onlooker", address=address)
        members.append(Member(name=str(domain), module="sfglab.lab.workers.peer", config=config))
    async with ProcessGroup(
        members, wrap_command=lambda _, command: outside.argv(command), start_s=MEETING_S
    ) as group:
        await asyncio.sleep(LOOKING_S)
        told = await group.ask("told", timeout_s=MEETING_S, do="tell")
    seen = {}
    for name, report in told.items():
        seen[int(name)] = sorted(topic for topic, *_ in report["endpoints"])
    return seen


def _meeting_row(names: Sequence[str], found: Sequence[set[str]]) -> CheckRow:
    alone = [name for name, met in zip(names, found, strict=True) if met != {*names} - {name}]
    met = f"{names[0]} met {', '.join(sorted(found[0]))}"
    example = f"{', '.join(alone)} met nobody" if alone else met
    return _row(
        "agents in containers discover each other through their routers", len(names), alone, example
    )


def _inside_row(pairs: Sequence[tuple[Deployment, Bundle]], seen: dict[int, list[str]]) -> CheckRow:
    shown = {d.agent.name: seen[d.network.local_domain] for d, _ in pairs}
    leaking = [str(entry) for entry in shown.items() if entry[1]]
    example = leaking[0] if leaking else "no endpoint in any agent's own domain"
    return _row(
        "an agent's own domain shows nothing outside its machine", len(shown), leaking, example
    )


def _row(check: str, checked: int, wrong: Sequence[str], example: str) -> CheckRow:
    return CheckRow(check=check, checked=checked, held=checked - len(wrong), example=example)


def _global_row(pairs: Sequence[tuple[Deployment, Bundle]], seen: dict[int, list[str]]) -> CheckRow:
    topics = seen[pairs[0][0].network.global_domain]
    local = [t for t in topics if not re.fullmatch(r"r[tqr]/(global/.*|tf|tf_static)", t)]
    wrong = local or ["no heartbeat"] * ("rt/global/agent_heartbeat" not in topics)
    example = local[0] if local else f"{len(topics)} endpoints, {len(set(topics))} names"
    check = "the global domain shows global names only, and the heartbeats among them"
    return _row(check, 1, wrong[:1], example)
