"""The processes of one part of the life-cycle experiment, and what is done to a discoverer.

A `Stage` orders processes and waits for their reports. A `Puppet` is a false agent led step by step: each waits
for the transition that it provokes. A script too slow for the discoverer's waits is played again with another.
"""

from __future__ import annotations

import asyncio
import base64
import signal
import time
from collections import Counter, defaultdict
from typing import TYPE_CHECKING, Any

from sfglab.fleet.discovery.lifecycle import TRANSITIONS, Announced, Input, State
from sfglab.fleet.discovery.listener import DISCOVERY_EVENT
from sfglab.fleet.status.heartbeat import AGENT_HEARTBEAT, MIN_PERIOD_S, Heartbeat, heartbeat_topic
from sfglab.lab.bench import Bench, as_row
from sfglab.messages import deserialize, message_type
from sfglab.processes import Member, ProcessFailedError, ProcessGroup

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Sequence

    from sfglab.component import Report

ASK_S = 60.0
STEP_S = 60.0

WALKER = "walker"  #: The agent whose status process is a real one; all others are false agents.
FAKES = "false agents"  #: The process that plays them.

FOREVER_S = 30.0  #: A period that is announced so that nobody is missed.

_I, _S = Input, State


class Stage(ProcessGroup):
    """Processes whose reports go into the log, and what the script has to react to.

    On entering, the members start, and the one of them that is called ``first`` listens.
    """

    def __init__(self, bench: Bench[Any], *members: Member) -> None:
        super().__init__(members, wrap_command=bench.testbed.argv, on_report=self._hear_of)
        #: Heartbeats of the steady state that ``first`` heard, by agent.
        self.steady: Counter[str] = Counter()
        #: Reports of transitions, by agent.
        self.moves: defaultdict[str, list[Report]] = defaultdict(list)
        self._bench = bench
        self._changed = asyncio.Event()

    async def settle(self) -> None:
        """Let the listener ``first`` subscribe."""
        await self.join("first")

    async def until(
        self, what: str, fact: Callable[[], bool], *, timeout_s: float = STEP_S
    ) -> None:
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
        joined = await self._ask_one("joined", listener, do="join")
        self._bench.write("join", {"listener": listener, "t_ns": joined["t_ns"]})

    async def ask_metadata(self, agent: str, service: str) -> None:
        """Let the listener ``first`` call an agent's metadata service."""
        answer = await self._ask_one("answer", "first", timeout_s=ASK_S, do="ask", service=service)
        self._write("answer", answer, agent=agent)

    async def count(self, discoverer: str, must_hold: str) -> None:
        """Ask a discoverer for its counters until they hold what must be there, and write them down."""
        counts: dict[str, int] = {}
        while must_hold not in counts:
            await asyncio.sleep(0.05)
            counts = (await self._ask_one("status", discoverer, report=True))["counts"]
        for name, count in sorted(counts.items()):
            self._bench.write("count", {"discoverer": discoverer, "name": name, "count": count})

    async def _ask_one(
        self, kind: str, name: str, *, timeout_s: float = STEP_S, **order: Any
    ) -> Report:
        return (await self.ask(kind, [name], timeout_s=timeout_s, **order))[name]

    def _hear_of(self, name: str, report: Report) -> None:
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
        self._bench.write(
            table, as_row(self._bench.row_classes[table], values, *origins), at_ns=at_ns
        )


class Track:
    """What a discoverer does about one agent, read on from where one last looked."""

    def __init__(self, agent: str, stage: Stage) -> None:
        self.agent = agent
        self._stage = stage
        self._moves = stage.moves[agent]
        self._read = 0

    async def sees(self, *given: Input, at: State | None = None) -> None:
        """Return when the discoverer has taken a transition with one of these inputs, from a state if given."""

        def taken() -> int:
            return next(
                (n for n, m in enumerate(self._moves, 1) if n > self._read and _is(m, given, at)), 0
            )

        names = " or ".join(i.name for i in given)
        await self._stage.until(f"{self.agent}: {names}", lambda: taken() > 0)
        self._read = taken()

    async def reaches(self, state: State) -> None:
        """Return when the agent is in a state."""
        moves, what = self._moves, f"{self.agent}: {state.name}"
        await self._stage.until(what, lambda: bool(moves) and moves[-1]["after"] == state.name)
        self._read = len(moves)


class Puppet(Track):
    """A false agent."""

    def __init__(self, agent: str, stage: Stage) -> None:
        super().__init__(agent, stage)
        self._fakes = stage[FAKES]
        self._incarnation, self._revision = 1000, 1

    def mode(self, mode: str) -> None:
        """Say how it answers from now on."""
        self._fakes.order(do="mode", agent=self.agent, mode=mode)

    def beat(self, given: Input = _I.HEARD, *, period_s: float = FOREVER_S) -> None:
        """Let it beat so that the discoverer gets an input: a plain heartbeat, a change or a restart."""
        self._revision += given is _I.CHANGED
        self._incarnation += given is _I.RESTARTED
        start = {"incarnation": self._incarnation, "revision": self._revision}
        self._fakes.order(do="beat", agent=self.agent, period_s=period_s, **start)

    async def beats(self, *inputs: Input) -> None:
        """Let it beat, time after time, and wait until each has had its effect."""
        for given in inputs:
            self.beat(given)
            await self.sees(given)

    async def falls_silent(self) -> None:
        """Let it beat for the last time, and wait until it is missed."""
        self.beat(period_s=MIN_PERIOD_S)
        await self.sees(_I.SILENT)

    async def stands(self, told: Announced) -> None:
        """Bring it where local consumers have been told so much of it."""
        if told is Announced.NOTHING:
            return
        self.mode("answer")
        await self.beats(_I.HEARD)
        await self.reaches(_S.ACTIVE)
        if told is Announced.LOST:
            await self.falls_silent()

    async def is_asked(self, told: Announced, mode: str) -> None:
        """Let the discoverer ask it, and say how it answers."""
        self.mode(mode)
        await self.beats(_I.HEARD if told is Announced.NOTHING else _I.CHANGED)


async def _whole_row(puppet: Puppet, told: Announced) -> None:
    await puppet.is_asked(told, "mute")
    await puppet.beats(_I.HEARD, _I.CHANGED, _I.RESTARTED)
    await puppet.sees(_I.FAILED)
    await puppet.beats(_I.HEARD, _I.CHANGED)
    await puppet.sees(_I.RETRY)
    await puppet.sees(_I.FAILED)
    await puppet.beats(_I.RESTARTED)
    puppet.mode("answer")
    await puppet.sees(_I.ANSWERED if told is Announced.NOTHING else _I.ANSWERED_ANEW)


async def _same_start_answers(puppet: Puppet, told: Announced) -> None:
    await puppet.is_asked(told, "answer")
    await puppet.sees(_I.ANSWERED)


async def _silent_when_asked(puppet: Puppet, told: Announced) -> None:
    await puppet.is_asked(told, "mute")
    await puppet.falls_silent()


async def _silent_when_it_failed(puppet: Puppet, told: Announced) -> None:
    await puppet.is_asked(told, "late")
    await puppet.sees(_I.FAILED)
    await puppet.falls_silent()


async def _comes_and_goes(puppet: Puppet, _: Announced) -> None:
    await puppet.beats(_I.HEARD, _I.RESTARTED)
    await puppet.sees(_I.ANSWERED_ANEW)
    await puppet.falls_silent()
    await puppet.beats(_I.HEARD)
    await puppet.falls_silent()
    await puppet.beats(_I.RESTARTED)
    await puppet.sees(_I.ANSWERED_ANEW)
    await puppet.falls_silent()
    await puppet.sees(_I.EXPIRED)


_ANYWHERE = (_whole_row, _same_start_answers, _silent_when_asked, _silent_when_it_failed)
_SCRIPTS = (
    *((script, told) for script in _ANYWHERE for told in Announced),
    (_comes_and_goes, Announced.PRESENT),
)


async def puppet_show(stage: Stage, *, attempts: int) -> None:
    """Play all scripts at once, `attempts` times at most while a transition of theirs is missing."""

    async def play(script: Any, puppet: Puppet, told: Announced) -> None:
        await puppet.stands(told)
        await script(puppet, told)

    for attempt in range(attempts):
        puppets = [Puppet(f"puppet{number}_{attempt}", stage) for number in range(len(_SCRIPTS))]
        plays = [
            play(script, puppet, told)
            for puppet, (script, told) in zip(puppets, _SCRIPTS, strict=True)
        ]
        for outcome in await asyncio.gather(*plays, return_exceptions=True):
            if isinstance(outcome, BaseException) and not isinstance(outcome, ProcessFailedError):
                raise outcome
        if set(TRANSITIONS) - _taken(stage) <= {(_S.BACKING_OFF, _I.EXPIRED)}:
            return


async def walk(member: Member, stage: Stage) -> None:
    """Do to a real status process what happens to real ones: change, stop, go on, be killed, come again."""
    agent = member.name
    track = Track(agent, stage)
    await stage.start(member)
    await track.sees(_I.ANSWERED)
    stage.fault(agent, "told another description")
    stage[agent].order(description={"software": ["changed at run time"]})
    await track.sees(_I.ANSWERED)
    for number, given in ((signal.SIGSTOP, _I.SILENT), (signal.SIGCONT, _I.HEARD)):
        stage.fault(agent, number.name)
        stage[agent].signal(number)
        await track.sees(given, at=_S.LOST if number is signal.SIGCONT else None)
    for wait in (False, True):
        stage.fault(agent, "SIGKILL")
        await stage.kill(agent)
        if wait:
            await track.reaches(_S.LOST)
        stage.fault(agent, "started again")
        await stage.start(member)
        # Asked anew as a rule; on a machine that stalls it may have been forgotten before it came again.
        await track.sees(_I.ANSWERED_ANEW, _I.ANSWERED)
    stage.fault(agent, "SIGKILL")
    await stage.kill(agent)
    await track.sees(_I.EXPIRED)


async def crowd(own: str, stage: Stage, *, places: int) -> None:
    """Send the discoverer of agent `own` more agents than its `places`, and what is no agent at all."""
    fakes = stage[FAKES]
    stage.fault(own, "heartbeats that bear its name")
    for agent, incarnation in (("owner1", 2000), ("double1", 1999)):
        beat = {"incarnation": incarnation, "revision": 0, "period_s": FOREVER_S}
        fakes.order(do="beat", agent=agent, bearing=own, **beat)
    stage.fault("noname1", "ill-formed heartbeats")
    for bearing, period_s in (("no name", FOREVER_S), ("camera", FOREVER_S), ("fast1", -1.0)):
        fakes.order(
            do="beat",
            agent="noname1",
            bearing=bearing,
            incarnation=1,
            revision=0,
            period_s=period_s,
        )
    stage.fault("crowd", "more agents than places, none of which answers")
    for number in range(places + 1):
        puppet = Puppet(f"crowd{number}", stage)
        await puppet.is_asked(Announced.NOTHING, "refuse")
        await puppet.sees(_I.FAILED)
    await stage.until("an eviction", lambda: (_S.BACKING_OFF, _I.EXPIRED) in _taken(stage))
    stage.fault("crowd", "a flood of heartbeats")
    fakes.order(
        do="beat",
        agent=f"crowd{places}",
        incarnation=1000,
        revision=1,
        period_s=FOREVER_S,
        times=400,
    )


def _is(move: Report, given: Sequence[Input], at: State | None) -> bool:
    return Input[move["given"]] in given and (at is None or move["before"] == at.name)


def _taken(stage: Stage) -> set[tuple[State, Input]]:
    return {
        (State[m["before"]], Input[m["given"]]) for moves in stage.moves.values() for m in moves
    }
