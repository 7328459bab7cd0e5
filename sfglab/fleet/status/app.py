"""The status provider as a process: ``python -m sfglab.fleet.status CONFIG``; see `component`.

Beside ``ready`` it reports every heartbeat, ``{"is": "beat", "revision", "phase", "period_s", "t_ns"}``, where
the configuration asks for it. The order ``{"description": {...}}`` replaces the description; one that is of no
use is answered with ``{"is": "refused", "why"}``.
"""

from __future__ import annotations

import asyncio
import json
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from sfglab.fleet.address import BusAddress
from sfglab.fleet.component import run_component
from sfglab.fleet.status.description import AgentDescription, DescriptionError
from sfglab.fleet.status.hardware import accelerators, software
from sfglab.fleet.status.provider import StatusProvider, StatusSettings
from sfglab.fleet.status.schedule import Schedule

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.fleet.component import Report
    from sfglab.fleet.status.heartbeat import Heartbeat


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusConfig:
    """What a status provider's process is told."""

    address: BusAddress  #: The agent's local domain.
    settings: StatusSettings  #: What is said, and when.
    #: Whether software and accelerators are found out, in place of those described. Trying the accelerators
    #: takes a while; heartbeats do not wait for it, the description is updated.
    detect: bool = True
    report_beats: bool = False  #: Whether every heartbeat is reported.

    def to_json(self) -> str:
        """Return the configuration as a process's argument."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> StatusConfig:
        """Read what `to_json` wrote.

        Raises:
            SfglabError: An agent's name, a description or a schedule is not allowed.
        """
        values = json.loads(text)
        settings = values["settings"]
        settings["description"] = AgentDescription.from_values(settings["description"])
        settings["schedule"] = Schedule(**settings["schedule"])
        values["address"], values["settings"] = BusAddress(**values["address"]), StatusSettings(**settings)
        return cls(**values)


async def run_status(
    config: StatusConfig, report: Callable[[Report], None], orders: asyncio.Queue[Report]
) -> None:
    """Run a status provider until cancelled; everything it started has ended when this returns.

    Args:
        config: Where and what.
        report: Takes its reports.
        orders: Orders to it.

    Raises:
        BusError: The domain cannot be joined.
    """
    from sfglab.bus import Node

    settings = config.settings
    if config.detect:
        settings = replace(settings, description=replace(settings.description, software=software()))
    async with Node("agent_status_provider", **config.address.options()) as node:

        def beat(heartbeat: Heartbeat) -> None:
            if config.report_beats:
                report(_beat_report(heartbeat, node.get_clock().now_ns()))

        provider = StatusProvider(node, settings, on_beat=beat)
        others = [asyncio.create_task(_obey(provider, report, orders))]
        if config.detect:
            others.append(asyncio.create_task(_detect(provider)))
        try:
            await provider.run(on_ready=lambda: report({"is": "ready"}))
        finally:
            for task in others:
                task.cancel()
            await asyncio.gather(*others, return_exceptions=True)


def main(argument: str) -> None:
    """Be the process: serve until standard input ends or until told to terminate."""
    orders: asyncio.Queue[Report] = asyncio.Queue()

    async def body(report: Callable[[Report], None]) -> None:
        await run_status(StatusConfig.from_json(argument), report, orders)

    run_component(body, on_order=orders.put_nowait)


async def _obey(
    provider: StatusProvider, report: Callable[[Report], None], orders: asyncio.Queue[Report]
) -> None:
    while True:
        order = await orders.get()
        try:
            provider.update(AgentDescription.from_values(order.get("description", {})))
        except DescriptionError as error:
            report({"is": "refused", "why": str(error)})


async def _detect(provider: StatusProvider) -> None:
    found = await asyncio.to_thread(accelerators)
    if found != provider.description.accelerators:
        provider.update(replace(provider.description, accelerators=found))


def _beat_report(heartbeat: Heartbeat, now_ns: int) -> dict[str, Any]:
    return {
        "is": "beat",
        "revision": heartbeat.revision,
        "phase": int(heartbeat.phase),
        "period_s": heartbeat.period_s,
        "t_ns": now_ns,
    }
