"""Lines for the terminal about the reports of routers and decoders."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.component import run_until_interrupted
from sfglab.names import DdsRole, Resource, ros_name_from_dds

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from sfglab.component import Report, Reporter


class PathNarrator:
    """Lines about the paths of a router."""

    def __init__(self) -> None:
        self._open: frozenset[str] = frozenset()

    def lines(self, status: Report) -> list[str]:
        """Return a line for each path that was opened or closed since the last status."""
        paths = [path for path in status["paths"] if path["readers"] and path["writers"]]
        names = {_path(path["topic"], path["direction"]) for path in paths}
        before, self._open = self._open, frozenset(names - {""})
        opened = [f"{path} opened" for path in sorted(self._open - before)]
        return opened + [f"{path} closed" for path in sorted(before - self._open)]


class StreamNarrator:
    """Lines about the streams of a decoder."""

    def __init__(self) -> None:
        self._states: dict[str, str] = {}

    def lines(self, status: Report) -> list[str]:
        """Return a line if the state of a stream has changed since its last status."""
        topic, state = status["local_topic"], status["state"].lower()
        if self._states.get(topic) == state:
            return []
        self._states[topic] = state
        plural = "" if status["subscribers"] == 1 else "s"
        return [f"{topic} {state}, {status['subscribers']} subscriber{plural}"]


def _path(dds_topic: str, direction: str) -> str:
    """Return a path by its ROS name; empty for replies and for the queries of discovery."""
    wire = ros_name_from_dds(dds_topic)
    if wire is None:
        return f"{dds_topic} {direction}"
    quiet = wire.role is DdsRole.REPLY or wire.name.endswith(f"/{Resource.GET_METADATA.value}")
    return "" if quiet else f"{wire.name} {direction}"


async def serve_terminal(
    name: str,
    body: Callable[[Reporter], Coroutine[None, None, None]],
    narrator: PathNarrator | StreamNarrator,
    say: Callable[[str], None],
) -> None:
    """Run a component for a person at a terminal until interrupted, and print a line for each change.

    Args:
        name: Name of the component, with which lines begin.
        body: Runs the component, given the function that takes its reports.
        narrator: Describes the status of the component.
        say: Prints a line.
    """

    def note(report: Report) -> None:
        lines = ["ready, end it with Ctrl-C"] if report["is"] == "ready" else narrator.lines(report)
        for line in lines:
            say(f"{name}: {line}")

    await run_until_interrupted(body(note))
    say(f"{name}: everything is released")
