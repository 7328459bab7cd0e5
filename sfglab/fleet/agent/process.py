"""One component's process and whatever it starts: how it is started, heard and brought to an end.

A component leads a session of its own, so that an interrupt from the terminal reaches the agent alone, and so
that the processes it has started can be ended with it. Its standard input is a pipe that only the agent holds:
when the agent is gone, however it went, the input ends and the component with it. Knows processes, pipes and
lines; refuses to know when a component should run.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.fleet.agent.plan import Component


LINE_LIMIT_BYTES = 1 << 22
GROUP_GRACE_S = 1.0
"""How long what a component has started may outlive it: its pipes have ended, so it should go by itself."""


@dataclass(frozen=True, slots=True)
class Reported:
    """A report on standard output: one JSON object."""

    values: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Printed:
    """A line on standard error, or what should have been a report and is none."""

    line: str


@dataclass(frozen=True, slots=True)
class Ended:
    """The process is gone, and so is everything it had started."""

    status: int  #: Its exit status; below zero, the signal that ended it.


Heard = Reported | Printed | Ended


class ComponentProcess:
    """A running component.

    Args:
        process: The process, leader of its own session, with three pipes.
        hear: Takes everything that is heard of it; `Ended` is the last.
    """

    def __init__(self, process: asyncio.subprocess.Process, hear: Callable[[Heard], None]) -> None:
        self._process = process
        self._hear = hear
        self._listening = asyncio.create_task(self._listen())

    @classmethod
    async def start(cls, component: Component, hear: Callable[[Heard], None]) -> ComponentProcess:
        """Start a component.

        Raises:
            OSError: The operating system cannot.
        """
        pipe = asyncio.subprocess.PIPE
        process = await asyncio.create_subprocess_exec(
            *component.argv,
            stdin=pipe,
            stdout=pipe,
            stderr=pipe,
            limit=LINE_LIMIT_BYTES,
            start_new_session=True,
        )
        return cls(process, hear)

    @property
    def pid(self) -> int:
        """Its process id, which is its session's and process group's too."""
        return self._process.pid

    def terminate(self) -> None:
        """Tell it to end; it ends what it has started."""
        with contextlib.suppress(ProcessLookupError):
            self._process.terminate()

    def kill(self) -> None:
        """End it and what it has started by force."""
        # Until `Ended` was heard, somebody in the group lives, so that nobody else can have its number.
        if not self._listening.done():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.pid, signal.SIGKILL)

    async def destroy(self) -> None:
        """End it by force and wait until it is gone; nothing happens when it is."""
        self.kill()
        await self._listening

    async def _listen(self) -> None:
        words = asyncio.create_task(self._pass_on(self._process.stderr, Printed))
        await self._pass_on(self._process.stdout, _report_from_line)
        # Standard output is the component's own, so it has ended; standard error is shared by all it has
        # started and ends with the last of them.
        await asyncio.wait({words}, timeout=GROUP_GRACE_S)
        if not words.done():
            self.kill()
        await words
        self._hear(Ended(await self._process.wait()))

    async def _pass_on(
        self, stream: asyncio.StreamReader | None, value_from_line: Callable[[str], Heard]
    ) -> None:
        assert stream is not None
        try:
            while line := await stream.readline():
                self._hear(value_from_line(line.decode(errors="replace").rstrip()))
        except ValueError:
            self._hear(Printed(f"a line of more than {LINE_LIMIT_BYTES} bytes; it is ended for that"))
            self.kill()


def _report_from_line(line: str) -> Heard:
    try:
        values = json.loads(line)
    except ValueError:
        return Printed(line)
    return Reported(values) if isinstance(values, dict) and "is" in values else Printed(line)
