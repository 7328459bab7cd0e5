"""Agent of a fleet as a process: `sfglab agent up`, or ``python -m sfglab.fleet.agent.app CONFIG``.

The thin shell around `supervision`, in one task, one event after the other. A person gets its events as few
lines. The second form is a component for programs (see `sfglab.component`): it reports ``ready`` once all of
its own have served, ``{"is": "component", "component", "state", "pid", "crashes", "why", "retry_s"}`` for every
change of one, ``{"is": "report", "component", "report"}`` for what one reports, and ``{"is": "line",
"component", "line"}`` for what one writes on standard error.
"""

from __future__ import annotations

import asyncio
import json
import signal
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.component import (
    END_LIMIT_S,
    Orders,
    Report,
    Reporter,
    beside,
    on_stop,
    run_component,
    steady_ns,
)
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
from sfglab.machine import ProcessTiming
from sfglab.names import DdsRole, Resource, ros_name_from_dds
from sfglab.processes import LOOK_PERIOD_S, HangWatch
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from sfglab.bus.address import BusAddress


@dataclass(frozen=True, slots=True, kw_only=True)
class Changed:
    """A component's life went on."""

    component: str  #: Its name.
    state: State  #: Where it stands now.
    pid: int | None = None  #: Its process; None while there is none.
    crashes: int = 0  #: How often it has ended although it was wanted.
    #: How its process ended or what is waited for; empty when there is nothing to say.
    why: str = ""
    #: Wait before it is started again, seconds; None when no start is waited for.
    retry_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Said:
    """A component reported something that is its own business."""

    component: str  #: Its name.
    report: Report  #: The report.


@dataclass(frozen=True, slots=True, kw_only=True)
class Wrote:
    """A component wrote a line on standard error."""

    component: str  #: Its name.
    line: str  #: The line.


@dataclass(frozen=True, slots=True, kw_only=True)
class Complete:
    """All components serve for the first time."""


AgentEvent = Changed | Said | Wrote | Complete


def report_from_event(event: AgentEvent) -> Report:
    """Return an event as a JSON object: ``is`` is ``component``, ``report``, ``line`` or ``ready``."""
    if isinstance(event, Complete):
        return {"is": "ready"}
    if isinstance(event, Said):
        return {"is": "report", "component": event.component, "report": event.report}
    if isinstance(event, Wrote):
        return {"is": "line", "component": event.component, "line": event.line}
    values: dict[str, Any] = {"state": event.state.name.lower(), "pid": event.pid}
    values |= {"crashes": event.crashes, "why": event.why, "retry_s": event.retry_s}
    return {"is": "component", "component": event.component, **values}


class ComponentError(SfglabError, RuntimeError):
    """A component cannot start as it is configured."""

    def __init__(self, component: str, why: str) -> None:
        self.component = component  #: Its name.
        self.why = why  #: What it said, or how it ended.
        super().__init__(why if why.startswith(component) else f"{component}: {why}")


@dataclass(slots=True)
class _Unit:
    """A component, its life, and its process while there is one."""

    component: Component
    life: Supervision
    process: ComponentProcess | None = None
    failure: str = ""  # its last words, when it reported that it failed, or how it hung
    watch: HangWatch = field(default_factory=HangWatch)

    @property
    def name(self) -> str:
        return self.component.name


class Agent:
    """The components of one agent, supervised; `on_event` is called with everything that happens."""

    def __init__(
        self,
        components: Sequence[Component],
        *,
        timing: ProcessTiming | None = None,
        on_event: Callable[[AgentEvent], None] = lambda _: None,
    ) -> None:
        timing = timing or ProcessTiming()
        self._units = [_Unit(c, Supervision(c.name, timing)) for c in components]
        self._on_event = on_event
        self._events: asyncio.Queue[tuple[_Unit, Report] | None] = asyncio.Queue()
        self._refusal: ComponentError | None = None
        self._complete = False

    def stop(self) -> None:
        """End all components in order; called again, at once by force."""
        self._events.put_nowait(None)

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
            await asyncio.gather(
                *(u.process.destroy() for u in self._units if u.process is not None)
            )

    async def _watch(self) -> None:
        """End by force what hangs; it is started anew like whatever crashes."""
        while True:
            await asyncio.sleep(LOOK_PERIOD_S)
            for unit in self._units:
                process = unit.process if unit.life.state is State.RUNNING else None
                if process is not None and (why := unit.watch.look(process.pid)):
                    unit.failure = why
                    process.kill()

    async def _step(self) -> None:
        """Handle the next event, if there is one before the next deadline, and the timers that ran out."""
        deadlines = [u.life.deadline_ns for u in self._units if u.life.deadline_ns is not None]
        wait_s = max(0.0, (min(deadlines) - steady_ns()) / 1e9) if deadlines else None
        try:
            async with asyncio.timeout(wait_s):
                event = await self._events.get()
        except TimeoutError:
            pass
        else:
            await self._handle(event)
        for unit in self._units:
            if unit.life.due(steady_ns()):
                await self._feed(unit, Input.TIMER)

    async def _handle(self, event: tuple[_Unit, Report] | None) -> None:
        if event is None:
            await self._stop_all()
            return
        unit, heard = event
        match heard["is"]:
            case "ended":
                await self._ended(unit, heard["status"])
            case "line":
                self._on_event(Wrote(component=unit.name, line=heard["line"]))
            case "ready":
                await self._feed(unit, Input.READY)
                if not self._complete and all(unit.life.was_ready for unit in self._units):
                    self._complete = True
                    self._on_event(Complete())
            case "alive":
                unit.watch.beat()
            case "failed":
                unit.failure = str(heard.get("why", ""))
            case _:
                self._on_event(Said(component=unit.name, report=heard))

    async def _stop_all(self) -> None:
        for unit in self._units:
            await self._feed(unit, Input.TOLD_TO_STOP)

    async def _ended(self, unit: _Unit, status: int) -> None:
        why = unit.failure or _how(status)
        unit.process, unit.failure = None, ""
        before = unit.life.state
        action = unit.life.ended(willingly=status >= 0, now_ns=steady_ns())
        if unit.life.state is not before:
            self._tell(unit, why)
        await self._carry_out(unit, action, why)

    async def _feed(self, unit: _Unit, given: Input) -> None:
        before = unit.life.state
        await self._carry_out(unit, unit.life.feed(given, now_ns=steady_ns()), "")
        if unit.life.state is not before:
            self._tell(
                unit, "it took too long to start" if unit.life.state is State.REPLACING else ""
            )

    async def _carry_out(self, unit: _Unit, action: Action | None, why: str) -> None:
        if action is Action.START:
            await self._start(unit)
        elif action is Action.GIVE_UP:
            self._refusal = self._refusal or ComponentError(unit.name, why)
            await self._stop_all()
        elif unit.process is not None and action is Action.TERMINATE:
            unit.process.terminate()
        elif unit.process is not None and action is Action.KILL:
            unit.process.kill()

    async def _start(self, unit: _Unit) -> None:
        hear = partial(self._hear, unit)
        unit.watch = HangWatch()
        try:
            unit.process = await ComponentProcess.start(unit.component, hear)
        except OSError as error:
            unit.failure = str(error)
            hear({"is": "ended", "status": -signal.SIGABRT})

    def _hear(self, unit: _Unit, heard: Report) -> None:
        self._events.put_nowait((unit, heard))

    def _tell(self, unit: _Unit, why: str) -> None:
        deadline_ns = unit.life.deadline_ns if unit.life.state is State.BACKING_OFF else None
        self._on_event(
            Changed(
                component=unit.name,
                state=unit.life.state,
                pid=None if unit.process is None else unit.process.pid,
                crashes=unit.life.crashes,
                why=why,
                retry_s=None if deadline_ns is None else (deadline_ns - steady_ns()) / 1e9,
            )
        )


def _how(status: int) -> str:
    if status < 0:
        return f"killed by {signal.Signals(-status).name}"
    return (
        f"it ended with status {status}; its own words stand above"
        if status
        else "it ended by itself"
    )


class Narrator:
    """Tells the events of an agent to a person."""

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
        told = (_path(path["topic"], path["direction"]) for path in paths if path["readers"])
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
    timing: ProcessTiming = field(default_factory=ProcessTiming)  #: The waits of every component.


async def serve_agent(
    config: AgentConfig, say: Callable[[str], None], *, as_json: bool = False
) -> None:
    """Run an agent for a person at a terminal, until interrupted, hung up or terminated; twice ends it at once.

    `say` is given lines for a person, or with `as_json` the JSON reports, of which there are more.

    Raises:
        SfglabError: The agent could not be run as it is described.
        ComponentError: A component ended of its own accord before it had ever served.
    """
    narrator = Narrator(config)

    def tell(event: AgentEvent) -> None:
        for line in [json.dumps(report_from_event(event))] if as_json else narrator.lines(event):
            say(line)

    agent = Agent(plan(config), timing=config.supervision, on_event=tell)
    on_stop(agent.stop)
    if not as_json:
        say(narrator.beginning())
    await agent.run()
    if not as_json:
        say(narrator.end())


async def _serve(config: SupervisorConfig, report: Reporter, _: Orders) -> None:
    agent = Agent(
        config.components, timing=config.timing, on_event=lambda e: report(report_from_event(e))
    )
    await agent.run()


if __name__ == "__main__":
    # Beside its own time what its components may take until they are ended by force.
    run_component(
        SupervisorConfig, _serve, end_limit_s=lambda c: END_LIMIT_S + c.timing.stop_ns // NS_PER_S
    )
