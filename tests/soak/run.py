"""Soak test: three agents with streams, and one fault every few seconds.

Each agent runs on a host of its own, with nodes of a user that exchange numbered messages, states
and frames. A seed draws the faults: components and agents are killed and stopped, links are cut,
processors are taken, and clocks are stepped. After each fault, all streams have to arrive again,
and all components have to run. The script prints the time until then. It exits with status 1 if a
recovery is late, or if a message arrives twice or out of order. It also exits with status 1 if a
process or a file is left at the end, or if the memory of a component would double within a day.
Memory is judged from the 20th minute on. With --keep-processes no fault ends a process. Then the
memory of all components and pipelines is judged, and may grow by less than 2 MB per hour. Receive
buffers of Cyclone DDS are small then, because a buffer becomes resident while it fills.
"""

import argparse
import asyncio
import os
import random
import signal
import struct
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
import psutil
from nodes import AGENTS, CAMERAS, STATE, VIEWER, Config, streams_of

from sfglab.component import argument_of
from sfglab.lab.hosts import Network
from sfglab.lab.hosts.host import members
from sfglab.processes import START_LIMIT_S, Member, ProcessGroup

HERE = Path(__file__).parent
#: Agents per component.
COMPONENTS = dict.fromkeys(("router", "status", "discoverer", "decoder"), AGENTS)
COMPONENTS["keeper"] = CAMERAS
PIPELINE = "pipeline"  #: A child of the viewer's decoder.
PLACES = COMPONENTS | {PIPELINE: (VIEWER,)}
#: Least and longest duration of each fault that an agent has as a whole, seconds.
LASTS_S = {
    "kill agent": (0, 0),
    "kill nodes": (0, 0),
    "clock": (0, 0),
    "suspend": (1, 12),
    "cut": (1, 12),
    "starve": (3, 6),
}
SIGNALS = {"kill": signal.SIGKILL, "stop": signal.SIGSTOP}  #: Faults of components.
#: Faults that end no process.
GENTLE = ("clock", "suspend", "cut", "starve")
#: Agent whose components are never ended, so that their memory can be judged.
SPARED = "spot"
GIVEN_UP_S = 60.0
GAP_S = 1.0
WARM_S = 600.0
JUDGED_S = 600.0
MOST_MB_PER_H = 2.0
# A receive buffer of Cyclone DDS becomes resident while messages fill it, and then the next one is
# allocated. Buffers of the default size, 1 MiB, grow for an hour here.
BUFFERS = "<Sizing><ReceiveBufferSize>256 kB</ReceiveBufferSize></Sizing>"
SMALL_BUFFERS = f"CYCLONEDDS_URI=<CycloneDDS><Domain>{BUFFERS}</Domain></CycloneDDS>"
LOOP = (sys.executable, "-S", "-c", "while True: pass")


class Program(Member):
    """A member whose configuration is its command line."""

    @property
    def command(self):
        return (sys.executable, *self.config)


class Soak(ProcessGroup):
    """The agents, the nodes of their users, and their faults."""

    def __init__(self, network, folder, seed, limit_s, keep_processes):
        self.problems = []
        self._keep_processes = keep_processes
        self.faults = 0
        self._network = network
        self._folder = folder
        self._rng = random.Random(seed)
        self._limit_s = limit_s
        self._begin_ns = time.monotonic_ns()
        self._pids = {name: {} for name in AGENTS}  # processes of components that serve
        self._seen = {name: set() for name in AGENTS}  # agents that an agent has discovered
        self._streams = {f"{s} at {name}'s nodes" for name in AGENTS for s in streams_of(name)}
        self._fresh = set()
        self._mark = 0
        self._changed = asyncio.Event()
        self._memory_mb = {}
        self._holders = set(members([host.inode for host in network.hosts.values()]))
        self._nodes = {}
        self._agents = {}
        (folder / "tmp").mkdir()
        for name in AGENTS:
            self._add(name)
        library = folder / "clock.so"
        source = HERE / "stepped_clock.c"
        subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
        programs = [*self._nodes.values(), *self._agents.values()]
        super().__init__(programs, wrap_command=self._on_host, on_report=self._hear)

    def _add(self, name):
        (self._folder / name).write_bytes(bytes(4096))  # the step of its clock
        config = argument_of(Config(agent=name, epoch_ns=self._begin_ns))
        nodes = (str(HERE / "nodes.py"), config)
        fleet = str(HERE / "fleet.yaml")
        agent = ("-m", "sfglab", "agent", "up", "--json", "--agent", name, "--fleet", fleet)
        self._nodes[name] = Program(name=f"{name}'s nodes", host=name, module="", config=nodes)
        self._agents[name] = Program(name=name, host=name, module="", config=agent)

    def _on_host(self, host, command):
        folder = self._folder
        variables = [f"TMPDIR={folder / 'tmp'}", f"LD_PRELOAD={folder / 'clock.so'}"]
        if self._keep_processes:
            variables.append(SMALL_BUFFERS)
        clock = f"SFGLAB_SOAK_CLOCK={folder / host}"
        return self._network.argv(host, ["env", *variables, clock, *command])

    def _hosted(self, *names):
        """Return the processes on the hosts of some agents."""
        inodes = [self._network.hosts[name].inode for name in names]
        return set(members(inodes)) - self._holders

    def _hear(self, name, report):
        match report:
            case {"is": "fresh", "mark": self._mark, "stream": stream}:
                self._fresh.add(f"{stream} at {name}")
            case {"is": "component", "component": component, "state": state, "pid": pid}:
                self._pids[name].pop(component, None)
                if state == "running":
                    self._pids[name][component] = pid
                if component == "discoverer":
                    self._seen[name].clear()
            case {"is": "report", "report": {"is": "event", "agent": agent, "event": "LOST"}}:
                self._seen[name].discard(agent)
            case {"is": "report", "report": {"is": "event", "agent": agent}}:
                self._seen[name].add(agent)
            case {"is": "line", "component": component, "line": line} if "Traceback" in line:
                self.problems.append(f"{component} of {name} printed {line}")
        self._changed.set()

    async def settle(self):
        """Wait until all streams arrive for the first time."""
        await self._recovery(self._begin_ns, 0, START_LIMIT_S)

    async def _recovery(self, after_ns, ended, limit_s):
        """Wait for messages that were sent after a time, and for a successor of an ended process.

        Return the seconds since that time, and what was last.
        """
        self._mark += 1
        self._fresh.clear()
        nodes = [program.name for program in self._nodes.values()]
        self.order(nodes, do="come", mark=self._mark, after_ns=after_ns)
        last = ""
        with suppress(TimeoutError):
            async with asyncio.timeout(limit_s):
                while lacking := self._lacking(ended):
                    last = lacking
                    self._changed.clear()
                    await self._changed.wait()
        return (time.monotonic_ns() - after_ns) / 1e9, last

    def _lacking(self, ended):
        for component, agents in COMPONENTS.items():
            for name in agents:
                if self._pids[name].get(component, ended) == ended:
                    return f"{component} of {name}"
        for name in AGENTS:
            for other in AGENTS:
                if other not in (name, *self._seen[name]):
                    return f"{other} for {name}"
        return min(self._streams - self._fresh, default="")

    def deck(self):
        """Yield faults indefinitely, in rounds that contain each kind and component once."""
        faults = [(kind, "") for kind in GENTLE]
        if not self._keep_processes:
            faults += [(kind, "") for kind in LASTS_S if kind not in GENTLE]
            faults += [(kind, component) for kind in SIGNALS for component in PLACES]
        while True:
            yield from self._rng.sample(faults, len(faults))

    async def strike(self, kind, component):
        """Cause one fault, wait for the recovery, and print both."""
        agents = set(PLACES.get(component, AGENTS))
        if kind in (*SIGNALS, "kill agent"):
            agents.discard(SPARED)
        name = self._rng.choice(sorted(agents))
        pid = self._pid(name, component)
        if component and not pid:
            return
        if self._rng.random() < 1 / 3:  # the viewer joins late
            self.order([self._nodes[VIEWER].name], do="leave")
            await asyncio.sleep(2.0)
        lasts_s = self._rng.uniform(*LASTS_S.get(kind, (0, 0)))
        after_ns = time.monotonic_ns()
        with ExitStack() as ending:
            await self._cause(kind, name, pid, ending)
            await asyncio.sleep(lasts_s)
        if lasts_s:
            after_ns = time.monotonic_ns()
        took_s, last = await self._recovery(after_ns, pid, GIVEN_UP_S)
        fault = f"{kind} {component or 'all'} of {name}"
        print(f"{fault:30} {lasts_s:6.1f} {took_s:9.1f}  {last}", flush=True)
        self.faults += 1
        if took_s > self._limit_s:
            self.problems.append(f"{fault}: {took_s:.1f} s, {last} was last")
        self._read_memory()

    def _pid(self, name, component):
        if component != PIPELINE:
            return self._pids[name].get(component, 0)
        with suppress(psutil.Error, KeyError, IndexError):
            decoder = psutil.Process(self._pids[name]["decoder"])
            return self._rng.choice(decoder.children(recursive=True)).pid
        return 0

    async def _cause(self, kind, name, pid, ending):
        """Begin a fault, and have `ending` call what ends it."""
        match kind:
            case "kill" | "stop":
                signal_all({pid}, SIGNALS[kind])
            case "kill agent":
                await self.kill(name)
                self._pids[name].clear()
                self._seen[name].clear()
                await self.start(self._agents[name])
            case "kill nodes":
                nodes = self._nodes[name]
                await self._judge_streams([nodes.name])
                await self.kill(nodes.name)
                await self.start(nodes)
            case "clock":
                step_s = round(10 ** self._rng.uniform(0, 8)) * self._rng.choice((-1, -1, 0, 1, 1))
                with (self._folder / name).open("r+b") as clock:
                    clock.write(struct.pack("l", step_s))
            case "suspend":
                asleep = self._hosted(name)
                ending.callback(signal_all, asleep, signal.SIGCONT)
                signal_all(asleep, signal.SIGSTOP)
            case "cut":
                ending.callback(self._network.set_connected, name, connected=True)
                self._network.set_connected(name, connected=False)
            case "starve":
                self._starve(name, ending)

    def _starve(self, name, ending):
        """Run an agent's processes on one core, beside endless loops."""
        cores = os.sched_getaffinity(0)
        ending.callback(lambda: pin(self._hosted(name), cores))
        pin(self._hosted(name), {max(cores)})
        for _ in range(3):
            loop = subprocess.Popen(LOOP)
            ending.callback(loop.wait)
            ending.callback(loop.kill)
            pin([loop.pid], {max(cores)})

    def _read_memory(self):
        for name in AGENTS if self._keep_processes else (SPARED,):
            with suppress(psutil.Error):
                for process in psutil.Process(self[name].pid).children(recursive=True):
                    with suppress(psutil.Error, IndexError):  # it may just have ended
                        module = process.cmdline()[2]
                        size_mb = process.memory_info().rss / 1e6
                        readings = self._memory_mb.setdefault((name, module, process.pid), [])
                        readings.append((time.monotonic(), size_mb))

    def _judge_memory(self):
        for (name, module, _), readings in self._memory_mb.items():
            at_s, sizes_mb = np.array(readings).T
            warm_s = at_s[0] + WARM_S
            if at_s[-1] <= warm_s + JUDGED_S:
                continue
            warm = at_s > warm_s
            slope = np.polyfit(at_s[warm] / 3600, sizes_mb[warm], 1)[0]
            growth = f"{sizes_mb[-1]:.0f} MB, {slope:+.2f} MB/h"
            print(f"memory of {module} of {name}: {growth}")
            grows = slope > MOST_MB_PER_H if self._keep_processes else 24 * slope > sizes_mb[-1]
            if grows:
                self.problems.append(f"memory of {module} of {name}: {growth}")

    async def _judge_streams(self, nodes):
        told = await self.ask("told", nodes, timeout_s=60, do="tell")
        for name, report in told.items():
            for stream in report["streams"]:
                wrong = stream["repeated"] + stream["disordered"]
                # A router asks nodes of the same name again for their states.
                if stream["name"].startswith(STATE):
                    wrong = 0
                if wrong or not stream["received"]:
                    self.problems.append(f"stream at {name}: {stream}")

    async def finish(self):
        """End the agents as their users do, and judge streams, memory and leftovers."""
        for name in AGENTS:
            self[name].signal(signal.SIGTERM)
        await asyncio.gather(*(self[name].wait() for name in AGENTS))
        nodes = [program.name for program in self._nodes.values()]
        self._judge_leftovers({self[name].pid for name in nodes})
        await self._judge_streams(nodes)
        await self.close()
        self._judge_leftovers(set())
        self.problems += [f"left: {path.name}" for path in (self._folder / "tmp").iterdir()]
        self._judge_memory()

    def _judge_leftovers(self, known):
        for pid in self._hosted(*AGENTS) - known:
            with suppress(psutil.Error):
                self.problems.append(f"left: {psutil.Process(pid).cmdline()}")


def pin(pids, cores):
    """Allow processes to run on some cores only."""
    for pid in pids:
        with suppress(OSError):
            for thread in Path(f"/proc/{pid}/task").iterdir():
                os.sched_setaffinity(int(thread.name), cores)


def signal_all(pids, number):
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, number)


async def soak(minutes, seed, limit_s, *, keep_processes=False):
    """Cause faults for some minutes, and return the number of faults and all problems."""
    with tempfile.TemporaryDirectory() as folder, Network() as network:
        for name in AGENTS:
            network.add_host(name)
        async with Soak(network, Path(folder), seed, limit_s, keep_processes) as agents:
            print("fault                          lasted recovered  last", flush=True)
            until_s = time.monotonic() + 60 * minutes
            for fault in agents.deck():
                if time.monotonic() > until_s:
                    break
                await agents.strike(*fault)
                await asyncio.sleep(GAP_S)
            await agents.finish()
    return agents.faults, agents.problems


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("minutes", nargs="?", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=10.0, help="Seconds for each recovery.")
    parser.add_argument("--keep-processes", action="store_true", help="No fault ends a process.")
    options = parser.parse_args()
    capability = Network.available()
    if not capability.ok:
        parser.error(f"the soak test needs network namespaces: {capability.reason}")
    run = soak(options.minutes, options.seed, options.limit, keep_processes=options.keep_processes)
    faults, problems = asyncio.run(run)
    print(*problems, f"{faults} faults, {len(problems)} problems", sep="\n")
    sys.exit(bool(problems))


if __name__ == "__main__":
    main()
