"""Live parts: the times of heartbeats, and a discoverer that is led through the transitions of its table.

A simulated agent follows a script. Each step waits for the transition that it causes. If a transition is missing
because a script was too slow, all scripts run again with new agents.
"""

from __future__ import annotations

import asyncio
import base64
import signal
from collections import Counter, defaultdict
from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.fleet.discovery.config import DiscoveryConfig, DiscoverySettings, Timing
from sfglab.fleet.discovery.lifecycle import TRANSITIONS, Announced, Input, State
from sfglab.fleet.discovery.listener import DISCOVERY_EVENT, discovery_topic
from sfglab.fleet.router.config import RouterConfig
from sfglab.fleet.status.config import StatusConfig, StatusSettings
from sfglab.fleet.status.heartbeat import (
    AGENT_HEARTBEAT,
    MIN_PERIOD_S,
    Heartbeat,
    Schedule,
    heartbeat_topic,
    metadata_service,
)
from sfglab.lab.bench import as_row
from sfglab.lab.experiments.lifecycle.experiment import (
    ROBOT,
    STATION,
    AnswerRow,
    BeatRow,
    Config,
    JoinRow,
    MoveRow,
    QueryRow,
    WireEndpointRow,
    exp,
)
from sfglab.lab.workers.peer import PeerConfig
from sfglab.messages import deserialize, message_type
from sfglab.processes import Member, ProcessFailedError, ProcessGroup

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from sfglab.component import Report
    from sfglab.lab.bench import Bench

GLOBAL_DOMAIN = 0
LOOPBACK_DOMAIN = 93
"""Global domain where all hosts are this one, so that no other run is met in domain 0."""
FIRST_LOCAL_DOMAIN = 94  #: Domain of the first agent behind a router, on its host's loopback.
WALKER = "walker"  #: The agent with a status provider of its own; all others are made up.
MADE_UP = "made-up agents"  #: Name of the process that plays them.
PLACES = 40  #: Places in the discoverer's table.
#: Waits of the discoverer: short, so that the run takes seconds.
TIMING = Timing(
    slack_ns=300_000_000,
    backoff_ns=1_000_000_000,
    backoff_max_ns=2_000_000_000,
    # Longer than the process of a lost agent takes to start again.
    forget_ns=3_000_000_000,
)
QUERY_TIMEOUT_S = 1.0  #: Time limit of the discoverer's queries, s.
WALKER_PERIOD_S = 0.5  #: Period of the walker's heartbeats, s.
#: Number of attempts at a transition that was missed, as happens on a machine that stalls.
ATTEMPTS = 3
STEP_S = 60.0  #: Longest time of a step.
CALL_S = 10.0  #: Time limit of a call of a metadata service, s.
LONG_S = 30.0  #: Announced period of a simulated agent whose silence must not be detected, s.
_PEER = "sfglab.lab.workers.peer"
_IDLE = "sfglab.lab.workers.idle"
_ROUTER = "sfglab.fleet.router.node"


class Stage(ProcessGroup):
    """Processes of the live run; their reports are written into the log."""

    def __init__(self, bench: Bench[Config]) -> None:
        super().__init__(wrap_command=bench.testbed.argv, on_report=self._take)
        self.bench = bench  #: Context of the run.
        #: Number of heartbeats of the steady state that ``first`` received, by agent.
        self.steady: Counter[str] = Counter()
        self.moves: defaultdict[str, list[Input]] = defaultdict(list)  #: Inputs by agent.
        self.taken: set[tuple[State, Input]] = set()  #: Transitions that were taken.
        self._changed = asyncio.Event()

    def address(self, host: str) -> BusAddress:
        """Return the address of a host in the global domain."""
        domain_id = GLOBAL_DOMAIN if self.bench.testbed.separate else LOOPBACK_DOMAIN
        return BusAddress(domain_id=domain_id, interface=self.bench.testbed.interface(host))

    def listener(self, name: str, *topics: str) -> Member:
        """Return a subscriber to heartbeats and topics of discovery events; it is loaded, and waits for `listen`."""
        types = {heartbeat_topic(): AGENT_HEARTBEAT, **dict.fromkeys(topics, DISCOVERY_EVENT)}
        config = PeerConfig(name=f"listener_{name}", address=self.address(STATION), reports=types)
        return Member(
            name=name, host=STATION, module=_PEER, config=config, ready="idle", through=_IDLE
        )

    async def listen(self, name: str) -> None:
        """Order a subscriber of `listener` to join the domain."""
        joined = await self.ask("ready", [name], timeout_s=STEP_S, do="start")
        self.bench.write(JoinRow(listener=name, t_ns=joined[name]["t_ns"]))

    async def until(
        self, what: str, fact: Callable[[], bool], *, timeout_s: float = STEP_S
    ) -> None:
        """Wait until a fact about the reports holds; `what` describes the fact in errors.

        Raises:
            ProcessFailedError: The fact does not hold in time.
        """
        try:
            async with asyncio.timeout(timeout_s):
                while not fact():
                    self._changed.clear()
                    await self._changed.wait()
        except TimeoutError:
            raise ProcessFailedError(f"{what}: not within {timeout_s:g} s") from None

    def _take(self, name: str, report: Report) -> None:
        match report["is"]:
            case "heard":
                self._record(name, report)
            case "move":
                move = as_row(MoveRow, {"actions": ";".join(report["actions"])}, report)
                self.bench.write(move, at_ns=move.t_ns)
                given = Input[move.given]
                self.moves[move.agent].append(given)
                self.taken.add((State[move.before], given))
            case "asked":
                self.bench.write(as_row(QueryRow, {}, report), at_ns=report["t_ns"])
        self._changed.set()

    def _record(self, listener: str, report: Report) -> None:
        """Record a message of a subscriber; messages of ``first`` are written into the log unchanged."""
        topic, cdr = report["topic"], base64.b64decode(report["cdr"])
        type_ = AGENT_HEARTBEAT if topic == heartbeat_topic() else DISCOVERY_EVENT
        times = {"log_time_ns": report["received_ns"], "publish_time_ns": report["sent_ns"]}
        if listener == "first":
            self.bench.log.write_raw(topic, type_, cdr, **times)
        if type_ == AGENT_HEARTBEAT:
            beat = Heartbeat.from_message(deserialize(cdr, message_type(type_)))
            row = as_row(BeatRow, {"listener": listener}, beat, report)
            self.bench.write(row, at_ns=row.received_ns)
            if listener == "first":
                self.steady[beat.agent] += beat.phase


def status_provider(agent: str, schedule: Schedule, address: BusAddress) -> Member:
    """Return the status provider of an agent, whose description is queried as in the paper."""
    settings = StatusSettings(agent=agent, schedule=schedule, publish_description=False)
    config = StatusConfig(address=address, settings=settings, detect=False)
    return Member(name=agent, host=ROBOT, module="sfglab.fleet.status.node", config=config)


# --- Heartbeats -------------------------------------------------------------------------------


@exp.part("heartbeats", total=2)
async def time_heartbeats(bench: Bench[Config]) -> None:
    """Start agents that send heartbeats; subscribe before the start, and again in the steady state."""
    config = bench.config
    agents = [f"robot{number + 1}" for number in range(config.agents)]
    async with Stage(bench) as stage:
        await stage.start(stage.listener("first"), stage.listener("late"))
        await stage.listen("first")
        shared = stage.address(ROBOT)
        routers, providers = [], []
        for domain_id, agent in enumerate(agents, start=FIRST_LOCAL_DOMAIN):
            local = BusAddress(domain_id=domain_id, interface="lo")
            router = RouterConfig(agent=agent, local=local, remote=shared)
            name = f"router of {agent}"
            routers.append(Member(name=name, host=ROBOT, module=_ROUTER, config=router))
            providers.append(status_provider(agent, config.schedule, local))
        await stage.start(*routers)
        await stage.start(*providers)
        bench.advance("start-up")
        await steady_beats(stage, 2)
        # The late joiner subscribes between two heartbeats, so that the first heartbeat that it receives is an old one.
        await asyncio.sleep(0.3 * config.schedule.steady_period_s)
        await stage.listen("late")
        await call_services(stage, agents)
        bench.advance("steady state")
        await steady_beats(stage, config.steady_beats + 1)


async def steady_beats(stage: Stage, count: int) -> None:
    """Wait until each agent has sent a number of heartbeats in the steady state."""
    schedule = stage.bench.config.schedule
    agents = stage.bench.config.agents

    def is_reached() -> bool:
        return len(stage.steady) == agents and min(stage.steady.values()) >= count

    limit_s = 20 + schedule.startup_s + (count + 1) * schedule.steady_period_s
    await stage.until(f"{count} heartbeats in the steady state", is_reached, timeout_s=limit_s)


async def call_services(stage: Stage, agents: Sequence[str]) -> None:
    """Call the agents' metadata services, and write the answers and the publishers of heartbeats into the log."""
    services = [metadata_service(agent) for agent in agents]
    stage["first"].order(do="call", names=services, timeout_s=CALL_S)
    called = await stage.expect("called", ["first"], timeout_s=STEP_S)
    for agent, service, answer in zip(agents, services, called["first"]["answers"], strict=True):
        stage.bench.write(as_row(AnswerRow, {"agent": agent, "service": service}, answer))
    looked = await stage.ask("publishers", ["first"], timeout_s=STEP_S, do="look")
    for found in looked["first"]["publishers"]:
        stage.bench.write(WireEndpointRow(**found))


# --- Transitions ------------------------------------------------------------------------------


@exp.part("transitions")
async def lead_discoverer(bench: Bench[Config]) -> None:
    """Lead a discoverer through its table with a real status provider and with simulated agents."""
    async with Stage(bench) as stage:
        settings = DiscoverySettings(
            agent=STATION,
            max_queries=32,
            use_published_descriptions=False,
            timing=TIMING,
            max_agents=PLACES,
            query_timeout_s=QUERY_TIMEOUT_S,
        )
        discovery = DiscoveryConfig(
            address=stage.address(STATION), settings=settings, report_moves=True
        )
        made_up = PeerConfig(
            name="made_up", address=stage.address(ROBOT), late_s=1.5 * QUERY_TIMEOUT_S
        )
        await stage.start(
            stage.listener("first", discovery_topic(STATION)),
            Member(
                name=STATION, host=STATION, module="sfglab.fleet.discovery.node", config=discovery
            ),
            Member(name=MADE_UP, host=ROBOT, module=_PEER, config=made_up),
        )
        await stage.listen("first")
        outcomes = await asyncio.gather(walk(stage), play_scripts(stage), return_exceptions=True)
        for outcome in outcomes:
            if outcome is not None:
                raise outcome
        await overfill(stage)


class Agent:
    """A remote agent with the transitions that the discoverer took for it; a simulated agent also gets orders."""

    def __init__(self, name: str, stage: Stage) -> None:
        self.name = name  #: Name of the agent.
        self._stage = stage
        self._read = 0  # number of its transitions up to the last one that was waited for
        self._incarnation = 1000
        self._revision = 1

    async def sees(self, *given: Input) -> None:
        """Wait for a transition with one of some inputs."""
        moves = self._stage.moves[self.name]
        names = " or ".join(each.name for each in given)

        def is_taken() -> bool:
            return not set(given).isdisjoint(moves[self._read :])

        await self._stage.until(f"{self.name}: {names}", is_taken)
        while moves[self._read] not in given:
            self._read += 1
        self._read += 1

    def mode(self, mode: str) -> None:
        """Set the way in which the agent's service answers from now on."""
        self._stage[MADE_UP].order(do="mode", agent=self.name, mode=mode)

    def beat(self, given: Input = Input.HEARD, *, period_s: float = LONG_S) -> None:
        """Send a heartbeat that is an input for the discoverer: plain, a change or a restart."""
        self._revision += given is Input.CHANGED
        self._incarnation += given is Input.RESTARTED
        self._stage[MADE_UP].order(
            do="beat",
            agent=self.name,
            incarnation=self._incarnation,
            revision=self._revision,
            period_s=period_s,
        )

    async def beats(self, *inputs: Input) -> None:
        """Send heartbeats, each after the transition that the one before causes."""
        for given in inputs:
            self.beat(given)
            await self.sees(given)

    async def falls_silent(self) -> None:
        """Send the last heartbeat, and wait until the discoverer announces the loss of the agent."""
        self.beat(period_s=MIN_PERIOD_S)
        await self.sees(Input.SILENT)

    async def is_announced(self, announced: Announced) -> None:
        """Bring the agent into a row of the table: the last announcement about it to local consumers."""
        if announced is Announced.NOTHING:
            return
        await self.is_queried(Announced.NOTHING, "answer")
        await self.sees(Input.ANSWERED)
        if announced is Announced.LOST:
            await self.falls_silent()

    async def is_queried(self, announced: Announced, mode: str) -> None:
        """Make the discoverer query the agent, whose service answers in a mode."""
        self.mode(mode)
        await self.beats(Input.HEARD if announced is Announced.NOTHING else Input.CHANGED)


async def whole_row(puppet: Agent, announced: Announced) -> None:
    """Script: visit the three states of a row of the table."""
    await puppet.is_queried(announced, "mute")
    await puppet.beats(Input.HEARD, Input.CHANGED, Input.RESTARTED)
    await puppet.sees(Input.FAILED)
    await puppet.beats(Input.HEARD, Input.CHANGED)
    await puppet.sees(Input.RETRY)
    await puppet.sees(Input.FAILED)
    await puppet.beats(Input.RESTARTED)
    puppet.mode("answer")
    is_new = announced is Announced.NOTHING
    await puppet.sees(Input.ANSWERED if is_new else Input.ANSWERED_ANEW)


async def same_start_answers(puppet: Agent, announced: Announced) -> None:
    """Script: answer a query at once."""
    await puppet.is_queried(announced, "answer")
    await puppet.sees(Input.ANSWERED)


async def silent_when_queried(puppet: Agent, announced: Announced) -> None:
    """Script: stop sending heartbeats during a query."""
    await puppet.is_queried(announced, "mute")
    await puppet.falls_silent()


async def silent_after_failure(puppet: Agent, announced: Announced) -> None:
    """Script: stop sending heartbeats after an answer that came too late."""
    await puppet.is_queried(announced, "late")
    await puppet.sees(Input.FAILED)
    await puppet.falls_silent()


async def comes_and_goes(puppet: Agent, _: Announced) -> None:
    """Script: restart, stop sending heartbeats and return, and at last stay away."""
    await puppet.beats(Input.HEARD, Input.RESTARTED)
    await puppet.sees(Input.ANSWERED_ANEW)
    await puppet.falls_silent()
    await puppet.beats(Input.HEARD)
    await puppet.falls_silent()
    await puppet.beats(Input.RESTARTED)
    await puppet.sees(Input.ANSWERED_ANEW)
    await puppet.falls_silent()
    await puppet.sees(Input.EXPIRED)


_ANYWHERE = (whole_row, same_start_answers, silent_when_queried, silent_after_failure)
SCRIPTS = (
    *((script, announced) for script in _ANYWHERE for announced in Announced),
    (comes_and_goes, Announced.PRESENT),
)
"""Scripts, and the row of the table in which each begins."""
FULL_TABLE = (State.BACKING_OFF, Input.EXPIRED)
"""The transition that no script causes: an agent loses its place in a full table."""


async def play_scripts(stage: Stage) -> None:
    """Run all scripts at the same time, and again while a transition is missing, at most `ATTEMPTS` times."""

    async def play(puppet: Agent, script: Any, announced: Announced) -> None:
        await puppet.is_announced(announced)
        await script(puppet, announced)

    for attempt in range(ATTEMPTS):
        plays = []
        for number, (script, announced) in enumerate(SCRIPTS):
            puppet = Agent(f"puppet{number}_{attempt}", stage)
            plays.append(play(puppet, script, announced))
        for outcome in await asyncio.gather(*plays, return_exceptions=True):
            if isinstance(outcome, BaseException) and not isinstance(outcome, ProcessFailedError):
                raise outcome
        if TRANSITIONS.keys() - stage.taken <= {FULL_TABLE}:
            return


async def walk(stage: Stage) -> None:
    """Change, stop, continue, kill and restart the status provider of a real agent."""
    schedule = Schedule(
        startup_period_s=WALKER_PERIOD_S, steady_period_s=WALKER_PERIOD_S, startup_s=0
    )
    member = status_provider(WALKER, schedule, stage.address(ROBOT))
    track = Agent(WALKER, stage)
    await stage.start(member)
    await track.sees(Input.ANSWERED)
    stage[WALKER].order(description={"software": ["changed at run time"]})
    await track.sees(Input.ANSWERED)
    stage[WALKER].signal(signal.SIGSTOP)
    await track.sees(Input.SILENT)
    stage[WALKER].signal(signal.SIGCONT)
    await track.sees(Input.HEARD)
    for waits in (False, True):
        await stage.kill(WALKER)
        if waits:
            await track.sees(Input.SILENT)
        await stage.start(member)
        # On a machine that stalls, the agent may have been forgotten before it is back.
        await track.sees(Input.ANSWERED_ANEW, Input.ANSWERED)
    await stage.kill(WALKER)
    await track.sees(Input.EXPIRED)


async def overfill(stage: Stage) -> None:
    """Add agents that refuse to answer until one of them loses its place in the table.

    Raises:
        ProcessFailedError: No agent lost its place in time.
    """
    for number in range(2 * PLACES):
        if FULL_TABLE in stage.taken:
            return
        puppet = Agent(f"refusing{number}", stage)
        await puppet.is_queried(Announced.NOTHING, "refuse")
        await puppet.sees(Input.FAILED)
    raise ProcessFailedError("no agent lost its place in the full table")
