"""Life of one component of an agent as a table, and its process: started, tried again, ended and given up.

Paper A starts the agent's software by systemd and Docker Compose (section 4.4) and does not say what happens
after a crash; this table is ours, and the caller passes `now_ns` and carries the actions out. A component leads
a session of its own, so that an interrupt from the terminal reaches the agent alone and what it has started
ends with it. Only the agent holds the pipe of its standard input, so it ends when the agent is gone.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
from dataclasses import dataclass
from enum import Enum, auto
from typing import TYPE_CHECKING

from sfglab.component import BEATS_VARIABLE, Report
from sfglab.machine import ProcessLife, ProcessTiming

if TYPE_CHECKING:
    from collections.abc import Callable


class State(Enum):
    """Where a component stands."""

    NEW = auto()  #: Nothing has been started yet.
    STARTING = auto()  #: Its process runs and has not reported that it serves.
    RUNNING = auto()  #: It serves.
    REPLACING = auto()  #: It took too long to start and was told to end; another one follows.
    BACKING_OFF = auto()  #: It is gone; the next start waits.
    STOPPING = auto()  #: It was told to end for good.
    STOPPED = auto()  #: Nothing runs, as was wanted.
    FAILED = auto()  #: Nothing runs, and another try would not help.


REST = frozenset({State.STOPPED, State.FAILED})  #: Where a component's life ends.


class Input(Enum):
    """What can happen to a component."""

    BEGIN = auto()  #: The agent starts.
    READY = auto()  #: The process reports that it serves.
    ENDED = auto()  #: The process is gone, with everything it had started.
    #: It ended of its own accord before it had ever served: its configuration is wrong.
    REFUSED = auto()
    TIMER = auto()  #: The armed timer ran out.
    TOLD_TO_STOP = auto()  #: The agent is to end; said again, it is to end at once.


class Action(Enum):
    """What the caller has to do after a transition."""

    START = auto()  #: Start the process and arm the start timer.
    TERMINATE = auto()  #: Tell the process to end and arm the stop timer.
    KILL = auto()  #: The process does not end as told, or not soon enough: end it by force.
    BACK_OFF = auto()  #: Arm the back-off timer.
    GIVE_UP = auto()  #: End the agent: it cannot be what it was configured to be.
    CANCEL_TIMER = auto()  #: Nothing is waited for any more.


_S, _I, _A = State, Input, Action

TRANSITIONS: dict[tuple[State, Input], tuple[State, Action | None]] = {
    (_S.NEW, _I.BEGIN): (_S.STARTING, _A.START),
    (_S.NEW, _I.TOLD_TO_STOP): (_S.STOPPED, None),
    (_S.STARTING, _I.READY): (_S.RUNNING, _A.CANCEL_TIMER),
    (_S.STARTING, _I.ENDED): (_S.BACKING_OFF, _A.BACK_OFF),
    (_S.STARTING, _I.REFUSED): (_S.FAILED, _A.GIVE_UP),
    (_S.STARTING, _I.TIMER): (_S.REPLACING, _A.TERMINATE),
    (_S.STARTING, _I.TOLD_TO_STOP): (_S.STOPPING, _A.TERMINATE),
    # A component that reports that it serves when that is known, or when it was told to end, changes nothing.
    (_S.RUNNING, _I.READY): (_S.RUNNING, None),
    (_S.RUNNING, _I.ENDED): (_S.BACKING_OFF, _A.BACK_OFF),
    (_S.RUNNING, _I.TOLD_TO_STOP): (_S.STOPPING, _A.TERMINATE),
    (_S.REPLACING, _I.READY): (_S.REPLACING, None),
    (_S.REPLACING, _I.ENDED): (_S.BACKING_OFF, _A.BACK_OFF),
    (_S.REPLACING, _I.TIMER): (_S.REPLACING, _A.KILL),
    (_S.REPLACING, _I.TOLD_TO_STOP): (_S.STOPPING, None),
    (_S.BACKING_OFF, _I.TIMER): (_S.STARTING, _A.START),
    (_S.BACKING_OFF, _I.TOLD_TO_STOP): (_S.STOPPED, _A.CANCEL_TIMER),
    (_S.STOPPING, _I.READY): (_S.STOPPING, None),
    (_S.STOPPING, _I.ENDED): (_S.STOPPED, _A.CANCEL_TIMER),
    (_S.STOPPING, _I.TIMER): (_S.STOPPING, _A.KILL),
    (_S.STOPPING, _I.TOLD_TO_STOP): (_S.STOPPING, _A.KILL),
    (_S.STOPPED, _I.TOLD_TO_STOP): (_S.STOPPED, None),
    (_S.FAILED, _I.TOLD_TO_STOP): (_S.FAILED, None),
}
"""(state, input) -> (next state, action). What is not listed is illegal and changes nothing."""


class Supervision(ProcessLife[State, Input, Action]):
    """One component's state, its timer and its count of crashes; its name is for messages."""

    READY = Input.READY
    BACK_OFF = Action.BACK_OFF

    def __init__(self, name: str, timing: ProcessTiming) -> None:
        waits_ns = {Action.START: timing.start_ns, Action.TERMINATE: timing.stop_ns}
        super().__init__(name, TRANSITIONS, State.NEW, waits_ns=waits_ns, timing=timing)

    def ended(self, *, willingly: bool, now_ns: int) -> Action | None:
        """Take the end of a process as `Input.ENDED`, or `REFUSED` where another try would not help."""
        hopeless = willingly and self.state is State.STARTING and not self.was_ready
        return self.feed(Input.REFUSED if hopeless else Input.ENDED, now_ns=now_ns)


LINE_LIMIT_BYTES = 1 << 22
GROUP_GRACE_S = 1.0  #: How long what a component has started may outlive it: its pipes have ended.


@dataclass(frozen=True, slots=True, kw_only=True)
class Component:
    """One process of an agent."""

    name: str  #: What it is called in messages.
    argv: tuple[str, ...]  #: Program and arguments.


class ComponentProcess:
    """A running component: a process that leads its own session, with three pipes.

    `hear` takes its reports, ``{"is": "line", "line"}`` for a line on standard error or one that is no report,
    and at last, when all that it had started is gone, ``{"is": "ended", "status"}``: below zero, the signal.
    """

    def __init__(self, process: asyncio.subprocess.Process, hear: Callable[[Report], None]) -> None:
        self._process = process
        self._hear = hear
        self._listening = asyncio.create_task(self._listen())

    @classmethod
    async def start(cls, component: Component, hear: Callable[[Report], None]) -> ComponentProcess:
        """Start a component; `OSError` if the operating system cannot."""
        pipe = asyncio.subprocess.PIPE
        process = await asyncio.create_subprocess_exec(
            *component.argv,
            stdin=pipe,
            stdout=pipe,
            stderr=pipe,
            limit=LINE_LIMIT_BYTES,
            start_new_session=True,
            env=os.environ | {BEATS_VARIABLE: "1"},
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
        # Until its end was heard, somebody in the group lives, so that nobody else can have its number.
        if not self._listening.done():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.pid, signal.SIGKILL)

    async def destroy(self) -> None:
        """End it by force and wait until it is gone; nothing happens when it is."""
        self.kill()
        await self._listening

    async def _listen(self) -> None:
        words = asyncio.create_task(self._pass_on(self._process.stderr, _printed))
        await self._pass_on(self._process.stdout, _report_from_line)
        # Standard output is the component's own, so it has ended; standard error is shared by all it has
        # started and ends with the last of them.
        await asyncio.wait({words}, timeout=GROUP_GRACE_S)
        if not words.done():
            self.kill()
        await words
        self._hear({"is": "ended", "status": await self._process.wait()})

    async def _pass_on(
        self, stream: asyncio.StreamReader | None, value_from_line: Callable[[str], Report]
    ) -> None:
        assert stream is not None
        try:
            while line := await stream.readline():
                self._hear(value_from_line(line.decode(errors="replace").rstrip()))
        except ValueError:
            self._hear(
                _printed(f"a line of more than {LINE_LIMIT_BYTES} bytes; it is ended for that")
            )
            self.kill()


def _printed(line: str) -> Report:
    return {"is": "line", "line": line}


def _report_from_line(line: str) -> Report:
    try:
        report = json.loads(line)
    except ValueError:
        return _printed(line)
    own = isinstance(report, dict) and "is" in report and report["is"] not in ("line", "ended")
    return report if own else _printed(line)
