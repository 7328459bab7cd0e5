"""Hosts and processes of the life-cycle experiment, and what the discoverer has been seen to do.

Knows how to start, order and end processes; refuses to know what is done to whom, and why.
"""

from __future__ import annotations

import asyncio
import base64
import sys
import time
from typing import TYPE_CHECKING, Any, TypeVar

from sfglab.bus.address import BusAddress
from sfglab.lab.experiments.lifecycle.rows import BeatRow, FaultRow, MoveRow, QueryRow
from sfglab.lab.staging import Staged
from sfglab.processes import LineProcess, ProcessFailedError

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from sfglab.lab.testbed import Testbed
    from sfglab.record import LogWriter


GLOBAL_DOMAIN = 0
LOOPBACK_DOMAIN = 93
"""Stands for the global domain where all hosts are one, and other runs may be using domain 0."""

FIRST_LOCAL_DOMAIN = 94
"""The domain of the first agent behind a router; on the loopback interface of its host."""

START_S = 30.0
STEP_S = 15.0

Report = dict[str, Any]
T = TypeVar("T")


async def together(*parts: Awaitable[T]) -> list[T]:
    """Return the results of parts that run at the same time, when the last of them has ended.

    Raises:
        Exception: The first that one of them raised; by then none of them runs any more.
    """
    results = await asyncio.gather(*parts, return_exceptions=True)
    for result in results:
        if isinstance(result, BaseException):
            raise result
    return [result for result in results if not isinstance(result, BaseException)]


class Crew(Staged):
    """The processes of a run on the hosts of a testbed; an async context manager that ends them.

    Args:
        testbed: The hosts.
    """

    def __init__(self, testbed: Testbed) -> None:
        super().__init__()
        self._testbed = testbed
        self._members: list[LineProcess] = []

    async def _start(self) -> None:
        self._stack.push_async_callback(self._close)

    async def _close(self) -> None:
        await asyncio.gather(*(member.close() for member in self._members))

    def address(self, host: str) -> BusAddress:
        """Return where on the bus a host stands: in the domain that all share."""
        domain_id = GLOBAL_DOMAIN if self._testbed.separate else LOOPBACK_DOMAIN
        return BusAddress(domain_id=domain_id, interface=self._testbed.interface(host))

    def local_address(self, number: int) -> BusAddress:
        """Return the domain of the agent with this number, counted from 0, on its own host."""
        return BusAddress(domain_id=FIRST_LOCAL_DOMAIN + number, interface="lo")

    async def start(
        self, host: str, module: str, config: str, on_report: Callable[[Report], None]
    ) -> LineProcess:
        """Start a module of ours on a host, and return it when it serves.

        Args:
            host: Where.
            module: What.
            config: Its argument.
            on_report: Called with every further report.

        Raises:
            ProcessFailedError: It fails or does not serve in time.
        """
        argv = self._testbed.argv(host, [sys.executable, "-m", module, config])
        process = await LineProcess.start(f"{module.rpartition('.')[2]} on {host}", argv, on_report=on_report)
        try:
            await process.expect("ready", timeout_s=START_S)
        except BaseException:
            await process.close()
            raise
        self._members.append(process)
        return process


class Seen:
    """What has been reported, to be waited for."""

    def __init__(self) -> None:
        self._changed = asyncio.Event()

    def notify(self) -> None:
        """Let those who wait look again."""
        self._changed.set()

    async def until(self, what: str, fact: Callable[[], bool], *, timeout_s: float = STEP_S) -> None:
        """Return when a fact holds.

        Raises:
            ProcessFailedError: It does not in time.
        """
        try:
            async with asyncio.timeout(timeout_s):
                while not fact():
                    self._changed.clear()
                    await self._changed.wait()
        except TimeoutError:
            raise ProcessFailedError(f"{what}: not within {timeout_s:g} s") from None


class Recorder:
    """Writes reports into the log and keeps what the script has to react to.

    Args:
        log: The log.

    Attributes:
        seen: Told of everything that was kept.
        beats: Heartbeats by listener and agent.
        moves: Transitions by remote agent.
        joined_ns: When listeners joined.
        replies: Answers to orders, not yet fetched.
    """

    def __init__(self, log: LogWriter) -> None:
        self.seen = Seen()
        self.beats: dict[tuple[str, str], list[BeatRow]] = {}
        self.moves: dict[str, list[MoveRow]] = {}
        self.joined_ns: dict[str, int] = {}
        self.replies: list[Report] = []
        self._log = log

    def row(self, table: str, row: Any, t_ns: int | None = None) -> None:
        """Write a row, by default with the present time."""
        self._log.write_row(table, row, log_time_ns=time.time_ns() if t_ns is None else t_ns)

    def fault(self, agent: str, what: str) -> None:
        """Write down what is done to an agent."""
        self.row("fault", FaultRow(agent=agent, what=what, t_ns=time.time_ns()))

    def wire(self, listener: str, types: dict[str, str]) -> Callable[[Report], None]:
        """Return what takes a listener's reports."""
        from sfglab.fleet.status.heartbeat import AGENT_HEARTBEAT, Heartbeat
        from sfglab.messages import deserialize, message_type

        def take(report: Report) -> None:
            if report["is"] == "heard":
                type_, cdr = types[report["topic"]], base64.b64decode(report["cdr"])
                times = {"log_time_ns": report["received_ns"], "publish_time_ns": report["sent_ns"]}
                if listener == "first":
                    self._log.write_raw(report["topic"], type_, cdr, **times)
                if type_ == AGENT_HEARTBEAT:
                    beat = Heartbeat.from_message(deserialize(cdr, message_type(type_)))
                    self._beat(listener, beat, report)
            elif report["is"] == "joined":
                self.joined_ns[listener] = report["t_ns"]
            elif report["is"] not in ("ready", "ended"):
                self.replies.append(report)
            self.seen.notify()

        return take

    def discoverer(self, name: str) -> Callable[[Report], None]:
        """Return what takes a discoverer's reports."""

        def take(report: Report) -> None:
            if report["is"] == "move":
                values = {k: v for k, v in report.items() if k not in ("is", "actions")}
                move = MoveRow(discoverer=name, actions=";".join(report["actions"]), **values)
                self.moves.setdefault(move.agent, []).append(move)
                self.row("move", move, move.t_ns)
            elif report["is"] == "status":
                self.replies.append(report)
            self.seen.notify()

        return take

    def fakes(self, report: Report) -> None:
        """Take the false agents' reports."""
        if report["is"] == "asked":
            self.row("query", QueryRow(agent=report["agent"], t_ns=report["t_ns"]), report["t_ns"])

    def _beat(self, listener: str, beat: Any, report: Report) -> None:
        row = BeatRow(
            listener=listener,
            agent=beat.agent,
            incarnation=beat.incarnation,
            revision=beat.revision,
            phase=beat.phase,
            period_s=beat.period_s,
            sent_ns=report["sent_ns"],
            received_ns=report["received_ns"],
            gid=report["gid"],
        )
        self.beats.setdefault((listener, beat.agent), []).append(row)
        self.row("beat", row, row.received_ns)
