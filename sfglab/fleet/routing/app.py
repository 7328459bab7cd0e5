"""The router as a process: `sfglab router`, or ``python -m sfglab.fleet.routing CONFIG``; see `component`.

Beside ``ready`` it reports ``{"is": "status", "paths": [...], "clashed": n}`` whenever paths change and every
five seconds; a path is a `PathStatus`. It does nothing else: a busy thread beside it would cost milliseconds.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.fleet.address import BusAddress
from sfglab.fleet.component import run_component
from sfglab.fleet.routing.lock import PairLock
from sfglab.fleet.routing.policy import Direction, ForwardRule
from sfglab.fleet.routing.router import Router, RouterSettings, RouterStatus

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.fleet.component import Report


class RouterConfigError(SfglabError, ValueError):
    """A router's configuration that no router could follow."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RouterConfig(RouterSettings):
    """What a router's process is told, beside what every router is."""

    local: BusAddress  #: The agent's domain.
    remote: BusAddress  #: The global domain.

    def __post_init__(self) -> None:
        RouterSettings.__post_init__(self)
        if self.local.domain_id == self.remote.domain_id:
            raise RouterConfigError(
                f"router of {self.agent}: given domain {self.local.domain_id} on both sides, allowed are two"
            )

    def to_json(self) -> str:
        """Return the configuration as a process's argument."""
        return json.dumps(asdict(self), default=_plain)

    @classmethod
    def from_json(cls, text: str) -> RouterConfig:
        """Read what `to_json` wrote.

        Raises:
            SfglabError: A name or a domain is not allowed.
        """
        values = json.loads(text)
        for side in ("local", "remote"):
            values[side] = BusAddress(**values[side])
        if "rules" in values:
            values["rules"] = tuple(_rule(rule) for rule in values["rules"])
        for name in {"shared_frames", "placed_by_others"} & values.keys():
            values[name] = tuple(values[name])
        return cls(**values)


async def run_router(config: RouterConfig, report: Callable[[Report], None]) -> None:
    """Run a router until cancelled; everything it started has ended when this returns.

    Args:
        config: Where and what.
        report: Takes its reports.

    Raises:
        RouterRunningError: This host has a router for these domains.
        BusError: A domain cannot be joined.
    """
    from sfglab.bus import Node
    from sfglab.bus.api import host_id

    def tell(status: RouterStatus) -> None:
        report({"is": "status", **asdict(status)})

    domains = config.local.domain_id, config.remote.domain_id
    with PairLock(*domains):
        async with (
            Node("router", **config.local.options()) as local,
            # Every agent has one, and in the global domain they meet.
            Node("router", namespace=f"/{config.agent}", **config.remote.options()) as remote,
        ):
            pair = f"{host_id()}/{config.local.domain_id}"
            router = Router(local, remote, config, pair=pair, on_status=tell)
            await router.run(on_ready=lambda: report({"is": "ready"}))


def main(argument: str) -> None:
    """Be the process: serve until standard input ends or until told to terminate."""

    async def body(report: Callable[[Report], None]) -> None:
        await run_router(RouterConfig.from_json(argument), report)

    run_component(body)


async def serve_terminal(config: RouterConfig, say: Callable[[str], None]) -> None:
    """Run a router for a person at a terminal, until interrupted or terminated.

    Args:
        config: Where and what.
        say: Takes a line for each path that begins or ceases to carry samples.

    Raises:
        RouterRunningError: This host has a router for these domains.
        BusError: A domain cannot be joined.
    """
    carrying: set[str] = set()

    def note(report: Report) -> None:
        if report["is"] == "ready":
            say("router: ready, end it with Ctrl-C")
            return
        before = set(carrying)
        complete = [path for path in report["paths"] if path["readers"] and path["writers"]]
        carrying.clear()
        carrying.update(f"{path['direction']} {path['topic']}" for path in complete)
        for name in sorted(carrying - before):
            say(f"{name}: open")
        for name in sorted(before - carrying):
            say(f"{name}: closed")

    running = asyncio.ensure_future(run_router(config, note))
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, running.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await running
    say("router: everything is released")


def _plain(value: Any) -> Any:
    """Return a rule's directions in JSON's terms."""
    return sorted(direction.value for direction in value)


def _rule(values: dict[str, Any]) -> ForwardRule:
    directions = frozenset(Direction(value) for value in values["directions"])
    return ForwardRule(pattern=values["pattern"], description=values["description"], directions=directions)
