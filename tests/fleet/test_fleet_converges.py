"""A fleet of whole agents loses its processes one after the other, converges again, and ends without trace."""

import asyncio
import itertools
import json
import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress

import psutil
import pytest
from cameras import FFMPEG
from waiting import DEADLINE_S, lives

from sfglab.bus.address import BusAddress
from sfglab.component import argument_of
from sfglab.fleet.agent.app import SupervisorConfig
from sfglab.fleet.agent.plan import AgentConfig, plan
from sfglab.fleet.decoder.streams import routes_of_topic
from sfglab.fleet.discovery.config import Timing as DiscoveryTiming
from sfglab.fleet.status.description import SensorDescription, StreamDescription
from sfglab.fleet.status.heartbeat import Schedule
from sfglab.lab.testbed import Testbed
from sfglab.lab.workers.camera import CameraConfig
from sfglab.machine import ProcessTiming
from sfglab.processes import LineProcess

pytestmark = [pytest.mark.live, pytest.mark.slow]

# What each runs: fewer decoders than a real fleet has, so that the test spares the machine.
AGENTS = {
    "go2": ("router", "status", "discoverer", "keeper"),
    "pi1": ("router", "status", "discoverer"),
    "station": ("router", "status", "discoverer", "decoder"),
}
SEED = 7
# Short, yet a process that starves on a busy machine for a second is not taken for lost.
SCHEDULE = Schedule(startup_period_s=0.4, steady_period_s=0.4, startup_s=0)
DISCOVERY = DiscoveryTiming(
    missed=3, slack_ns=600_000_000, backoff_ns=100_000_000, backoff_max_ns=500_000_000
)
SUPERVISION = ProcessTiming(backoff_ns=50_000_000, backoff_max_ns=400_000_000)
SILENCE_S = 3 * 0.4 + 0.6
PRESENT = {"DISCOVERED", "UPDATED", "RETURNED", "RESTARTED"}

VIEWER = """
import asyncio, json, sys, time
from sfglab.bus import Node
from sfglab.messages import ns_from_stamp
from sfglab.component import claim_standard_output, run, standard_input_lines
from sfglab.qos import SENSOR_DATA

async def main():
    report = claim_standard_output()
    address, topic = json.loads(sys.argv[1])
    async with Node("viewer", **address) as node:
        def see(image):
            stamp_ns = ns_from_stamp(image.header.stamp)
            report({"is": "picture", "stamp_ns": stamp_ns, "seen_ns": time.time_ns()})
        node.create_subscription("sensor_msgs/msg/Image", topic, see, qos=SENSOR_DATA, transport="shm")
        async for _ in standard_input_lines():
            pass

run(main())
"""


def stream_of(agent: str) -> str:
    return f"/global/{agent}/camera_front/color/ffmpeg"


def sensor_of(agent: str) -> SensorDescription:
    size = {"width": 640, "height": 360, "rate_hz": 10}
    stream = StreamDescription(topic=stream_of(agent), type=FFMPEG, codec="h264", **size)
    return SensorDescription(name="camera_front", streams=(stream,))


class Talker(LineProcess):
    """A process and the reports that it has given."""

    buffers_reports = False

    @classmethod
    async def begin(cls, argv):
        talker = await cls.start(argv[-2], argv)
        talker.reports = []
        talker.on_report = talker.reports.append
        return talker

    async def end(self) -> int:
        await self.close(grace_s=DEADLINE_S)
        return self.status

    def family(self) -> set[int]:
        """Return the pids of the process and all below it; none when it is gone."""
        with suppress(psutil.NoSuchProcess):
            return {
                self.pid,
                *(child.pid for child in psutil.Process(self.pid).children(recursive=True)),
            }
        return set()


class RunningAgent(Talker):
    """A supervisor as it is seen from outside: by its reports."""

    def pid_of(self, component: str) -> int | None:
        """Return the process of a component that serves; None while it does not."""
        mine = [r for r in self.reports if r["is"] == "component" and r["component"] == component]
        return mine[-1]["pid"] if mine and mine[-1]["state"] == "running" else None

    def crashes(self, component: str) -> int:
        return max(
            r["crashes"]
            for r in self.reports
            if r["is"] == "component" and r["component"] == component
        )

    def said(self, component: str, since: int = 0) -> list[dict]:
        mine = (
            r for r in self.reports[since:] if r["is"] == "report" and r["component"] == component
        )
        return [r["report"] for r in mine]

    def events(self, agent: str | None = None, since: int = 0) -> list[str]:
        told = (r for r in self.said("discoverer", since) if r["is"] == "event")
        return [r["event"] for r in told if agent in (None, r["agent"])]

    def streams(self) -> dict[str, str]:
        """Return the state of every stream that the decoder has told of."""
        return {r["local_topic"]: r["state"] for r in self.said("decoder") if r["is"] == "status"}

    def story(self) -> str:
        """Return what matters when a test fails."""
        states = {r["component"]: r["state"] for r in self.reports if r["is"] == "component"}
        lines = [r["line"] for r in self.reports if r["is"] == "line"]
        return f"{states}, heard {self.events()}, streams {self.streams()}, {lines[-20:]}"


class Fleet:
    """Three agents, a camera on go2, and a viewer of it on the station."""

    def __init__(self, testbed: Testbed, first_domain: int) -> None:
        self.testbed = testbed
        self.first_domain = first_domain
        self.agents = {}
        self.others = []
        self.kills = []  # when which process was killed, for whoever reads a failure
        self.seen = set()  # every pid that ever belonged to it

    def local(self, name: str) -> BusAddress:
        return BusAddress(
            domain_id=self.first_domain + 1 + list(AGENTS).index(name), interface="lo"
        )

    def config(self, name: str) -> AgentConfig:
        return AgentConfig(
            agent=name,
            local=self.local(name),
            remote=BusAddress(domain_id=self.first_domain, interface=self.testbed.interface(name)),
            components=AGENTS[name],
            sensors=() if name == "station" else (sensor_of(name),),
            schedule=SCHEDULE,
            discovery=DISCOVERY,
            supervision=SUPERVISION,
            idle_timeout_s=0.2,
            detect=False,
        )

    async def start_agent(self, name: str) -> None:
        config = self.config(name)
        told = argument_of(SupervisorConfig(components=plan(config), timing=config.supervision))
        argv = self.testbed.argv(name, [sys.executable, "-m", "sfglab.fleet.agent.app", told])
        self.agents[name] = await RunningAgent.begin(argv)

    async def start(self) -> None:
        for name in AGENTS:
            await self.start_agent(name)
        places = ((self.local("go2"), stream_of("go2")),)
        camera = CameraConfig(places=places, fps=10, gop=10, encoder="libx264")
        argv = [sys.executable, "-m", "sfglab.lab.workers.camera", argument_of(camera)]
        self.camera = await Talker.begin(self.testbed.argv("go2", argv))
        self.others.append(self.camera)
        image, _ = routes_of_topic(stream_of("go2"))
        order = json.dumps([self.local("station").options(), image.local_topic])
        argv = self.testbed.argv("station", [sys.executable, "-c", VIEWER, order])
        self.viewer = await Talker.begin(argv)
        self.others.append(self.viewer)

    async def until(self, what: str, fact) -> None:
        try:
            async with asyncio.timeout(DEADLINE_S):
                while not fact():
                    self.note_pids()
                    await asyncio.sleep(0.02)
        except TimeoutError:
            story = "\n".join(f"{name}: {agent.story()}" for name, agent in self.agents.items())
            pytest.fail(
                f"not within {DEADLINE_S} s: {what}\n{story}\npictures: {len(self.stamps())}"
            )

    def note_pids(self) -> None:
        for talker in (*self.agents.values(), *self.others):
            self.seen |= talker.family()

    def all_serve(self) -> bool:
        return all(all(map(agent.pid_of, AGENTS[name])) for name, agent in self.agents.items())

    def all_know_each_other(self) -> bool:
        return all(
            (agent.events(other) or ["LOST"])[-1] in PRESENT
            for name, agent in self.agents.items()
            for other in self.agents
            if other != name
        )

    async def is_together(self) -> None:
        """Wait until all serve and know each other."""
        await self.until(
            "everything serves and everybody knows everybody",
            lambda: self.all_serve() and self.all_know_each_other(),
        )

    async def converges(self) -> None:
        """Wait until all serve and know each other, for as long as silence could go unnoticed."""
        loop = asyncio.get_running_loop()
        since_s, events = loop.time(), -1

        def settled() -> bool:
            nonlocal since_s, events
            told = sum(len(agent.events()) for agent in self.agents.values())
            if told != events or not (self.all_serve() and self.all_know_each_other()):
                since_s, events = loop.time(), told
            return loop.time() - since_s > SILENCE_S

        await self.until("everything serves and everybody still knows everybody", settled)

    async def shows_new_pictures(self) -> None:
        """Wait for pictures that were taken from now on."""
        before = len(self.camera_stamps())
        await self.until("the camera shoots", lambda: len(self.camera_stamps()) > before)
        newest = max(self.camera_stamps())
        await self.until(
            "the viewer sees what the camera sees", lambda: (self.stamps() or [0])[-1] > newest
        )

    def stamps(self) -> list[int]:
        return [r["stamp_ns"] for r in self.viewer.reports]

    def camera_stamps(self) -> list[int]:
        return [
            stamp for r in self.camera.reports if r["is"] == "sent" for _, stamp, _ in r["frames"]
        ]

    def kill(self, agent: str, component: str) -> None:
        """Kill a component's process, if there is one that serves."""
        pid = self.agents[agent].pid_of(component)
        if pid is not None:
            self.kills.append((agent, component, time.time_ns()))
            os.kill(pid, signal.SIGKILL)

    def mark(self) -> dict[str, int]:
        return {name: len(agent.reports) for name, agent in self.agents.items()}

    async def end(self) -> list[int]:
        return [await talker.end() for talker in (*self.others, *self.agents.values())]


@pytest.fixture(scope="module")
def world():
    """The fleet and the loop it lives in, which runs only while a test or another wait does."""
    with Testbed(*AGENTS) as testbed, asyncio.Runner() as runner:
        fleet = Fleet(testbed, 100 + 4 * (os.getpid() % 25))
        try:
            runner.run(fleet.start())
            yield fleet, runner.run
        finally:
            runner.run(fleet.end())


@pytest.mark.parametrize(
    ("agent", "component"),
    [
        *(("go2", component) for component in ("router", "status", "keeper")),
        *(("station", component) for component in ("discoverer", "decoder", "router")),
    ],
)
def test_a_component_that_is_killed_comes_back_and_the_fleet_converges(world, agent, component):
    fleet, run = world
    victim = fleet.agents[agent]

    async def scenario():
        await fleet.is_together()
        if agent == "station":
            decoder = psutil.Process(victim.pid_of("decoder"))
            await fleet.until(
                "a pipeline runs and a spare waits", lambda: len(decoder.children()) == 2
            )
        marks = fleet.mark()
        crashes, family = victim.crashes(component), victim.family()
        below = {p.pid for p in psutil.Process(victim.pid_of(component)).children(recursive=True)}
        await asyncio.sleep(random.Random(f"{SEED} {agent} {component}").uniform(0, 0.5))
        fleet.kill(agent, component)
        await fleet.until("it is missed", lambda: victim.crashes(component) == crashes + 1)
        await fleet.shows_new_pictures()
        await fleet.converges()
        assert not any(map(lives, below)), "what it had started is gone with it"
        await fleet.until(
            "as many processes as before", lambda: len(victim.family()) == len(family)
        )
        return marks

    marks = run(scenario())
    heard = {n: a.events(agent, marks[n]) for n, a in fleet.agents.items() if n != agent}
    if component == "status":
        assert all("RESTARTED" in events for events in heard.values()), heard
    elif component == "router":
        assert all(events in ([], ["LOST", "RETURNED"]) for events in heard.values()), heard
    else:
        assert not any(heard.values()), f"nobody else notices: {heard}"
    others = [a.events(since=marks[n]) for n, a in fleet.agents.items() if n != agent]
    assert others == list(heard.values()), "nobody else was lost"


def test_no_stream_outlives_an_agent_that_ended_while_nobody_watched(world):
    fleet, run = world
    station = fleet.agents["station"]
    image, _ = routes_of_topic(stream_of("pi1"))

    async def scenario():
        await fleet.is_together()
        assert station.streams()[image.local_topic] == "IDLE"
        gone = fleet.agents.pop("pi1")
        fleet.kill("station", "discoverer")
        gone.signal(signal.SIGKILL)
        await gone.wait()
        await fleet.until(
            "its stream is withdrawn", lambda: station.streams()[image.local_topic] == "GONE"
        )
        await fleet.shows_new_pictures()
        await fleet.start_agent("pi1")
        await fleet.is_together()
        await fleet.until(
            "its stream is back", lambda: station.streams()[image.local_topic] == "IDLE"
        )

    run(scenario())


def test_a_fleet_whose_processes_die_at_random_converges(world):
    fleet, run = world
    rng = random.Random(SEED)

    async def scenario():
        for _ in range(8):
            await asyncio.sleep(rng.uniform(0, 0.4))
            agent = rng.choice(list(AGENTS))
            fleet.kill(agent, rng.choice(AGENTS[agent]))
        await fleet.converges()
        await fleet.shows_new_pictures()

    run(scenario())


def test_no_picture_was_shown_twice_or_late_but_the_first_of_a_stream_that_was_lost(world):
    """A replay that a router's death cut short stays latched in the others until the dead router's lease ends.

    A stream that is opened anew meanwhile may begin with the newest picture of that replay, which is old.
    """
    fleet, _ = world
    pairs = itertools.pairwise(fleet.viewer.reports)
    late = [(before, after) for before, after in pairs if after["stamp_ns"] <= before["stamp_ns"]]
    assert all(after["seen_ns"] - before["seen_ns"] > 300_000_000 for before, after in late), (
        fleet.kills
    )
    assert len(late) <= [component for _, component, _ in fleet.kills].count("router")


def test_the_fleet_ends_in_order_and_leaves_nothing(world):
    fleet, run = world
    assert run(fleet.end()) == [0] * (2 + len(AGENTS))
    run(fleet.until("all processes are gone", lambda: not any(map(lives, fleet.seen))))
    for name in AGENTS if fleet.testbed.separate else ():
        argv = fleet.testbed.argv(name, ["cat", "/proc/net/unix"])
        assert (
            "sfglab" not in subprocess.run(argv, capture_output=True, text=True, check=True).stdout
        )
