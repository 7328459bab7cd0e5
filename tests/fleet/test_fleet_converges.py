"""A fleet of whole agents loses its processes one after the other, converges again, and ends without trace."""

import asyncio
import json
import os
import signal
import subprocess
import sys
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
# Short, yet a process that starves on a busy machine for a second is not taken for lost.
SCHEDULE = Schedule(startup_period_s=0.4, steady_period_s=0.4, startup_s=0)
DISCOVERY = DiscoveryTiming(
    missed=3, slack_ns=600_000_000, backoff_ns=100_000_000, backoff_max_ns=500_000_000
)
SUPERVISION = ProcessTiming(backoff_ns=50_000_000, backoff_max_ns=400_000_000)
SILENCE_S = 3 * 0.4 + 0.6

VIEWER = """
import asyncio, json, sys
from sfglab.bus import Node
from sfglab.messages import ns_from_stamp
from sfglab.component import claim_standard_output, run, standard_input_lines
from sfglab.qos import SENSOR_DATA

async def main():
    report = claim_standard_output()
    address, topic = json.loads(sys.argv[1])
    async with Node("viewer", **address) as node:
        def see(image):
            report({"is": "picture", "stamp_ns": ns_from_stamp(image.header.stamp)})
        node.create_subscription("sensor_msgs/msg/Image", topic, see, qos=SENSOR_DATA, transport="shm")
        async for _ in standard_input_lines():
            pass

run(main())
"""
STREAM = "/global/go2/camera_front/color/ffmpeg"


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

    def changes(self, component: str) -> list[dict]:
        return [r for r in self.reports if r["is"] == "component" and r["component"] == component]

    def pid_of(self, component: str) -> int | None:
        """Return the process of a component that serves; None while it does not."""
        changes = self.changes(component)
        return changes[-1]["pid"] if changes and changes[-1]["state"] == "running" else None

    def crashes(self, component: str) -> int:
        return max(change["crashes"] for change in self.changes(component))

    def events(self, agent: str | None = None, since: int = 0) -> list[str]:
        told = (r["report"] for r in self.reports[since:] if r["is"] == "report")
        return [r["event"] for r in told if r["is"] == "event" and agent in (None, r["agent"])]


class Fleet:
    """Three agents, a camera on go2, and a viewer of it on the station."""

    def __init__(self, testbed: Testbed, first_domain: int) -> None:
        self.testbed = testbed
        self.first_domain = first_domain
        self.agents = {}
        self.seen = set()  # every pid that ever belonged to it

    def local(self, name: str) -> BusAddress:
        number = list(AGENTS).index(name)
        return BusAddress(domain_id=self.first_domain + 1 + number, interface="lo")

    async def begin(self, kind: type[Talker], name: str, *argv: str) -> Talker:
        return await kind.begin(self.testbed.argv(name, [sys.executable, *argv]))

    async def start(self) -> None:
        size = {"width": 640, "height": 360, "rate_hz": 10}
        stream = StreamDescription(topic=STREAM, type=FFMPEG, codec="h264", **size)
        camera = SensorDescription(name="camera_front", streams=(stream,))
        for name, components in AGENTS.items():
            remote = BusAddress(domain_id=self.first_domain, interface=self.testbed.interface(name))
            config = AgentConfig(
                agent=name,
                local=self.local(name),
                remote=remote,
                components=components,
                sensors=(camera,) if name == "go2" else (),
                schedule=SCHEDULE,
                discovery=DISCOVERY,
                idle_timeout_s=0.2,
                detect=False,
            )
            told = argument_of(SupervisorConfig(components=plan(config), timing=SUPERVISION))
            self.agents[name] = await self.begin(
                RunningAgent, name, "-m", "sfglab.fleet.agent.app", told
            )
        shots = CameraConfig(
            places=((self.local("go2"), STREAM),), fps=10, gop=10, encoder="libx264"
        )
        argv = "-m", "sfglab.lab.workers.camera", argument_of(shots)
        self.camera = await self.begin(Talker, "go2", *argv)
        image, _ = routes_of_topic(STREAM)
        order = json.dumps([self.local("station").options(), image.local_topic])
        self.viewer = await self.begin(Talker, "station", "-c", VIEWER, order)

    @property
    def talkers(self) -> list[Talker]:
        return [self.camera, self.viewer, *self.agents.values()]

    async def until(self, what: str, fact) -> None:
        try:
            async with asyncio.timeout(DEADLINE_S):
                while not fact():
                    self.seen |= {pid for talker in self.talkers for pid in talker.family()}
                    await asyncio.sleep(0.05)
        except TimeoutError:
            said = {name: agent.reports[-20:] for name, agent in self.agents.items()}
            pytest.fail(f"not within {DEADLINE_S} s: {what}; {said}")

    def is_together(self) -> bool:
        """Return whether all serve and know each other."""
        return all(
            all(map(agent.pid_of, AGENTS[name]))
            and all((agent.events(other) or ["LOST"])[-1] != "LOST" for other in {*AGENTS} - {name})
            for name, agent in self.agents.items()
        )

    async def converges(self) -> None:
        """Wait until all serve and know each other, for as long as silence could go unnoticed."""
        loop = asyncio.get_running_loop()
        since_s, events = loop.time(), -1

        def settled() -> bool:
            nonlocal since_s, events
            told = sum(len(agent.events()) for agent in self.agents.values())
            if told != events or not self.is_together():
                since_s, events = loop.time(), told
            return loop.time() - since_s > SILENCE_S

        await self.until("everything serves and everybody still knows everybody", settled)

    async def shows_new_pictures(self) -> None:
        """Wait for pictures that were taken from now on."""

        def shot() -> list[int]:
            sent = (r["frames"] for r in self.camera.reports if r["is"] == "sent")
            return [stamp_ns for frames in sent for _, stamp_ns, _ in frames]

        before = len(shot())
        await self.until("the camera shoots", lambda: len(shot()) > before)
        newest = shot()[-1]
        await self.until(
            "the viewer sees what the camera sees",
            lambda: any(r["stamp_ns"] > newest for r in self.viewer.reports[-1:]),
        )

    async def end(self) -> list[int]:
        return [await talker.end() for talker in self.talkers]


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
    [("go2", "router"), ("go2", "status"), ("station", "discoverer"), ("station", "decoder")],
)
def test_a_component_that_is_killed_comes_back_and_the_fleet_converges(world, agent, component):
    fleet, run = world
    victim = fleet.agents[agent]
    others = {name: other for name, other in fleet.agents.items() if name != agent}

    async def scenario():
        await fleet.until("everything serves and everybody knows everybody", fleet.is_together)
        if agent == "station":
            decoder = psutil.Process(victim.pid_of("decoder"))
            await fleet.until(
                "a pipeline runs and a spare waits", lambda: len(decoder.children()) == 2
            )
        marks = {name: len(other.reports) for name, other in others.items()}
        crashes, family = victim.crashes(component), victim.family()
        pid = victim.pid_of(component)
        below = {p.pid for p in psutil.Process(pid).children(recursive=True)}
        os.kill(pid, signal.SIGKILL)
        await fleet.until("it is missed", lambda: victim.crashes(component) == crashes + 1)
        await fleet.shows_new_pictures()
        await fleet.converges()
        assert not any(map(lives, below)), "what it had started is gone with it"
        await fleet.until(
            "as many processes as before", lambda: len(victim.family()) == len(family)
        )
        return marks

    marks = run(scenario())
    heard = {name: other.events(agent, marks[name]) for name, other in others.items()}
    if component == "status":
        assert all("RESTARTED" in events for events in heard.values()), heard
    elif component == "router":
        assert all(events in ([], ["LOST", "RETURNED"]) for events in heard.values()), heard
    else:
        assert not any(heard.values()), f"nobody else notices: {heard}"
    assert heard == {name: other.events(since=marks[name]) for name, other in others.items()}, (
        "nobody else was lost"
    )


def test_the_fleet_ends_in_order_and_leaves_nothing(world):
    fleet, run = world
    assert run(fleet.end()) == [0] * (2 + len(AGENTS))
    run(fleet.until("all processes are gone", lambda: not any(map(lives, fleet.seen))))
    for name in AGENTS if fleet.testbed.separate else ():
        argv = fleet.testbed.argv(name, ["cat", "/proc/net/unix"])
        assert (
            "sfglab" not in subprocess.run(argv, capture_output=True, text=True, check=True).stdout
        )
