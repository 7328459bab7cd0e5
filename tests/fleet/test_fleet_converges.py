"""A fleet of whole agents loses its processes one after the other, converges again, and ends without trace."""

import asyncio
import json
import os
import signal
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

    def family(self) -> set[int]:
        """Return the pids of the process and all below it; none when it is gone."""
        with suppress(psutil.NoSuchProcess):
            return {self.pid, *(p.pid for p in psutil.Process(self.pid).children(recursive=True))}
        return set()

    def component(self, name: str) -> dict:
        """Return the last change of a supervisor's component."""
        mine = (r for r in reversed(self.reports) if r.get("component") == name)
        return next((r for r in mine if r["is"] == "component"), {"state": "", "crashes": 0})

    def events(self, since: int = 0) -> list[str]:
        """Return what a supervisor's discoverer has told of the other agent."""
        told = (r["report"] for r in self.reports[since:] if r["is"] == "report")
        return [r["event"] for r in told if r["is"] == "event"]


class Fleet:
    """Two agents, a camera on one and a viewer of it on the other."""

    def __init__(self, testbed: Testbed, remote: int, *locals_: int) -> None:
        self.testbed = testbed
        self.remote = remote
        self.local = {
            name: BusAddress(domain_id=domain, interface="lo")
            for name, domain in zip(AGENTS, locals_, strict=True)
        }
        self.agents = {}
        self.seen = set()  # every pid that ever belonged to it

    async def begin(self, name: str, *argv: str) -> Talker:
        return await Talker.begin(self.testbed.argv(name, [sys.executable, *argv]))

    async def start(self) -> None:
        size = {"width": 640, "height": 360, "rate_hz": 10}
        stream = StreamDescription(topic=STREAM, type=FFMPEG, codec="h264", **size)
        camera = SensorDescription(name="camera_front", streams=(stream,))
        for name, components in AGENTS.items():
            interface = self.testbed.interface(name)
            config = AgentConfig(
                agent=name,
                local=self.local[name],
                remote=BusAddress(domain_id=self.remote, interface=interface),
                components=components,
                sensors=(camera,) if name == "go2" else (),
                schedule=SCHEDULE,
                discovery=DISCOVERY,
                idle_timeout_s=0.2,
                detect=False,
            )
            told = argument_of(SupervisorConfig(components=plan(config), timing=SUPERVISION))
            self.agents[name] = await self.begin(name, "-m", "sfglab.fleet.agent.app", told)
        places = ((self.local["go2"], STREAM),)
        shots = argument_of(CameraConfig(places=places, fps=10, gop=10, encoder="libx264"))
        self.camera = await self.begin("go2", "-m", "sfglab.lab.workers.camera", shots)
        image, _ = routes_of_topic(STREAM)
        order = json.dumps([self.local["station"].options(), image.local_topic])
        self.viewer = await self.begin("station", "-c", VIEWER, order)

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
            {agent.component(component)["state"] for component in AGENTS[name]} == {"running"}
            and (agent.events() or ["LOST"])[-1] != "LOST"
            for name, agent in self.agents.items()
        )

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

    async def end(self) -> None:
        """End all in order; nothing stays."""
        for talker in self.talkers:
            await talker.close(grace_s=DEADLINE_S)
        assert {talker.status for talker in self.talkers} == {0}
        await self.until("all processes are gone", lambda: not any(map(lives, self.seen)))


KILLS = [
    *(("go2", component) for component in ("router", "status", "keeper")),
    *(("station", component) for component in ("discoverer", "decoder")),
]


async def test_components_that_are_killed_come_back_and_the_fleet_converges_and_ends(free_domains):
    with Testbed(*AGENTS) as testbed:
        fleet = Fleet(testbed, *free_domains(3))
        try:
            await fleet.start()
            for agent, component in KILLS:
                await fleet.until("all serve and know each other", fleet.is_together)
                await fleet.shows_new_pictures()
                await kill(fleet, agent, component)
        finally:
            await fleet.end()


async def kill(fleet: Fleet, agent: str, component: str) -> None:
    victim = fleet.agents[agent]
    (witness,) = (other for name, other in fleet.agents.items() if name != agent)
    mark, family, known = len(witness.reports), victim.family(), victim.component(component)
    below = {p.pid for p in psutil.Process(known["pid"]).children(recursive=True)}
    os.kill(known["pid"], signal.SIGKILL)
    await fleet.until(
        "it is missed", lambda: victim.component(component)["crashes"] > known["crashes"]
    )
    await fleet.until("all serve and know each other", fleet.is_together)
    await asyncio.sleep(SILENCE_S)  # for as long as silence could go unnoticed
    await fleet.until("they still do", fleet.is_together)
    await fleet.shows_new_pictures()
    assert not any(map(lives, below)), "what it had started is gone with it"
    await fleet.until("as many processes", lambda: len(victim.family()) == len(family))
    heard = witness.events(mark)
    if component == "status":
        assert "RESTARTED" in heard
    else:
        assert heard == [] or (component, heard) == ("router", ["LOST", "RETURNED"])
