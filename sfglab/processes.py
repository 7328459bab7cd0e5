"""Processes of components, as their parent process sees them.

A process takes orders and writes reports, one JSON object per line. A report names its kind as ``is``. See
`sfglab.component` for the other side.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from sfglab.component import LINE_LIMIT_BYTES, Report, argument_of
from sfglab.errors import SfglabError
from sfglab.fields import to_json

if TYPE_CHECKING:
    from collections.abc import (
        AsyncIterator,
        Callable,
        Coroutine,
        Iterable,
        Iterator,
        Mapping,
        Sequence,
    )

START_LIMIT_S = 180.0  #: Time limit for the start of a group's member, s.
_NOTICE_S = 0.3


class ProcessFailedError(SfglabError, RuntimeError):
    """A process failed, ended, or did not report in time."""


# --- The client of one process --------------------------------------------------------------------------------


class LineProcess:
    """A process with piped standard input, for orders, and standard output, for reports.

    This class adds the last report, ``{"is": "ended", "status": ...}``. The status is the exit status, or the
    negative number of the signal that ended the process.
    """

    #: Whether reports wait for `expect`; if not, only `on_report` gets them.
    buffers_reports = True

    def __init__(
        self,
        name: str,
        process: asyncio.subprocess.Process,
        on_report: Callable[[Report], None] = lambda _: None,
    ) -> None:
        self.name = name  #: Name in messages.
        #: Function that is called with every report at once, also with those that `expect` returns.
        self.on_report = on_report
        self.readiness: Report = {}  #: Report that the process is ready; set by a `ProcessGroup`.
        self._process = process
        self._over: Report | None = None
        self._backlog: asyncio.Queue[Report] = asyncio.Queue()
        self._listening = asyncio.create_task(self._listen())

    @classmethod
    async def start(
        cls,
        name: str,
        argv: Sequence[str],
        *,
        on_report: Callable[[Report], None] = lambda _: None,
        limit_bytes: int = LINE_LIMIT_BYTES,
        **options: Any,
    ) -> Self:
        """Start a process; `options` are those of `asyncio.create_subprocess_exec`.

        Args:
            name: Name in messages.
            argv: Program and arguments.
            on_report: Called with every report.
            limit_bytes: Maximum size of a report, bytes.
            options: Such as `pass_fds`. Standard error is that of this process by default.

        Raises:
            OSError: The operating system cannot start the process.
        """
        pipe = asyncio.subprocess.PIPE
        process = await asyncio.create_subprocess_exec(
            *argv, stdin=pipe, stdout=pipe, limit=limit_bytes, **options
        )
        return cls(name, process, on_report)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def status(self) -> int | None:
        """Exit status, or the negative number of the signal that ended the process; None while it runs."""
        return self._process.returncode

    @property
    def unsent_bytes(self) -> int:
        """Number of bytes of orders that the process has not read yet."""
        assert self._process.stdin is not None
        return self._process.stdin.transport.get_write_buffer_size()

    def order(self, **values: Any) -> None:
        """Send an order with these values; without effect if the process has ended."""
        assert self._process.stdin is not None
        if self.status is None and not self._process.stdin.is_closing():
            self._process.stdin.write(json.dumps(to_json(values)).encode() + b"\n")

    async def expect(self, kind: str, *, timeout_s: float | None) -> Report:
        """Return the next report of a kind; earlier reports are dropped after `on_report` has received them.

        Args:
            kind: Kind of the report; ``ended`` waits for the end of the process.
            timeout_s: Time limit, s; None for no limit.

        Raises:
            ProcessFailedError: The process fails, ends, or does not report in time.
        """
        try:
            async with asyncio.timeout(timeout_s):
                while (report := await self._backlog.get())["is"] != kind:
                    self._raise_if_over(report)
        except TimeoutError:
            raise ProcessFailedError(
                f"{self.name}: it did not report {kind!r} within {timeout_s or 0:g} s"
            ) from None
        return report

    async def wait(self) -> int:
        """Wait for the end of the process, and return its exit status."""
        return await self._process.wait()

    def check(self) -> None:
        """Check that the process still runs.

        Raises:
            ProcessFailedError: The process has ended.
        """
        if self._over is not None:
            self._raise_if_over(self._over)

    def signal(self, number: signal.Signals) -> None:
        """Send a signal; without effect if the process has ended."""
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(number)

    def kill(self) -> None:
        """Kill the process; without effect if it has ended."""
        self.signal(signal.SIGKILL)

    async def close(self, *, grace_s: float = 5.0) -> None:
        """Close the standard input of the process and wait for its end; kill it after `grace_s` seconds."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(grace_s):
                    await self._process.wait()
        finally:
            self.kill()
        await self._listening

    def _raise_if_over(self, report: Report) -> None:
        if report["is"] == "failed":
            raise ProcessFailedError(f"{self.name}: {report['why']}")
        if report["is"] == "ended":
            self._backlog.put_nowait(report)  # another caller may wait for it
            raise ProcessFailedError(f"{self.name}: it ended with status {report['status']}")

    async def _listen(self) -> None:
        try:
            async for report in self._reports():
                self._take(report)
        except Exception:  # of `on_report`; `close` raises it
            self.kill()
            raise
        finally:
            self._take({"is": "ended", "status": await self._last_status()})

    async def _last_status(self) -> int:
        """Return the exit status once all processes have ended whose end is reported together."""
        return await self.wait()

    async def _reports(self) -> AsyncIterator[Report]:
        assert self._process.stdout is not None
        try:
            while line := await self._process.stdout.readline():
                yield self._report_of(line)
        except ValueError as error:
            self.kill()
            yield {"is": "failed", "why": str(error)}

    def _report_of(self, line: bytes) -> Report:
        """Return the report in a line.

        Raises:
            ValueError: The line is no report.
        """
        try:
            report = json.loads(line)
        except ValueError:
            report = None
        if not isinstance(report, dict) or "is" not in report:
            raise ValueError(f"given {line[:80]!r}, which is no report")
        return report

    def _take(self, report: Report) -> None:
        if report["is"] in ("failed", "ended"):
            self._over = self._over or report
        if self.buffers_reports:
            self._backlog.put_nowait(report)
        self.on_report(report)


# --- Unresponsive processes ----------------------------------------------------------------------------------

CHECK_PERIOD_S = 1.0  #: Period of the checks of a watched process, seconds.
#: Time without a beat after which a process is unresponsive, s; only time in which it could have reported counts.
HANG_S = 10.0
_STOPPED_COUNTS = 4.0  # a stopped process cannot be busy, so it is detected sooner
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


class Watchdog:
    """Watchdog that detects an unresponsive process: it was stopped, or its watchdog beats no longer arrive.

    Only the time in which the process could have reported a beat counts: while it ran, or slept although a beat
    was due. A process that waits for a CPU, or whose beats were read late, does not count as unresponsive.
    """

    def __init__(self) -> None:
        self._beats = False
        self._missed_s = 0.0
        self._cpu_s = 0.0

    def beat(self) -> None:
        """Record that the process has reported a watchdog beat."""
        self._beats, self._missed_s = True, 0.0

    def check(self, pid: int) -> str:
        """Check a process, once per `CHECK_PERIOD_S`; return why it is unresponsive, or an empty text."""
        try:
            fields = Path(f"/proc/{pid}/task/{pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return ""
        return self.check_state(fields[0], (int(fields[11]) + int(fields[12])) / _TICKS_PER_S)

    def check_state(self, state: str, cpu_s: float) -> str:
        """Check the main thread's state, as Linux names it, and CPU time, s; return as `check` does."""
        ran_s, self._cpu_s = cpu_s - self._cpu_s, cpu_s
        before_s = self._missed_s  # the beat of the latest period may not have been read yet
        if state == "T":
            self._missed_s += _STOPPED_COUNTS * CHECK_PERIOD_S
            return "it was stopped" if self._missed_s >= HANG_S else ""
        if not self._beats:
            self._missed_s = 0.0
            return ""
        self._missed_s += CHECK_PERIOD_S if state == "S" else min(ran_s, CHECK_PERIOD_S)
        return f"it gave no watchdog beat for {HANG_S:g} s" if before_s >= HANG_S else ""


# --- Groups of processes --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Member:
    """The start of a process of a group, as data."""

    name: str  #: Name in the group and in messages.
    module: str  #: Module, run as ``python -m MODULE CONFIG``.
    config: Any = None  #: Argument of the module: a dataclass or a text; None: no argument.
    host: str = ""  #: Host that the process runs on.
    ready: str = "ready"  #: Kind of the report with which the process announces that it serves.
    #: Launcher: module that is run instead, with module and configuration as its arguments.
    through: str = ""
    pass_fds: tuple[int, ...] = ()  #: File descriptors that the process inherits.

    @property
    def command(self) -> tuple[str, ...]:
        """Program and arguments."""
        modules = (self.through, self.module) if self.through else (self.module,)
        given = () if self.config is None else (argument_of(self.config),)
        return (sys.executable, "-m", *modules, *given)


class ProcessGroup:
    """Processes that are started and ended together: an async context manager.

    Entering starts all members at once and returns when each of them serves. Leaving ends them in the reverse
    order, and kills those that do not end. Each method that waits for a member raises a `ProcessFailedError` if
    the member fails, ends, or is late. The error names killed members.

    Args:
        members: Processes that entering starts.
        wrap_command: Function from a host and a command to the command line that runs it there; without it,
            all processes run on this host.
        on_report: Function that is called with the name of a member and each of its reports.
        start_s: Time limit for the start of a member, s.
    """

    def __init__(
        self,
        members: Iterable[Member] = (),
        *,
        wrap_command: Callable[[str, Sequence[str]], Sequence[str]] | None = None,
        on_report: Callable[[str, Report], None] = lambda _name, _report: None,
        start_s: float = START_LIMIT_S,
    ) -> None:
        self._wrap_command = wrap_command
        self._on_report = on_report
        self._start_s = start_s
        self._first = tuple(members)
        self._processes: dict[str, LineProcess] = {}

    async def __aenter__(self) -> Self:
        await self.start(*self._first)
        try:
            await self.settle()
        except BaseException:
            await self.close()
            raise
        return self

    async def settle(self) -> None:
        """Prepare the group after its first members serve. Subclasses override this; here it does nothing."""

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    def __getitem__(self, name: str) -> LineProcess:
        return self._processes[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._processes)

    async def start(self, *members: Member) -> None:
        """Start members at once and return when each serves. If one does not, all of them are ended."""
        try:
            for member in members:
                await self._launch(member)
            waits = {m.name: self[m.name].expect(m.ready, timeout_s=self._start_s) for m in members}
            for name, report in (await self._watched(waits)).items():
                self[name].readiness = report
        except BaseException:
            await self._end([member.name for member in members])
            raise

    async def kill(self, name: str) -> None:
        """Kill a member, wait for its end, and remove it from the group."""
        self[name].kill()
        await self._end([name])

    def order(self, names: Iterable[str] | None = None, **values: Any) -> None:
        """Send an order to the members with these names, by default to all."""
        for name in self if names is None else names:
            self._processes[name].order(**values)

    async def expect(
        self, kind: str, names: Iterable[str] | None = None, *, timeout_s: float | None
    ) -> dict[str, Report]:
        """Return the next report of a kind by member, by default of all; a time limit of None waits indefinitely."""
        chosen = self if names is None else names
        waits = {name: self[name].expect(kind, timeout_s=timeout_s) for name in chosen}
        return await self._watched(waits)

    async def ask(
        self,
        kind: str,
        names: Iterable[str] | None = None,
        *,
        timeout_s: float | None,
        **order: Any,
    ) -> dict[str, Report]:
        """Send an order to members, by default to all, and return the next report of a kind by member."""
        chosen = tuple(self if names is None else names)
        self.order(chosen, **order)
        return await self.expect(kind, chosen, timeout_s=timeout_s)

    def check(self) -> None:
        """Check that all members still run.

        Raises:
            ProcessFailedError: A member has ended.
        """
        for process in self._processes.values():
            process.check()

    async def close(self) -> None:
        """End all members; further calls have no effect."""
        await self._end(list(self))

    async def _end(self, names: Sequence[str]) -> None:
        """End those of these members that run, in the reverse order."""
        ended = [self._processes.pop(name) for name in reversed(names) if name in self._processes]
        await asyncio.gather(*(process.close() for process in ended))

    async def _launch(self, member: Member) -> None:
        def take(report: Report) -> None:
            self._on_report(member.name, report)

        assert member.name not in self._processes, f"there is a {member.name!r} already"
        argv: Sequence[str] = member.command
        if self._wrap_command is not None:
            argv = self._wrap_command(member.host, member.command)
        self._processes[member.name] = await LineProcess.start(
            member.name, argv, on_report=take, pass_fds=member.pass_fds
        )

    async def _watched(self, waits: Mapping[str, Coroutine[Any, Any, Report]]) -> dict[str, Report]:
        """Wait for reports at once. The first failure ends the other waits and is raised."""
        try:
            async with asyncio.TaskGroup() as group:
                tasks = {name: group.create_task(wait) for name, wait in waits.items()}
        except BaseExceptionGroup as failures:  # `except*` would wrap what is raised here
            error = failures.exceptions[0]
            if isinstance(error, ProcessFailedError):
                error = await self._with_killed(error)
            raise error from None
        return {name: task.result() for name, task in tasks.items()}

    async def _with_killed(self, error: ProcessFailedError) -> ProcessFailedError:
        """Return a failure with the names of killed members. A peer may notice their end earlier than the group."""
        await asyncio.sleep(_NOTICE_S)
        killed = [name for name, process in self._processes.items() if (process.status or 0) < 0]
        if not killed:
            return error
        return ProcessFailedError(f"{', '.join(killed)} killed by a signal; {error}")
