"""Life cycle of one component of an agent as a table, and its process.

Paper A starts the agent's software with systemd and Docker Compose (section 4.4) and does not describe what
happens after a crash. The table is sfglab's; the caller passes `now_ns` and executes the actions. A
component leads a POSIX session of its own. An interrupt from the terminal therefore reaches the agent only, and
all descendants of the component end with it. Only the agent holds the pipe of its standard input, so the
component ends with the agent.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from dataclasses import dataclass
from enum import Enum, auto
from typing import TYPE_CHECKING

from sfglab.component import BEATS_VARIABLE, Report
from sfglab.machine import ProcessLife, ProcessTiming, transitions
from sfglab.processes import LineProcess

if TYPE_CHECKING:
    from collections.abc import Callable


class State(Enum):
    """State of a component."""

    NEW = auto()  #: Nothing has been started yet.
    STARTING = auto()  #: The process runs and has not reported yet that it serves.
    RUNNING = auto()  #: The process serves.
    #: The process took too long to start and was terminated; another one follows.
    REPLACING = auto()
    BACKING_OFF = auto()  #: The process is gone; the next start waits.
    STOPPING = auto()  #: The process was terminated and is not restarted.
    STOPPED = auto()  #: Nothing runs, as requested.
    FAILED = auto()  #: Nothing runs, and a restart would not help.


REST = frozenset({State.STOPPED, State.FAILED})  #: Final states.


class Input(Enum):
    """Input of the life cycle: an event of a component."""

    BEGIN = auto()  #: The agent starts.
    READY = auto()  #: The process reports that it serves.
    ENDED = auto()  #: The process is gone, with everything it had started.
    #: The process ended of its own accord before it had ever served: its configuration is wrong.
    REFUSED = auto()
    TIMER = auto()  #: The armed timer ran out.
    TOLD_TO_STOP = auto()  #: The agent is to end; a second time: it is to end at once.


class Action(Enum):
    """Action that the caller executes after a transition."""

    START = auto()  #: Start the process and arm the start timer.
    TERMINATE = auto()  #: Tell the process to end and arm the stop timer.
    KILL = auto()  #: End the process by force, because it did not end when told to.
    BACK_OFF = auto()  #: Arm the back-off timer.
    GIVE_UP = auto()  #: End the agent, because a component cannot run as configured.
    CANCEL_TIMER = auto()  #: Disarm the timer.


TRANSITIONS = transitions(
    State,
    Input,
    Action,
    """
    NEW          BEGIN         STARTING     START
    NEW          TOLD_TO_STOP  STOPPED

    STARTING     READY         RUNNING      CANCEL_TIMER
    STARTING     ENDED         BACKING_OFF  BACK_OFF
    STARTING     REFUSED       FAILED       GIVE_UP
    STARTING     TIMER         REPLACING    TERMINATE
    STARTING     TOLD_TO_STOP  STOPPING     TERMINATE

    RUNNING      READY         RUNNING
    RUNNING      ENDED         BACKING_OFF  BACK_OFF
    RUNNING      TOLD_TO_STOP  STOPPING     TERMINATE

    REPLACING    READY         REPLACING
    REPLACING    ENDED         BACKING_OFF  BACK_OFF
    REPLACING    TIMER         REPLACING    KILL
    REPLACING    TOLD_TO_STOP  STOPPING

    BACKING_OFF  TIMER         STARTING     START
    BACKING_OFF  TOLD_TO_STOP  STOPPED      CANCEL_TIMER

    STOPPING     READY         STOPPING
    STOPPING     ENDED         STOPPED      CANCEL_TIMER
    STOPPING     TIMER         STOPPING     KILL
    STOPPING     TOLD_TO_STOP  STOPPING     KILL

    STOPPED      TOLD_TO_STOP  STOPPED

    FAILED       TOLD_TO_STOP  FAILED
    """,
)
"""State, input, next state, and the action; all other inputs are illegal and change nothing.

A component that reports again that it serves, or after the order to end, changes nothing.
"""


class Supervision(ProcessLife[State, Input, Action]):
    """State, timer and number of crashes of one component; messages contain its name."""

    READY = Input.READY
    BACK_OFF = Action.BACK_OFF

    def __init__(self, name: str, timing: ProcessTiming) -> None:
        waits_ns = {Action.START: timing.start_ns, Action.TERMINATE: timing.stop_ns}
        super().__init__(name, TRANSITIONS, State.NEW, waits_ns=waits_ns, timing=timing)

    def end(self, *, willingly: bool) -> Input:
        """Return the input that the end of a process is: `REFUSED` where a restart would not help."""
        hopeless = willingly and self.state is State.STARTING and not self.was_ready
        return Input.REFUSED if hopeless else Input.ENDED


@dataclass(frozen=True, slots=True, kw_only=True)
class Component:
    """One process of an agent."""

    name: str  #: Name in messages.
    argv: tuple[str, ...]  #: Program and arguments.


#: Time for which descendants of a component may outlive it, s; they are then ended by force.
GROUP_GRACE_S = 1.0


class ComponentProcess(LineProcess):
    """A running component, which leads a POSIX session of its own.

    It also reports ``{"is": "line", "line": ...}`` for a line on standard error, and for a line on standard
    output that is no report. Its end is reported after the end of all its descendants.
    """

    buffers_reports = False

    @classmethod
    async def launch(
        cls, component: Component, on_report: Callable[[Report], None]
    ) -> ComponentProcess:
        """Start a component and return its process.

        Args:
            component: The component.
            on_report: Called with each report of the process.

        Raises:
            OSError: The operating system cannot start the process.
        """
        return await cls.start(
            component.name,
            component.argv,
            on_report=on_report,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=True,
            env=os.environ | {BEATS_VARIABLE: "1"},
        )

    def __init__(
        self,
        name: str,
        process: asyncio.subprocess.Process,
        on_report: Callable[[Report], None] = lambda _: None,
    ) -> None:
        super().__init__(name, process, on_report)
        self._errors = asyncio.create_task(self._read_errors())

    def kill(self) -> None:
        """End the component and all its descendants by force."""
        # Until the end is reported, a process of the group lives. Therefore no other group has its number.
        if not self._listening.done():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.pid, signal.SIGKILL)

    async def _last_status(self) -> int:
        # The end of standard output means the end of the component itself. All its descendants share
        # standard error, which ends with the last of them.
        await asyncio.wait({self._errors}, timeout=GROUP_GRACE_S)
        if not self._errors.done():
            self.kill()
        await self._errors
        return await self.wait()

    async def _read_errors(self) -> None:
        assert self._process.stderr is not None
        try:
            while line := await self._process.stderr.readline():
                self._take(_line_report(line))
        except ValueError as error:  # a line that exceeds the limit
            self._take({"is": "failed", "why": str(error)})
            self.kill()

    def _report_of(self, line: bytes) -> Report:
        try:
            return super()._report_of(line)
        except ValueError:
            return _line_report(line)


def _line_report(line: bytes) -> Report:
    return {"is": "line", "line": line.decode(errors="replace").rstrip()}
