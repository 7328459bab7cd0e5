"""Robot or station of paper B's hallway as a process: ``python -m sfglab.lab.workers.hallway CONFIG``.

Robots have local caches, as in the method of the live lap (`sfglab.arp.robots.BEST`). The process adds
topics and timers to the state machines of `sfglab.arp.hallway`. For a robot it also
simulates the physics in real time. A robot's process has its sensing and actuation nodes, the station's has
localisation and planning. Order: ``{"do": "start"}``. Reports: ``ready`` when every topic has its peer,
``pose`` at each turn of the LIDAR, ``stopped`` when the station stopped all robots because of an obstacle,
``released`` at each new manoeuvre.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from sfglab.arp import LocalCache, hallway
from sfglab.bus import Node
from sfglab.bus.address import BusAddress
from sfglab.component import Orders, Reporter, run_component
from sfglab.messages import default_message, message_type
from sfglab.processes import START_LIMIT_S
from sfglab.qos import QoSProfile

STATION = "station"
BEAM, COMMAND = "std_msgs/msg/Float32", "geometry_msgs/msg/Twist"


@dataclass(frozen=True, slots=True, kw_only=True)
class HallwayConfig:
    """Configuration of the process of one robot or of the station."""

    role: str  #: Name of a robot, or ``station``.
    address: BusAddress  #: Address on the bus.
    rate_hz: float  #: Rate of each topic, Hz.
    depth: int  #: Depth of each topic's history, samples.
    seed: int = 0  #: Seed of the physics.

    @property
    def qos(self) -> QoSProfile:
        """QoS of every topic: RELIABLE, KEEP_LAST, as in Table 2."""
        return QoSProfile(depth=self.depth)


def beam_topic(robot: str, beam: int) -> str:
    """Return the name of a beam's topic."""
    return f"/{robot}/lidar_{hallway.BEAMS_DEG[beam]}"


def command_topic(robot: str) -> str:
    """Return the name of a robot's command topic."""
    return f"/{robot}/command"


class _Robot:
    """One robot: sensing, actuation, and the physics between them."""

    def __init__(self, node: Node, config: HallwayConfig, report: Reporter) -> None:
        self._node, self._config, self._report = node, config, report
        self._number = hallway.ROBOTS.index(config.role)
        # It is the whole world, in which only this robot moves. Its slips are those of the simulated run.
        self._world = hallway.World(seed=config.seed)
        self._measured: list[int] = []  # in the last turn of the LIDAR
        self._command = hallway.STOP
        self._cache = LocalCache()
        self.publishers = [
            node.create_publisher(BEAM, beam_topic(config.role, beam), config.qos)
            for beam in range(len(hallway.BEAMS_DEG))
        ]
        node.create_subscription(COMMAND, command_topic(config.role), self._hear, config.qos)

    async def run(self) -> None:
        """Drive until cancelled."""
        clock, start_ns, steps = self._node.get_clock(), self._node.get_clock().now_ns(), 0
        self._measured = self._world.scan(self._number)
        for beam in range(len(hallway.BEAMS_DEG)):
            self._node.create_timer(1 / self._config.rate_hz, partial(self._publish, beam))
        while True:
            commands = [hallway.STOP] * len(hallway.ROBOTS)
            commands[self._number] = self._command
            self._world.step(commands)
            steps += 1
            wound = self._world.wound_rad()
            if steps % hallway.SCAN_STEPS == 0:
                self._measured = self._world.scan(self._number)
                self._tell(steps * hallway.STEP_NS, float(wound[self._number]))
            early_ns = start_ns + steps * hallway.STEP_NS - clock.now_ns()
            # Sleep also if the step is late, so that messages are processed.
            await clock.sleep_for(max(0, early_ns) / 1e9)

    def _tell(self, now_ns: int, wound_rad: float) -> None:
        pose = {"pose": self._world.poses[self._number].tolist(), "wound_rad": wound_rad}
        pose["clearance_m"] = float(self._world.clearance_m[self._number])
        self._report({"is": "pose", "t_s": now_ns / 1e9, **pose})

    def _publish(self, beam: int) -> None:
        step = self._measured[beam]
        topic = beam_topic(self._config.role, beam)
        now_ns = self._node.get_clock().now_ns()
        if self._cache.offer(topic, step, now_ns=now_ns).passes:
            distance_m = np.float32(hallway.range_from_step(step))
            self.publishers[beam].publish(message_type(BEAM)(data=distance_m))

    def _hear(self, twist: Any) -> None:
        self._command = hallway.Command.from_velocities(twist.linear.x, twist.angular.z)


class _Station:
    """The station's nodes on their topics."""

    def __init__(self, node: Node, config: HallwayConfig, report: Reporter) -> None:
        self._node, self._config, self._report = node, config, report
        self._station = hallway.Station()
        self._said = self._station.manoeuvre
        self.publishers = [
            node.create_publisher(COMMAND, command_topic(name), config.qos)
            for name in hallway.ROBOTS
        ]
        for robot, name in enumerate(hallway.ROBOTS):
            for beam in range(len(hallway.BEAMS_DEG)):
                hear = partial(self._hear, robot, beam)
                node.create_subscription(BEAM, beam_topic(name, beam), hear, config.qos)

    async def run(self) -> None:
        """Publish commands until cancelled."""
        for robot in range(len(hallway.ROBOTS)):
            self._node.create_timer(1 / self._config.rate_hz, partial(self._publish, robot))
        await asyncio.Event().wait()

    def _hear(self, robot: int, beam: int, message: Any) -> None:
        self._station.hear(robot, beam, hallway.step_from_range(float(message.data)))
        if self._station.manoeuvre is self._said:
            return
        self._said = self._station.manoeuvre
        self._report({"is": "released", "manoeuvre": self._said.value})
        if self._station.stopped_by is not None:
            self._report({"is": "stopped", "robot": self._station.stopped_by})

    def _publish(self, robot: int) -> None:
        command = self._station.commands[robot]
        twist = default_message(COMMAND)
        twist.linear.x, twist.angular.z = command.speed_m_s, command.turn_rad_s
        self.publishers[robot].publish(twist)


async def serve(config: HallwayConfig, report: Reporter, orders: Orders) -> None:
    """Run the configured robot or station until cancelled; the module names orders and reports."""
    async with Node(config.role, **config.address.options()) as node:
        shell = (_Station if config.role == STATION else _Robot)(node, config, report)
        for publisher in shell.publishers:
            await publisher.wait_for_subscriptions(1, timeout_s=START_LIMIT_S)
        report({"is": "ready"})
        await orders.get()  # the order to start
        await shell.run()


if __name__ == "__main__":
    run_component(HallwayConfig, serve)
