"""The command `sfglab agent up`, which runs the components of an agent and prints what happens to them.

The module is an I/O wrapper of `supervision`. One task handles one event after the other. `Narrator` turns
the reports of an agent into a few lines for a person. With ``--json`` the command prints the reports:

- ``{"is": "ready"}``, once when all components have served,
- ``{"is": "component", "component", "state", "pid", "crashes", "why", "retry_s"}``, for every change of a
  component: the end of its process or the event that it waits for, and the wait before the next start,
- ``{"is": "report", "component", "report"}``, for every other report of a component,
- ``{"is": "line", "component", "line"}``, for every line that a component writes on standard error.
"""

from __future__ import annotations

import asyncio
import json
import signal
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from sfglab.bus.address import BusAddress
from sfglab.component import Report, beside, next_before, on_stop, steady_ns
from sfglab.errors import SfglabError
from sfglab.fleet.agent.plan import AgentConfig, plan
from sfglab.fleet.agent.supervision import (
    REST,
    Action,
    Component,
    ComponentProcess,
    Input,
    State,
    Supervision,
)
from sfglab.fleet.narration import PathNarrator, StreamNarrator
from sfglab.machine import ProcessTiming
from sfglab.processes import CHECK_PERIOD_S, Watchdog

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Sequence

    from sfglab.bus.zenoh.address import ZenohAddress


class ComponentError(SfglabError, RuntimeError):
    """A component cannot start as it is configured."""

    def __init__(self, component: str, why: str) -> None:
        self.component = component  #: Name of the component.
        self.why = why  #: Report of the component, or the way in which it ended.
        super().__init__(why if why.startswith(component) else f"{component}: {why}")


@dataclass(slots=True)
class _Unit:
    """Component with its life cycle, and its process while one runs."""

    component: Component
    life: Supervision
    process: ComponentProcess | None = None
    # reason that the process reported, or the way in which it became unresponsive
    failure: str = ""
    watchdog: Watchdog = field(default_factory=Watchdog)

    @property
    def name(self) -> str:
        return self.component.name


class Agent:
    """Supervised components of one agent; `on_report` is called with every report of the agent."""

    def __init__(
        self,
        components: Sequence[Component],
        *,
        timing: ProcessTiming | None = None,
        on_report: Callable[[Report], None] = lambda _: None,
    ) -> None:
        timing = timing or ProcessTiming()
        self._units = [_Unit(c, Supervision(c.name, timing)) for c in components]
        self._on_report = on_report
        self._events: asyncio.Queue[Callable[[], Awaitable[None]]] = asyncio.Queue()
        self._refusal: ComponentError | None = None
        self._is_complete = False

    def stop(self) -> None:
        """End all components in order; a second call ends them at once by force."""
        self._events.put_nowait(self._stop_all)

    async def run(self) -> None:
        """Run until `stop` is called or this is cancelled; no process is left when it returns.

        Raises:
            ComponentError: A component ended of its own accord before it had ever served.
        """
        serving = asyncio.create_task(self._serve())
        cancelled: asyncio.CancelledError | None = None
        while not serving.done():
            try:
                await asyncio.wait({serving})
            except asyncio.CancelledError as error:
                cancelled = error
                self.stop()
        serving.result()
        if cancelled is not None:
            raise cancelled
        if self._refusal is not None:
            raise self._refusal

    async def _serve(self) -> None:
        try:
            for unit in self._units:
                await self._feed(unit, Input.BEGIN)
            async with beside(self._watch()):
                while any(unit.life.state not in REST for unit in self._units):
                    await self._step()
        finally:
            processes = [unit.process for unit in self._units if unit.process is not None]
            for process in processes:
                process.kill()
            await asyncio.gather(*(process.close() for process in processes))

    async def _watch(self) -> None:
        """End unresponsive processes by force; they are restarted as after a crash."""
        while True:
            await asyncio.sleep(CHECK_PERIOD_S)
            for unit in self._units:
                if unit.process is None or unit.life.state is not State.RUNNING:
                    continue
                why = unit.watchdog.check(unit.process.pid)
                if why:
                    unit.failure = why
                    unit.process.kill()

    async def _step(self) -> None:
        """Handle the next event if it comes before the next deadline, and then the expired timers."""
        event = await next_before(self._events, [unit.life.deadline_ns for unit in self._units])
        if event is not None:
            await event()
        for unit in self._units:
            if unit.life.due(steady_ns()):
                await self._feed(unit, Input.TIMER)

    async def _handle(self, unit: _Unit, report: Report) -> None:
        match report["is"]:
            case "ended":
                await self._ended(unit, report["status"])
            case "line":
                self._on_report({"is": "line", "component": unit.name, "line": report["line"]})
            case "ready":
                await self._feed(unit, Input.READY)
                if not self._is_complete and all(unit.life.was_ready for unit in self._units):
                    self._is_complete = True
                    self._on_report({"is": "ready"})
            case "alive":
                unit.watchdog.beat()
            case "failed":
                unit.failure = str(report.get("why", ""))
            case _:
                self._on_report({"is": "report", "component": unit.name, "report": report})

    async def _stop_all(self) -> None:
        for unit in self._units:
            await self._feed(unit, Input.TOLD_TO_STOP)

    async def _ended(self, unit: _Unit, status: int) -> None:
        why = unit.failure or _reason(status)
        unit.process, unit.failure = None, ""
        await self._feed(unit, unit.life.end(willingly=status >= 0), why)

    async def _feed(self, unit: _Unit, given: Input, why: str = "") -> None:
        before = unit.life.state
        action = unit.life.feed(given, now_ns=steady_ns())
        after = unit.life.state
        if action is Action.START:
            await self._start(unit)  # the report of the change contains the process id
        if after is not before:
            late = "it took too long to start" if after is State.REPLACING else ""
            self._report_change(unit, why or late)
        if action is Action.GIVE_UP:
            self._refusal = self._refusal or ComponentError(unit.name, why)
            await self._stop_all()
        elif unit.process is not None and action is Action.TERMINATE:
            unit.process.signal(signal.SIGTERM)
        elif unit.process is not None and action is Action.KILL:
            unit.process.kill()

    async def _start(self, unit: _Unit) -> None:
        def on_report(report: Report) -> None:
            self._events.put_nowait(partial(self._handle, unit, report))

        unit.watchdog = Watchdog()
        try:
            unit.process = await ComponentProcess.launch(unit.component, on_report)
        except OSError as error:
            unit.failure = str(error)
            on_report({"is": "ended", "status": -signal.SIGABRT})

    def _report_change(self, unit: _Unit, why: str) -> None:
        life, retry_s = unit.life, None
        if life.state is State.BACKING_OFF and life.deadline_ns is not None:
            retry_s = (life.deadline_ns - steady_ns()) / 1e9
        self._on_report(
            {
                "is": "component",
                "component": unit.name,
                "state": life.state.name.lower(),
                "pid": None if unit.process is None else unit.process.pid,
                "crashes": life.crashes,
                "why": why,
                "retry_s": retry_s,
            }
        )


def _reason(status: int) -> str:
    if status < 0:
        return f"killed by {signal.Signals(-status).name}"
    if status:
        return f"it ended with status {status}; see its output above"
    return "it ended by itself"


class Narrator:
    """Text lines about an agent's reports, to be read at a terminal."""

    def __init__(self, config: AgentConfig) -> None:
        self._router = config.router
        self._paths = PathNarrator()
        self._streams = StreamNarrator()

    def beginning(self) -> str:
        """Return the line that is printed at the start."""
        local = _place(self._router.local)
        remote = _place(self._router.remote)
        return f"agent {self._router.agent}: its own {local}, the global {remote}; starting"

    def end(self) -> str:
        """Return the line that is printed at the end."""
        return f"agent {self._router.agent}: everything has ended"

    def lines(self, report: Report) -> list[str]:
        """Return the lines that describe a report, one sentence each; none for details."""
        match report["is"]:
            case "ready":
                return [f"agent {self._router.agent}: ready, end it with Ctrl-C"]
            case "line":
                words = [report["line"]]
            case "report":
                words = self._of_component(report["report"])
            case _:
                words = _of_change(report)
        return [f"{report['component']}: {word}" for word in words]

    def _of_component(self, report: Report) -> list[str]:
        if report["is"] == "event":
            return [f"{report['agent']} {report['event'].lower()}"]
        if report["is"] == "status" and "paths" in report:
            return self._paths.lines(report)
        if report["is"] == "status" and "local_topic" in report:
            return self._streams.lines(report)
        return []


def _of_change(report: Report) -> list[str]:
    crashes, why = report["crashes"], report["why"]
    match report["state"]:
        case "running" if crashes:
            return [f"ready again after {'a crash' if crashes == 1 else f'{crashes} crashes'}"]
        case "running":
            return ["ready"]
        case "backing_off":
            return [f"crashed ({why}); it is started again in {report['retry_s']:.1f} s"]
        case "replacing":
            return [f"{why}; it is ended and started again"]
        case _:
            return []


def _place(address: ZenohAddress | BusAddress) -> str:
    if not isinstance(address, BusAddress):
        config = address.config()
        return f"Zenoh at {', '.join(config.connect or config.listen)}"
    return f"domain {address.domain_id}" + (f" on {address.interface}" if address.interface else "")


async def serve_agent(
    config: AgentConfig, say: Callable[[str], None], *, as_json: bool = False
) -> None:
    """Run an agent for a person at a terminal, until interrupted or terminated; a second signal ends it at once.

    `say` is called with lines for a person. With `as_json` it is called with every report as JSON.

    Raises:
        SfglabError: The agent could not be run as it is described.
        ComponentError: A component ended of its own accord before it had ever served.
    """
    narrator = Narrator(config)

    def on_report(report: Report) -> None:
        for line in [json.dumps(report)] if as_json else narrator.lines(report):
            say(line)

    agent = Agent(plan(config), on_report=on_report)
    on_stop(agent.stop)
    if not as_json:
        say(narrator.beginning())
    await agent.run()
    if not as_json:
        say(narrator.end())
