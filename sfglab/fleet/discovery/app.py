"""The discoverer as a process: ``python -m sfglab.fleet.discovery CONFIG``; see `component`.

Beside ``ready`` it reports every discovery event, ``{"is": "event", "agent", "event", "incarnation", "t_ns"}``,
and where the configuration asks for it every transition, ``{"is": "move", "agent", "before", "given", "after",
"actions", "t_ns"}``. The order ``{"report": true}`` is answered with what is known now: ``{"is": "status",
"agents": [...], "counts": {...}}``.
"""

from __future__ import annotations

import asyncio
import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from sfglab.fleet.address import BusAddress
from sfglab.fleet.component import run_component
from sfglab.fleet.discovery.node import AgentDiscoverer, DiscoverySettings
from sfglab.fleet.discovery.orders import Timing
from sfglab.fleet.discovery.screening import Limits

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.fleet.component import Report
    from sfglab.fleet.discovery.node import DiscoveryStatus
    from sfglab.fleet.discovery.orders import Announce, Move


@dataclass(frozen=True, slots=True, kw_only=True)
class DiscoveryConfig:
    """What a discoverer's process is told."""

    address: BusAddress  #: The agent's local domain.
    settings: DiscoverySettings  #: Whose discoverer it is, and how it works.
    report_moves: bool = False  #: Whether every transition is reported.

    def to_json(self) -> str:
        """Return the configuration as a process's argument."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> DiscoveryConfig:
        """Read what `to_json` wrote.

        Raises:
            SfglabError: The agent's name, a wait or a bound is not allowed.
        """
        values = json.loads(text)
        settings = values["settings"]
        settings["timing"], settings["limits"] = Timing(**settings["timing"]), Limits(**settings["limits"])
        values["address"], values["settings"] = BusAddress(**values["address"]), DiscoverySettings(**settings)
        return cls(**values)


async def run_discoverer(
    config: DiscoveryConfig, report: Callable[[Report], None], orders: asyncio.Queue[Report]
) -> None:
    """Run a discoverer until cancelled; everything it started has ended when this returns.

    Args:
        config: Where and how.
        report: Takes its reports.
        orders: Orders to it.

    Raises:
        BusError: The domain cannot be joined.
    """
    from sfglab.bus import Node

    async with Node("agent_discoverer", **config.address.options()) as node:
        now_ns = node.get_clock().now_ns

        def moved(move: Move) -> None:
            if config.report_moves:
                report(_move_report(move, now_ns()))

        discoverer = AgentDiscoverer(
            node,
            config.settings,
            on_event=lambda event: report(_event_report(event, now_ns())),
            on_move=moved,
        )
        obeying = asyncio.create_task(_obey(discoverer, report, orders))
        try:
            await discoverer.run(on_ready=lambda: report({"is": "ready"}))
        finally:
            obeying.cancel()
            await asyncio.gather(obeying, return_exceptions=True)


def main(argument: str) -> None:
    """Be the process: serve until standard input ends or until told to terminate."""
    orders: asyncio.Queue[Report] = asyncio.Queue()

    async def body(report: Callable[[Report], None]) -> None:
        await run_discoverer(DiscoveryConfig.from_json(argument), report, orders)

    run_component(body, on_order=orders.put_nowait)


async def _obey(
    discoverer: AgentDiscoverer, report: Callable[[Report], None], orders: asyncio.Queue[Report]
) -> None:
    while True:
        await orders.get()
        report(_status_report(discoverer.status()))


def _event_report(event: Announce, now_ns: int) -> Report:
    return {
        "is": "event",
        "agent": event.agent,
        "event": event.event,
        "incarnation": event.incarnation,
        "t_ns": now_ns,
    }


def _move_report(move: Move, now_ns: int) -> Report:
    return {
        "is": "move",
        "agent": move.agent,
        "before": move.before.name,
        "given": move.given.name,
        "after": move.after.name,
        "actions": [action.name for action in move.actions],
        "t_ns": now_ns,
    }


def _status_report(status: DiscoveryStatus) -> Report:
    agents = [{**asdict(agent), "state": agent.state.name} for agent in status.agents]
    return {"is": "status", "agents": agents, "counts": status.counts}
