"""Run the life-cycle experiment into one log: heartbeats first, then every transition."""

from __future__ import annotations

import asyncio
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING

from sfglab.component import argument_of
from sfglab.fleet.discovery.listener import DISCOVERY_EVENT, discovery_topic
from sfglab.fleet.discovery.node import DiscoveryConfig, DiscoverySettings
from sfglab.fleet.discovery.screening import Limits
from sfglab.fleet.router.node import RouterConfig
from sfglab.fleet.status.heartbeat import AGENT_HEARTBEAT, Schedule, heartbeat_topic, metadata_service
from sfglab.fleet.status.node import StatusConfig, StatusSettings
from sfglab.lab.experiments.lifecycle.analysis import WALKER
from sfglab.lab.experiments.lifecycle.rows import AnswerRow, CountRow, JoinRow, WireEndpointRow
from sfglab.lab.experiments.lifecycle.script import crowd, puppet_show, walk
from sfglab.lab.experiments.lifecycle.stage import Crew, Recorder, together
from sfglab.lab.progress import progress_bar
from sfglab.lab.testbed import Testbed
from sfglab.lab.workers.false_agents import FakeConfig
from sfglab.lab.workers.wire import WireConfig
from sfglab.record import LogWriter, run_context

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from sfglab.bus.address import BusAddress
    from sfglab.lab.experiments.lifecycle.config import Config
    from sfglab.processes import LineProcess


ROBOT, STATION = "robot", "station"
GATE = "gate"
PLACES = 3
_STEPS = 5


@dataclass(frozen=True, slots=True)
class _Run:
    """What every part needs."""

    config: Config
    crew: Crew
    recorder: Recorder
    advance: Callable[[str], None]


async def run(config: Config, path: Path, *, separate: bool | None = None) -> Path:
    """Run the experiment.

    Args:
        config: What to run.
        path: The log; it is readable up to the last finished chunk, whatever ends the run.
        separate: False insists on one host; None takes separate hosts where the machine can.

    Returns:
        The log's path.

    Raises:
        ProcessFailedError: A process of the experiment failed; what was seen until then is in the log.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with Testbed(ROBOT, STATION, separate=separate) as testbed, LogWriter(path) as log:
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": "lifecycle", **asdict(config)})
        log.write_metadata("hosts", {"description": testbed.description, "separate": testbed.separate})
        with progress_bar(_STEPS, "life cycle") as advance:
            for part in (_time_heartbeats, _lead_discoverer, _crowd_discoverer):
                # Processes of one part are gone before the next, and with them what they had latched.
                async with Crew(testbed) as crew:
                    await part(_Run(config, crew, Recorder(log), advance))
    return path


async def _time_heartbeats(run: _Run) -> None:
    config, recorder = run.config, run.recorder
    agents = [f"robot{number + 1}" for number in range(config.agents)]
    topics = {heartbeat_topic(): AGENT_HEARTBEAT}
    first, late = await together(
        _start_wire(run, "first", topics), _start_wire(run, "late", topics, join=False)
    )
    addresses = await together(*(_border(run, number, agent) for number, agent in enumerate(agents)))
    starts = zip(agents, addresses, strict=True)
    await together(*(_start_status(run, agent, config.schedule, where) for agent, where in starts))
    run.advance("start-up")
    await _beats(run, agents, 2)
    # Somewhere between two heartbeats: what is heard at once then is the last one, not the next.
    await asyncio.sleep(0.3 * config.schedule.steady_period_s)
    await _join(run, late, "late")
    await _ask_all(run, first, agents)
    await _look(recorder, first)
    run.advance("steady state")
    await _beats(run, agents, config.steady_beats + 1)


async def _beats(run: _Run, agents: list[str], steady: int) -> None:
    """Return when every agent has beaten so many times in the steady state."""

    def heard() -> bool:
        beats = run.recorder.beats
        return all(sum(b.phase for b in beats.get(("first", agent), ())) >= steady for agent in agents)

    schedule = run.config.schedule
    limit_s = 20 + schedule.startup_s + (steady + 1) * schedule.steady_period_s
    await run.recorder.seen.until(f"{steady} heartbeats in the steady state", heard, timeout_s=limit_s)


async def _ask_all(run: _Run, wire: LineProcess, agents: list[str]) -> None:
    for agent in agents:
        wire.order(do="ask", service=metadata_service(agent))
    replies = run.recorder.replies
    await run.recorder.seen.until("metadata", lambda: len(replies) == len(agents), timeout_s=60)
    for agent, reply in zip(agents, replies, strict=True):
        run.recorder.row("answer", AnswerRow(agent=agent, **{k: reply[k] for k in reply if k != "is"}))
    replies.clear()


async def _look(recorder: Recorder, wire: LineProcess) -> None:
    wire.order(do="look")
    replies = recorder.replies
    await recorder.seen.until("publishers", lambda: bool(replies) and replies[-1]["is"] == "looked")
    for reply in replies[:-1]:
        recorder.row("endpoint", WireEndpointRow(**{k: reply[k] for k in reply if k != "is"}))
    replies.clear()


async def _lead_discoverer(run: _Run) -> None:
    config = run.config
    topics = {heartbeat_topic(): AGENT_HEARTBEAT, discovery_topic(STATION): DISCOVERY_EVENT}
    _, discoverer, fakes = await together(
        _start_wire(run, "first", topics), _start_discoverer(run, STATION, Limits()), _start_fakes(run)
    )
    pace = Schedule(
        startup_period_s=config.walker_period_s, steady_period_s=config.walker_period_s, startup_s=0
    )
    run.advance("transitions")
    await together(
        walk(WALKER, partial(_start_status, run, WALKER, pace, run.crew.address(ROBOT)), run.recorder),
        puppet_show(fakes, run.recorder, attempts=config.attempts),
    )
    await _count(run, discoverer, STATION, "answered")


async def _crowd_discoverer(run: _Run) -> None:
    run.advance("crowd")
    _, discoverer, fakes = await together(
        _start_wire(run, "first", {discovery_topic(GATE): DISCOVERY_EVENT}),
        _start_discoverer(run, GATE, Limits(max_agents=PLACES)),
        _start_fakes(run),
    )
    await crowd(GATE, fakes, run.recorder, places=PLACES)
    await _count(run, discoverer, GATE, "dropped_flood")
    run.advance("done")


async def _start_wire(run: _Run, listener: str, topics: dict[str, str], *, join: bool = True) -> LineProcess:
    config = WireConfig(address=run.crew.address(STATION), topics=topics)
    take = run.recorder.wire(listener, topics)
    wire = await run.crew.start(STATION, "sfglab.lab.workers.wire", argument_of(config), take)
    if join:
        await _join(run, wire, listener)
    return wire


async def _join(run: _Run, wire: LineProcess, listener: str) -> None:
    wire.order(do="join")
    joined = run.recorder.joined_ns
    await run.recorder.seen.until(f"listener {listener}", lambda: listener in joined)
    run.recorder.row("join", JoinRow(listener=listener, t_ns=joined[listener]))


async def _border(run: _Run, number: int, agent: str) -> BusAddress:
    """Return where an agent's components are, after its router has been started if it has one."""
    if not run.config.routed:
        return run.crew.address(ROBOT)
    local = run.crew.local_address(number)
    config = RouterConfig(agent=agent, local=local, remote=run.crew.address(ROBOT))
    await run.crew.start(ROBOT, "sfglab.fleet.router.node", argument_of(config), lambda _: None)
    return local


async def _start_status(run: _Run, agent: str, schedule: Schedule, address: BusAddress) -> LineProcess:
    config = StatusConfig(
        address=address,
        settings=StatusSettings(agent=agent, schedule=schedule),
        detect=False,
    )
    return await run.crew.start(ROBOT, "sfglab.fleet.status.node", argument_of(config), lambda _: None)


async def _start_discoverer(run: _Run, agent: str, limits: Limits) -> LineProcess:
    settings = DiscoverySettings(
        agent=agent,
        timing=run.config.timing,
        limits=limits,
        query_timeout_s=run.config.query_timeout_s,
        max_queries=32,
    )
    config = DiscoveryConfig(address=run.crew.address(STATION), settings=settings, report_moves=True)
    take = run.recorder.discoverer(agent)
    return await run.crew.start(STATION, "sfglab.fleet.discovery.node", argument_of(config), take)


async def _start_fakes(run: _Run) -> LineProcess:
    config = FakeConfig(address=run.crew.address(ROBOT), late_s=1.5 * run.config.query_timeout_s)
    return await run.crew.start(
        ROBOT, "sfglab.lab.workers.false_agents", argument_of(config), run.recorder.fakes
    )


async def _count(run: _Run, discoverer: LineProcess, own: str, must_hold: str) -> None:
    """Ask a discoverer for its counters until they hold what must be there, and write them down."""
    replies = run.recorder.replies
    while not replies or must_hold not in replies[-1]["counts"]:
        asked = len(replies)
        discoverer.order(report=True)
        await run.recorder.seen.until("counters", lambda: len(replies) > asked)  # noqa: B023 - awaited here
        await asyncio.sleep(0.05)
    for name, count in sorted(replies[-1]["counts"].items()):
        run.recorder.row("count", CountRow(discoverer=own, name=name, count=count))
