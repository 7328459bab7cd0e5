"""The processes of one part of the life-cycle experiment, and what they have been seen to do.

Knows how to order processes and to wait for what they report; refuses to know what is done to whom, and why.
"""

from __future__ import annotations

import asyncio
import base64
import time
from collections import Counter, defaultdict
from contextlib import AsyncExitStack
from typing import TYPE_CHECKING, Any, Self

from sfglab.fleet.discovery.listener import DISCOVERY_EVENT
from sfglab.fleet.status.heartbeat import AGENT_HEARTBEAT, Heartbeat, heartbeat_topic
from sfglab.lab.bench import Bench, as_row
from sfglab.messages import deserialize, message_type
from sfglab.processes import Member, ProcessFailedError, ProcessGroup

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from sfglab.component import Report

ASK_S = 60.0
STEP_S = 60.0


class Stage:
    """Processes whose reports go into the log, and what the script has to react to; an async context manager.

    On entering, the members start, and the one of them that is called ``first`` listens.

    Args:
        bench: Where the rows go, and the hosts.
        members: What is started on entering.

    Attributes:
        group: The processes.
        steady: How many heartbeats of the steady state the listener ``first`` has heard, by agent.
        moves: Reports of transitions, by remote agent.
    """

    def __init__(self, bench: Bench[Any], *members: Member) -> None:
        self.group = ProcessGroup(bench.testbed.argv, members, on_report=self._take)
        self.steady: Counter[str] = Counter()
        self.moves: defaultdict[str, list[Report]] = defaultdict(list)
        self._bench = bench
        self._changed = asyncio.Event()

    async def __aenter__(self) -> Self:
        async with AsyncExitStack() as stack:
            await stack.enter_async_context(self.group)
            await self.join("first")
            stack.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.group.close()

    async def until(self, what: str, fact: Callable[[], bool], *, timeout_s: float = STEP_S) -> None:
        """Return when a fact about what was reported holds.

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

    async def together(self, *parts: Coroutine[Any, Any, None]) -> None:
        """Return when parts that run at the same time have all ended; then raise the first error of one."""
        for outcome in await asyncio.gather(*parts, return_exceptions=True):
            if outcome is not None:
                raise outcome

    def fault(self, agent: str, what: str) -> None:
        """Write down what is done to an agent."""
        self._bench.write("fault", {"agent": agent, "what": what, "t_ns": time.time_ns()})

    async def join(self, listener: str) -> None:
        """Let a listener subscribe."""
        joined = await self._ask("joined", listener, do="join")
        self._bench.write("join", {"listener": listener, "t_ns": joined["t_ns"]})

    async def ask_metadata(self, agent: str, service: str) -> None:
        """Let the listener ``first`` call an agent's metadata service."""
        answer = await self._ask("answer", "first", timeout_s=ASK_S, do="ask", service=service)
        self._write("answer", answer, agent=agent)

    async def count(self, discoverer: str, must_hold: str) -> None:
        """Ask a discoverer for its counters until they hold what must be there, and write them down."""
        counts: dict[str, int] = {}
        while must_hold not in counts:
            await asyncio.sleep(0.05)
            counts = (await self._ask("status", discoverer, report=True))["counts"]
        for name, count in sorted(counts.items()):
            self._bench.write("count", {"discoverer": discoverer, "name": name, "count": count})

    async def _ask(self, kind: str, name: str, *, timeout_s: float = STEP_S, **order: Any) -> Report:
        return (await self.group.ask(kind, [name], timeout_s=timeout_s, **order))[name]

    def _take(self, name: str, report: Report) -> None:
        if report["is"] == "heard":
            self._hear(name, report)
        elif report["is"] == "publisher":
            self._write("endpoint", report)
        elif report["is"] == "move":
            self.moves[report["agent"]].append(report)
            actions = ";".join(report["actions"])
            self._write("move", report, at_ns=report["t_ns"], discoverer=name, actions=actions)
        elif report["is"] == "asked":
            self._write("query", report, at_ns=report["t_ns"])
        self._changed.set()

    def _hear(self, listener: str, report: Report) -> None:
        topic, cdr = report["topic"], base64.b64decode(report["cdr"])
        type_ = AGENT_HEARTBEAT if topic == heartbeat_topic() else DISCOVERY_EVENT
        if listener == "first":
            times = {"log_time_ns": report["received_ns"], "publish_time_ns": report["sent_ns"]}
            self._bench.log.write_raw(topic, type_, cdr, **times)
        if type_ == AGENT_HEARTBEAT:
            beat = Heartbeat.from_message(deserialize(cdr, message_type(type_)))
            self.steady[beat.agent] += beat.phase * (listener == "first")
            self._write("beat", report, beat, at_ns=report["received_ns"], listener=listener)

    def _write(self, table: str, *origins: Any, at_ns: int | None = None, **values: Any) -> None:
        row = as_row(self._bench.row_classes[table], values, *origins)
        self._bench.write(table, row, at_ns=at_ns)
