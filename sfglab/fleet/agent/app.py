"""Agent of a fleet as a process: `sfglab agent up`, or ``python -m sfglab.fleet.agent.app CONFIG``.

A person at a terminal gets its events as few lines. The second form is for programs: it is a component as its
own components are (see `sfglab.component`), and reports ``ready`` once all of them have served, ``{"is":
"component", "component", "state", "pid", "crashes", "why", "retry_s"}`` for every change of one, ``{"is":
"report", "component", "report"}`` for what one reports, and ``{"is": "line", "component", "line"}`` for what
one writes on standard error.
"""

from __future__ import annotations

import asyncio
import json
import signal
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from sfglab.component import run_component
from sfglab.fleet.agent.plan import plan
from sfglab.fleet.agent.supervision import Component, State, Timing
from sfglab.fleet.agent.supervisor import Agent, Changed, Complete, Said, Wrote, report_from_event
from sfglab.names import DdsRole, Resource, ros_name_from_dds

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.address import BusAddress
    from sfglab.component import Report
    from sfglab.fleet.agent.plan import AgentConfig
    from sfglab.fleet.agent.supervisor import AgentEvent


class Narrator:
    """Tells events to a person.

    Args:
        config: What the agent is.
    """

    def __init__(self, config: AgentConfig) -> None:
        self._config = config
        self._paths: frozenset[str] = frozenset()
        self._streams: dict[str, str] = {}

    def beginning(self) -> str:
        """Return what is said first."""
        local, remote = _place(self._config.local), _place(self._config.remote)
        return f"agent {self._config.agent}: its own {local}, the global {remote}; starting"

    def end(self) -> str:
        """Return what is said last."""
        return f"agent {self._config.agent}: everything has ended"

    def lines(self, event: AgentEvent) -> list[str]:
        """Return what is worth saying of an event, a sentence a line."""
        if isinstance(event, Complete):
            return [f"agent {self._config.agent}: ready, end it with Ctrl-C"]
        if isinstance(event, Wrote):
            return [f"{event.component}: {event.line}"]
        words = self._of_report(event.report) if isinstance(event, Said) else _of_change(event)
        return [f"{event.component}: {word}" for word in words]

    def _of_report(self, report: Report) -> list[str]:
        if report["is"] == "event":
            return [f"{report['agent']} {report['event'].lower()}"]
        if report["is"] == "status" and "paths" in report:
            return self._of_paths(report["paths"])
        if report["is"] == "status" and "local_topic" in report:
            return self._of_stream(report)
        return []

    def _of_paths(self, paths: list[Report]) -> list[str]:
        told = (_path(path["topic"], path["direction"]) for path in paths)
        before, self._paths = self._paths, frozenset(path for path in told if path)
        opened = [f"{path} opened" for path in sorted(self._paths - before)]
        return opened + [f"{path} closed" for path in sorted(before - self._paths)]

    def _of_stream(self, report: Report) -> list[str]:
        topic, state = report["local_topic"], report["state"].lower()
        if self._streams.get(topic) == state:
            return []
        self._streams[topic] = state
        who = f"{report['subscribers']} subscriber{'' if report['subscribers'] == 1 else 's'}"
        return [f"{topic} {state}, {who}"]


def _of_change(event: Changed) -> list[str]:
    if event.state is State.RUNNING and event.crashes:
        times = "a crash" if event.crashes == 1 else f"{event.crashes} crashes"
        return [f"ready again after {times}"]
    if event.state is State.BACKING_OFF:
        return [f"crashed ({event.why}); it is started again in {event.retry_s:.1f} s"]
    if event.state is State.REPLACING:
        return [f"{event.why}; it is ended and started again"]
    return ["ready"] if event.state is State.RUNNING else []


def _path(dds_topic: str, direction: str) -> str:
    """Return a path by its name in ROS; empty for replies, and for the queries that discovery makes."""
    wire = ros_name_from_dds(dds_topic)
    if wire is None:
        return f"{dds_topic} {direction}"
    quiet = wire.role is DdsRole.REPLY or wire.name.endswith(f"/{Resource.GET_METADATA.value}")
    return "" if quiet else f"{wire.name} {direction}"


def _place(address: BusAddress) -> str:
    return f"domain {address.domain_id}" + (f" on {address.interface}" if address.interface else "")


@dataclass(frozen=True, slots=True, kw_only=True)
class SupervisorConfig:
    """What an agent's process is told: the result of `plan`."""

    components: tuple[Component, ...]  #: The processes to run.
    timing: Timing = field(default_factory=Timing)  #: The waits of every component.

    @classmethod
    def of_agent(cls, config: AgentConfig) -> SupervisorConfig:
        """Return what the process of an agent is told.

        Raises:
            SfglabError: The agent could not be run as it is described.
        """
        return cls(components=plan(config), timing=config.supervision)


async def serve_agent(config: AgentConfig, say: Callable[[str], None], *, as_json: bool = False) -> None:
    """Run an agent for a person at a terminal, until interrupted, hung up or terminated; twice ends it at once.

    Args:
        config: What the agent is.
        say: Takes a line for everything that a person should know.
        as_json: The lines are JSON reports instead, and there are more of them.

    Raises:
        SfglabError: The agent could not be run as it is described.
        ComponentError: A component ended of its own accord before it had ever served.
    """
    narrator = Narrator(config)

    def tell(event: AgentEvent) -> None:
        for line in [json.dumps(report_from_event(event))] if as_json else narrator.lines(event):
            say(line)

    agent = Agent(plan(config), timing=config.supervision, on_event=tell)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        asyncio.get_running_loop().add_signal_handler(number, agent.stop)
    if not as_json:
        say(narrator.beginning())
    await agent.run()
    if not as_json:
        say(narrator.end())


async def _serve(config: SupervisorConfig, report: Callable[[Report], None], _: asyncio.Queue[Report]) -> None:
    agent = Agent(
        config.components, timing=config.timing, on_event=lambda event: report(report_from_event(event))
    )
    await agent.run()


def main() -> None:
    """Be the process: serve until told to end."""
    run_component(SupervisorConfig, _serve)


if __name__ == "__main__":
    main()
