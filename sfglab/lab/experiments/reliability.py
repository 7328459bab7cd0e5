"""A soak: three agents with streams, and every few seconds a fault.

Components and whole agents are killed and stopped, links cut, processors taken, clocks stepped, disks filled,
as a seed says. After each fault all streams have to flow again, in order and without repeats; memory and
descriptors are followed, and nothing may be left at the end. `make soak`, ``python -m
sfglab.lab.experiments.reliability MINUTES [SEED]``, runs it alone and says what came of it.
"""

from __future__ import annotations

import asyncio
import json
import os
import random
import shutil
import signal
import struct
import subprocess
import sys
import time
from collections import Counter
from contextlib import ExitStack, asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import psutil

from sfglab.bus.address import BusAddress
from sfglab.component import Report, beside
from sfglab.fields import between
from sfglab.lab import growth
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled, SkippedPartError
from sfglab.lab.figures import COLORS, note
from sfglab.lab.hosts import LinkControlError
from sfglab.lab.hosts.host import members
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.starvation import starving
from sfglab.lab.stats import Estimate, median_of
from sfglab.lab.workers import soaked
from sfglab.lab.workers.soaked import STATE, SoakedConfig
from sfglab.processes import START_LIMIT_S, Member, ProcessGroup

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterator, Sequence

    import pandas as pd
    from matplotlib.figure import Figure

    from sfglab.lab.bench import Bench

#: Agents: those with a camera, and the one that looks at both.
CAMERAS, VIEWER = ("go2", "spot"), "pc"
AGENTS = (*CAMERAS, VIEWER)
COMPONENTS = ("router", "status", "discoverer", "keeper", "decoder", "pipeline")
ONLY = {"keeper": [*CAMERAS], "pipeline": [VIEWER], "full disk": [VIEWER]}
"""Where components and kinds of faults are that are not everywhere."""
#: How long faults last that are not at once, seconds.
LASTS_S = {"suspend": (1, 12), "cut": (1, 12), "starve": (3, 6), "full disk": (2, 4)}
KINDS = ("kill", "stop", "kill agent", "kill nodes", "clock", *LASTS_S)
GIVEN_UP_S = 60.0  #: After which a fault counts as not recovered from, seconds.
# Gives a command a small disk of its own, at the place that is named first.
DISK = ("unshare", "--mount", "sh", "-c", 'mount -t tmpfs -o size=32m disk "$0" && exec "$@"')
ENDS = ("kill", "stop", "kill agent")  #: Faults that end processes of an agent.


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    minutes: float = between(1.2, 0.1, 1440.0)  #: How long faults are drawn.
    gap_s: float = between(1.0, 0.0, 60.0)  #: From a recovery to the next fault, seconds.
    #: The agent whose components are not ended, so that their memory can be followed.
    spared: str = "spot"
    #: How long a process may still grow that is new, seconds: its buffers and heaps fill as they are used.
    warm_s: float = between(15.0, 0.0, 3600.0)
    limit_s: float = 10.0  #: Within which every stream has to flow again, seconds.
    kinds: tuple[str, ...] = KINDS  #: What happens.
    #: From one reading of processes to the next, seconds.
    sample_s: float = between(3.0, 0.1, 60.0)
    seed: int = 0  #: Seed of what happens when to whom.


exp = Experiment(
    "reliability",
    Config,
    where="beside all papers",
    smoke={"minutes": 0.4, "gap_s": 0.3},
    paper={"minutes": 30.0, "sample_s": 5.0, "warm_s": 600.0},
    hosts=tuple(AGENTS),
    actors=(
        Actor("user's nodes", "each of 3 agents", "count, shoot, look, record"),
        Actor("agent", "each of 3 agents", "sfglab agent up: five components and pipelines"),
        Actor("other agents", "the others", "the same"),
    ),
    links=(
        Link("user's nodes", "agent", "counted messages, a latched state, H.264"),
        Link("agent", "other agents", "the same, heartbeats, replays", boundary="border, network"),
        Link(
            "agent",
            "user's nodes",
            "the others' messages, decoded pictures",
            over="DDS, shared memory",
        ),
    ),
)


@exp.table("fault")
class SoakFaultRow:
    """A fault, and how all recovered from it."""

    kind: str  #: What was done.
    agent: str  #: To whom.
    component: str  #: To which of its components; empty: to the agent as a whole.
    begin_s: float  #: When, seconds since the beginning.
    lasted_s: float  #: How long it was done, seconds; 0: at once.
    recovered_s: float  #: From its end until all streams flowed and all agents were whole, seconds.
    slowest: str  #: Who was last.
    recovered: bool  #: Whether they did before they were given up.


@exp.table("process")
class SoakProcessRow:
    """What a process has."""

    t_s: float  #: When, seconds since the beginning.
    agent: str  #: Whose.
    who: str  #: Component, ``agent`` for their supervisor, or ``nodes`` for the user's.
    pid: int  #: Its process.
    rss_mb: float  #: Resident memory, MB.
    descriptors: int  #: Open descriptors.


@exp.table("stream")
class SoakStreamRow:
    """A stream at its consumer, at the end."""

    consumer: str  #: Agent.
    name: str  #: What and whose.
    received: int  #: How many messages.
    repeated: int  #: How many came again.
    disordered: int  #: How many came after a later one.
    damaged: int  #: How many pictures show another number than they have: decoded after a loss.


@exp.table("wrong")
class SoakWrongRow:
    """A picture or number that came again, or after a later one."""

    t_s: float  #: When, seconds since the beginning.
    consumer: str  #: At whom.
    name: str  #: What and whose.
    number: int  #: Which.
    last: int  #: The newest before.


@exp.table("left")
class SoakLeftRow:
    """Something that should not have been there at the end."""

    what: str  #: A process, a file, or an error that a component wrote.


class _Agent(Member):
    """An agent as its user starts it."""

    @property
    def command(self) -> tuple[str, ...]:
        up = (sys.executable, "-m", "sfglab", "agent", "up", "--json")
        return (*up, "--agent", self.name, "--fleet", self.config)


class Soak(ProcessGroup):
    """The agents, their users' nodes, and what is done to them."""

    def __init__(self, bench: Bench[Config]) -> None:
        self.rng, self.folder = random.Random(bench.config.seed), bench.folder("soak")
        #: Components that serve.
        self.pids: dict[str, dict[str, int]] = {name: {} for name in AGENTS}
        #: Which others are there.
        self.views: dict[str, dict[str, bool]] = {name: {} for name in AGENTS}
        self.errors: Counter[str] = Counter()  #: Tracebacks that components wrote.
        self._bench, self._network, self._begin_ns = (
            bench,
            bench.testbed.network,
            time.monotonic_ns(),
        )
        self._mark, self._fresh, self._changed = 0, set[str](), asyncio.Event()
        self._holders = set(members([host.inode for host in self._network.hosts.values()]))
        (self.folder / "tmp").mkdir()
        (self.folder / "disk").mkdir()
        (self.folder / "fleet.yaml").write_text(
            json.dumps(soaked.fleet(AGENTS, CAMERAS)), encoding="utf-8"
        )
        self._environment = ["env", f"TMPDIR={self.folder / 'tmp'}", *self._clocks()]
        self._users = {name: self._user(name, domain) for domain, name in enumerate(AGENTS, 1)}
        self._streams = {
            f"{s} at {user.name}" for user in self._users.values() for s in user.config.streams
        }
        file = str(self.folder / "fleet.yaml")
        self._agents = {
            name: _Agent(name=name, host=name, module="", config=file) for name in AGENTS
        }
        super().__init__(
            self._on_host, (*self._users.values(), *self._agents.values()), on_report=self._hear
        )

    def _clocks(self) -> list[str]:
        """Build what steps an agent's clock, and return how a process gets it."""
        for name in AGENTS:
            (self.folder / name).write_bytes(bytes(4096))
        if (compiler := shutil.which("cc")) is None:
            raise SkippedPartError(
                "there is no C compiler (cc), by which an agent's clock is stepped"
            )
        source, shim = Path(soaked.__file__).with_name("stepped_clock.c"), self.folder / "clock.so"
        subprocess.run(
            [compiler, "-O2", "-shared", "-fPIC", "-o", shim, source, "-ldl"], check=True
        )
        return [f"LD_PRELOAD={shim}"]

    def _on_host(self, host: str, command: Sequence[str]) -> list[str]:
        own = [*self._environment, f"SFGLAB_SOAK_CLOCK={self.folder / host}"]
        return self._bench.testbed.argv(host, [*DISK, str(self.folder / "disk"), *own, *command])

    def _user(self, name: str, domain: int) -> Member:
        config = SoakedConfig(
            agent=name,
            address=BusAddress(domain_id=domain, interface="lo"),
            others=tuple(other for other in AGENTS if other != name),
            epoch_ns=self._begin_ns,
            shoots=name in CAMERAS,
            views=CAMERAS if name == VIEWER else (),
            disk=str(self.folder / "disk") if name == VIEWER else "",
        )
        return Member(name=f"{name}'s user", host=name, module=soaked.__name__, config=config)

    def _of(self, *names: str) -> set[int]:
        return set(members([self._network.hosts[name].inode for name in names])) - self._holders

    def _seconds(self, at_ns: int) -> float:
        return (at_ns - self._begin_ns) / 1e9

    def _hear(self, name: str, report: Report) -> None:
        match report:
            case {"is": "fresh", "mark": self._mark, "stream": stream}:
                self._fresh.add(f"{stream} at {name}")
            case {"is": "wrong", "stream": stream, "t_ns": at_ns, "number": number, "last": last}:
                row = {"consumer": name, "name": stream, "number": number, "last": last}
                self._bench.write("wrong", {"t_s": self._seconds(at_ns), **row})
            case {"is": "component", "component": component, "state": state, "pid": pid}:
                self.pids[name].pop(component, None)
                if state == "running":
                    self.pids[name][component] = pid
                if component == "discoverer":
                    self.views[name] = {}
            case {"is": "report", "report": {"is": "event", "agent": agent, "event": event}}:
                self.views[name][agent] = event != "LOST"
            case {"is": "line", "component": component, "line": line} if "Traceback" in line:
                self.errors[f"{line} of {component} of {name}"] += 1
        self._changed.set()

    async def settle(self) -> None:
        """Return when all streams flow, or have had their time to."""
        await self.recovery(self._begin_ns, "", START_LIMIT_S)

    async def finish(self) -> None:
        """End the agents as users do, and write down what their streams were like and what is left."""
        for name in AGENTS:
            self[name].signal(signal.SIGTERM)
        await asyncio.gather(*(self[name].wait() for name in AGENTS))
        users = [user.name for user in self._users.values()]
        left = self._others({self[name].pid for name in users})
        await self._tell(users)
        await self.close()
        left += self._others(set())
        left += [f"file {path.name}" for path in (self.folder / "tmp").iterdir()]
        left += [f"{count} x {error}" for error, count in self.errors.items()]
        self._bench.write_all("left", [{"what": what} for what in left])

    def _others(self, known: set[int]) -> list[str]:
        found = []
        for pid in self._of(*AGENTS) - known:
            with suppress(psutil.Error):
                found.append(f"process {psutil.Process(pid).cmdline()}")
        return found

    async def _tell(self, users: list[str]) -> None:
        for name, told in (await self.ask("told", users, timeout_s=60, do="tell")).items():
            self._bench.write_all(
                "stream", [{"consumer": name, **stream} for stream in told["streams"]]
            )

    async def follow(self) -> None:
        """Read memory and descriptors of all processes, again and again."""
        while True:
            for name in AGENTS:
                own = {"agent": name, "nodes": self._users[name].name}
                pids = {who: self[member].pid for who, member in own.items() if member in self}
                for who, pid in (self.pids[name] | pids).items():
                    with suppress(psutil.Error):
                        process = psutil.Process(pid)
                        row = {
                            "t_s": self._seconds(time.monotonic_ns()),
                            "agent": name,
                            "who": who,
                            "pid": pid,
                        }
                        row |= {
                            "rss_mb": process.memory_info().rss / 1e6,
                            "descriptors": process.num_fds(),
                        }
                        self._bench.write("process", row)
            await asyncio.sleep(self._bench.config.sample_s)

    async def recovery(self, after_ns: int, old: str, limit_s: float) -> tuple[float, str, bool]:
        """Wait until all streams have brought what was sent after a time, and all agents are whole.

        A component ``NAME PID of AGENT`` that is old must have been replaced. Returns how long it took,
        seconds, who was last, and whether it was before the limit.
        """
        self._mark, self._fresh = self._mark + 1, set()
        self.order(
            [user.name for user in self._users.values()],
            do="come",
            mark=self._mark,
            after_ns=after_ns,
        )
        slowest, now_ns = "", after_ns
        with suppress(TimeoutError):
            async with asyncio.timeout(limit_s):
                while lacking := self._lacking(old):
                    self._changed.clear()
                    await self._changed.wait()
                    slowest, now_ns = lacking, time.monotonic_ns()
                return (now_ns - after_ns) / 1e9, slowest, True
        return limit_s, self._lacking(old), False

    def _lacking(self, old: str) -> str:
        for name in AGENTS:
            wanted = [c for c in COMPONENTS[:-1] if name in ONLY.get(c, AGENTS)]
            lacking = [f"{c} of {name}" for c in wanted if c not in self.pids[name]]
            lacking += [old for c, pid in self.pids[name].items() if old == f"{c} {pid} of {name}"]
            lacking += [
                f"{o} for {name}" for o in AGENTS if o != name and not self.views[name].get(o)
            ]
            if lacking:
                return lacking[0]
        return min(self._streams - self._fresh, default="")

    async def strike(self, kind: str, component: str) -> None:
        """Have a fault somewhere, wait for the recovery, and write both down."""
        spared = [self._bench.config.spared] if kind in ENDS else []
        name = self.rng.choice([a for a in ONLY.get(component or kind, AGENTS) if a not in spared])
        lasts_s = self.rng.uniform(*LASTS_S.get(kind, (0, 0)))
        if not (pid := self._pid(name, component)) and component:
            return  # it is not there
        if self.rng.random() < 1 / 3:  # then somebody joins late
            self.order([self._users[VIEWER].name], do="leave")
            await asyncio.sleep(2.0)
        begin_ns = time.monotonic_ns()
        async with self._fault(kind, name, pid):
            await asyncio.sleep(lasts_s)
        ended_ns = time.monotonic_ns() if lasts_s else begin_ns
        took_s, slowest, recovered = await self.recovery(
            ended_ns, f"{component} {pid} of {name}", GIVEN_UP_S
        )
        row = {
            "kind": kind,
            "agent": name,
            "component": component,
            "begin_s": self._seconds(begin_ns),
        }
        row |= {"lasted_s": (ended_ns - begin_ns) / 1e9, "recovered_s": took_s, "slowest": slowest}
        self._bench.write("fault", row | {"recovered": recovered})
        self._bench.advance(f"{kind} {component or 'all'} of {name}: {took_s:.1f} s")

    def _pid(self, name: str, component: str) -> int:
        if component != "pipeline":
            return self.pids[name].get(component, 0)
        with suppress(psutil.Error, KeyError, IndexError):
            return int(
                self.rng.choice(
                    psutil.Process(self.pids[name]["decoder"]).children(recursive=True)
                ).pid
            )
        return 0

    @asynccontextmanager
    async def _fault(self, kind: str, name: str, pid: int) -> AsyncIterator[None]:
        """Have a fault for the time of a block, or have had it."""
        with ExitStack() as stack:
            match kind:
                case "kill" | "stop":
                    _signal({pid}, signal.SIGKILL if kind == "kill" else signal.SIGSTOP)
                case "kill agent":
                    await self.kill(name)
                    self.pids[name], self.views[name] = {}, {}
                    await self.start(self._agents[name])
                case "kill nodes":
                    await self._tell([self._users[name].name])
                    await self.kill(self._users[name].name)
                    await self.start(self._users[name])
                case "clock":  # to another second up to three years away, or back to the right one
                    away_s = round(10 ** self.rng.uniform(0, 8)) * self.rng.choice(
                        (-1, -1, 0, 1, 1)
                    )
                    with (self.folder / name).open("r+b") as clock:
                        clock.write(struct.pack("l", away_s))
                case "suspend":
                    asleep = self._of(name)
                    stack.callback(_signal, asleep, signal.SIGCONT)
                    _signal(asleep, signal.SIGSTOP)
                case "cut":
                    stack.callback(self._network.set_link, name)
                    self._network.set_link(name, loss=1.0)
                case "starve":
                    stack.enter_context(starving(lambda: self._of(name)))
                case "full disk":
                    stack.callback(self.order, [self._users[name].name], do="free")
                    self.order([self._users[name].name], do="fill")
            yield


def _signal(pids: set[int], number: signal.Signals) -> None:
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, number)


def deck(config: Config) -> Iterator[tuple[str, str]]:
    """Yield kinds of faults and components for ever: in each round all kinds, and kills and stops of each."""
    rng = random.Random(config.seed)
    cards = [(k, c) for k in config.kinds for c in (COMPONENTS if k in ("kill", "stop") else [""])]
    while True:
        yield from rng.sample(cards, len(cards))


@exp.part("soak", total=lambda config: round(10 * config.minutes), skips=(LinkControlError,))
async def strike_all(bench: Bench[Config]) -> None:
    """Have one fault after the other, for so many minutes."""
    if not bench.testbed.separate:
        raise SkippedPartError(bench.testbed.description)
    async with Soak(bench) as soak, beside(soak.follow()) as (following,):
        until_s = time.monotonic() + 60 * bench.config.minutes
        for card in deck(bench.config):
            if time.monotonic() > until_s:
                break
            await soak.strike(*card)
            await asyncio.sleep(bench.config.gap_s)
        following.cancel()
        await soak.finish()


@derived
def recoveries(run: Run[Config]) -> pd.DataFrame:
    """Return by kind of fault how many there were, were over in time, their median and the longest, seconds."""
    faults = run["fault"]
    in_time = faults["recovered"] & (faults["recovered_s"] <= run.config.limit_s)
    groups = faults.assign(kind=_kinds(faults), in_time=in_time).groupby("kind", sort=False)
    columns = {"faults": ("kind", "size"), "in_time": ("in_time", "sum")}
    columns |= {"median_s": ("recovered_s", "median"), "longest_s": ("recovered_s", "max")}
    return groups.agg(**columns).reset_index().sort_values("median_s", ignore_index=True)


def _kinds(faults: pd.DataFrame) -> pd.Series:
    return (faults["kind"] + " " + faults["component"]).str.strip()


def slope(run: Run[Config], column: str, who: str = "") -> Estimate | None:
    """Return how fast memory (MB) or descriptors of a kind of process, without of all, grow in an hour."""
    rows = run["process"]
    steps = growth.steps(
        rows[rows["who"] == who] if who else rows, column, warm_s=run.config.warm_s
    )
    return growth.rate(steps, unit="MB/h" if column == "rss_mb" else "/h")


def problems(run: Run[Config]) -> list[str]:
    """Return what did not hold, a sentence each: recovery, order, no repeats, flat memory, nothing left.

    A state may come again: publishers that live under one name are asked for theirs anew.
    """
    faults, streams = run["fault"], run["stream"][~run["stream"]["name"].str.startswith(STATE)]
    late = faults[~faults["recovered"] | (faults["recovered_s"] > run.config.limit_s)]
    wrong = streams[
        (streams[["repeated", "disordered"]] > 0).any(axis=1) | (streams["received"] == 0)
    ]
    said = [
        f"{r.kind} {r.component} of {r.agent}: {r.recovered_s:.1f} s, {r.slowest}"
        for r in lines_of(late)
    ]
    said += [
        f"{r.name} at {r.consumer}: {r.repeated} again, {r.disordered} late"
        for r in lines_of(wrong)
    ]
    return [
        *said,
        *growth.growing(run["process"], warm_s=run.config.warm_s),
        *("left: " + what for what in run["left"]["what"]),
    ]


@exp.figure("reliability", size=(10, 4.2), when=lambda run: len(run["fault"]) > 0)
def draw(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw how long all took to recover, by kind of fault, and the components' memory over time."""
    table, faults, processes = recoveries(run), run["fault"], run["process"]
    left, right = figure.subplots(1, 2)
    for place, kind in enumerate(table["kind"]):
        took_s = faults.loc[_kinds(faults) == kind, "recovered_s"]
        left.plot(took_s, np.full(len(took_s), place), "o", color=COLORS["proxy"], alpha=0.6)
    left.axvline(run.config.limit_s, color=COLORS["standard"], linestyle="--", label="limit")
    left.set(xscale="log", xlabel="until all streams flow again (s)", xticks=[0.1, 1, 10])
    left.xaxis.set_major_formatter("{x:g}")
    left.set_yticks(range(len(table)), [f"{row.kind} ({row.faults})" for row in table.itertuples()])
    left.legend()
    whose = [*COMPONENTS[:-1], "agent"]
    lines = ("-", "-", ":", "--", "-.", "-")
    for color, line, who in zip([*COLORS.values(), "black"], lines, whose, strict=True):
        for number, (_, life) in enumerate(
            processes[processes["who"] == who].groupby(["agent", "pid"])
        ):
            right.plot(
                life["t_s"] / 60,
                life["rss_mb"],
                line,
                color=color,
                label="" if number else who,
                lw=1.2,
            )
    right.set(xlabel="time (min)", ylabel="resident memory (MB)", ylim=(0, None))
    right.legend(ncols=2)
    done = f"{table['in_time'].sum()} of {len(faults)} faults"
    figure.suptitle(f"All streams flow again within {run.config.limit_s:g} s after {done}")
    note(figure, f"{len(AGENTS)} agents, a point a fault, a line a life of a process", run)
    growth = {
        what: {who: slope(run, what, who) for who in whose} for what in ("rss_mb", "descriptors")
    }
    return {"recovered": table, "growth": growth}


def summary(run: Run[Config]) -> list[str]:
    """Return what came of it, a sentence each: faults, medians and growth."""
    faults, table = run["fault"], recoveries(run)
    said = [
        f"{table['in_time'].sum()} of {len(faults)} faults recovered within {run.config.limit_s:g} s"
    ]
    groups = {
        "a component": faults["component"] != "",
        "a whole agent": faults["kind"] == "kill agent",
    }
    for what, which in groups.items():
        if which.any():
            said.append(
                f"{what}: median {median_of(faults.loc[which, 'recovered_s'].to_numpy(), unit='s')}"
            )
    return said + [f"growth of a process: {slope(run, what)}" for what in ("rss_mb", "descriptors")]


def main(minutes: str, seed: str = "0") -> None:
    """Soak for some minutes and say what came of it; the exit status is 1 where something did not hold."""
    run = asyncio.run(exp.run("paper", minutes=float(minutes), seed=int(seed)))
    said = [recoveries(run).round(1).to_string(index=False), *summary(run), *problems(run)]
    sys.stdout.write("\n".join(said) + "\n")
    sys.exit(bool(problems(run)))


if __name__ == "__main__":
    main(*sys.argv[1:])
