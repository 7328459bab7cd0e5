"""Agents of a fleet as Zenoh sessions of one process: ``python -m sfglab.lab.workers.zenoh_agents CONFIG``.

An agent has what its router has for discovery (`sfglab.fleet.router.presence`): a publisher and a subscription of the
heartbeats, and a queryable with its description; and the token of its node. Keys, attachments and heartbeats are
those of routers. Descriptions are 1,200 zeros. Unlike a router, an agent sends its first heartbeat only when ordered,
and does not query the description of each agent that it hears of.

Orders:

- ``open`` opens the sessions, one after the other. Report ``opened``.
- ``beat`` lets each agent of the fleet send one heartbeat within ``period_s`` from ``begin_ns`` on (Unix time, ns),
  evenly spread. Report ``beaten`` with the time ``t_ns`` of the last new heartbeat, and the number of ``missing``
  ones: those that an agent of the process has never received from another agent.
- ``fetch`` lets one agent get the descriptions of all agents. Report ``fetched`` with the number of ``replies``.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from dataclasses import dataclass
from typing import Any

from sfglab import __version__
from sfglab.bus.zenoh.layout import (
    ATTACHMENT,
    GID_BYTES,
    NODE,
    data_key,
    gid_of,
    token_text,
    wire_type,
)
from sfglab.bus.zenoh.session import ZenohConfig, direct
from sfglab.component import Orders, Reporter, run_component
from sfglab.fleet.status.heartbeat import (
    AGENT_HEARTBEAT,
    AGENT_METADATA,
    Heartbeat,
    Phase,
    heartbeat_topic,
    metadata_service,
)
from sfglab.messages import serialize
from sfglab.units import NS_PER_S

_DOMAIN = 0
DESCRIPTION_BYTES = 1200
_FETCH_S = 60.0  # longest wait for descriptions
_QUIET_S = 0.3  # time in which the last heartbeats arrive


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenohAgentsConfig:
    """Configuration of a process with agents."""

    hub: str  #: Zenoh endpoint of the router that all agents are clients of.
    numbers: tuple[int, ...]  #: Numbers of the agents of this process.
    fleet: int  #: Number of agents of the fleet.


class _Agent:
    """One session with its publisher, subscription, queryable and token."""

    def __init__(self, config: ZenohAgentsConfig, number: int) -> None:
        import zenoh

        self.number = number  #: Number of the agent.
        #: GIDs of the agents whose heartbeats arrived, its own included.
        self.known: set[bytes] = set()
        self.known_ns = 0  #: Time of the last heartbeat of a new agent (Unix time), ns.
        name = f"agent_{number:04d}"
        identity = format(secrets.randbits(127) | 1 << 127, "x")
        token = token_text(_DOMAIN, identity, 0, NODE, f"/{name}/router")
        self._gid = gid_of(token)
        message = Heartbeat(
            agent=name,
            incarnation=time.time_ns(),
            revision=0,
            phase=Phase.STARTUP,
            period_s=1.0,
            version=__version__,
        )
        self._heartbeat = serialize(message.to_message(time.time_ns()))
        heartbeats = data_key(_DOMAIN, heartbeat_topic(), wire_type(AGENT_HEARTBEAT))
        self._key = data_key(_DOMAIN, metadata_service(name), wire_type(AGENT_METADATA))
        self._every_key = self._key.replace(name, "*", 1)
        settings = ZenohConfig(domain_id=_DOMAIN, connect=(config.hub,)).json(identity)
        self._session = zenoh.open(zenoh.Config.from_json5(settings))
        self._publisher = self._session.declare_publisher(heartbeats)
        self._declared = (
            self._session.declare_subscriber(heartbeats, direct(self._hear)),
            self._session.declare_queryable(self._key, direct(self._answer)),
            self._session.liveliness().declare_token(token),
        )

    def beat(self) -> None:
        """Send a heartbeat."""
        attachment = ATTACHMENT.pack(1, time.time_ns(), GID_BYTES, self._gid)
        self._publisher.put(self._heartbeat, attachment=attachment)

    def fetch(self) -> int:
        """Get the descriptions of all agents, its own included, and return the number of received ones."""
        from zenoh import ConsolidationMode, QueryTarget

        replies = self._session.get(
            self._every_key,
            target=QueryTarget.ALL,
            consolidation=ConsolidationMode.NONE,
            timeout=_FETCH_S,
        )
        return sum(reply.ok is not None for reply in replies)

    def _hear(self, sample: Any) -> None:
        """Note the sender of a heartbeat, in a thread of Zenoh."""
        gid = sample.attachment.to_bytes()[-GID_BYTES:]
        if gid not in self.known:
            self.known.add(gid)
            self.known_ns = time.time_ns()

    def _answer(self, query: Any) -> None:
        """Answer a query for the description, in a thread of Zenoh."""
        with query:
            query.reply(self._key, bytes(DESCRIPTION_BYTES))


async def _until(begin_ns: int, after_s: float) -> None:
    """Wait until a time after another one (Unix time)."""
    await asyncio.sleep(max(0.0, (begin_ns - time.time_ns()) / NS_PER_S + after_s))


async def serve(config: ZenohAgentsConfig, report: Reporter, orders: Orders) -> None:
    """Follow orders until cancelled."""
    import zenoh  # noqa: F401 - loaded before the first order

    agents: list[_Agent] = []
    report({"is": "ready"})
    while True:
        order = await orders.get()
        if order["do"] == "open":
            agents += [_Agent(config, number) for number in config.numbers]
            report({"is": "opened"})
        elif order["do"] == "beat":
            for agent in agents:
                await _until(order["begin_ns"], agent.number / config.fleet * order["period_s"])
                agent.beat()
            await _until(order["begin_ns"], order["period_s"] + _QUIET_S)
            missing = [config.fleet - len(agent.known) for agent in agents]
            last_ns = max(agent.known_ns for agent in agents)
            report({"is": "beaten", "t_ns": last_ns, "missing": sum(missing)})
        else:
            report({"is": "fetched", "replies": await asyncio.to_thread(agents[0].fetch)})


if __name__ == "__main__":
    run_component(ZenohAgentsConfig, serve)
