"""An agent's events as lines for a person at a terminal: few, and only what has changed.

Knows the reports that the components' documentation names; refuses to know where lines go.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.fleet.agent.events import Changed, Complete, Said, Wrote
from sfglab.fleet.agent.supervision import State
from sfglab.names import DdsRole, Resource, ros_name_from_dds

if TYPE_CHECKING:
    from sfglab.fleet.address import BusAddress
    from sfglab.fleet.agent.events import AgentEvent
    from sfglab.fleet.agent.plan import AgentConfig
    from sfglab.fleet.component import Report


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
