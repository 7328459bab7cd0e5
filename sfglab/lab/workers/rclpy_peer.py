"""Peer that is a real ROS 2 node and follows orders: ``python rclpy_peer.py NAME``, see `sfglab.lab.ros2`.

Orders and reports are JSON lines. An order names a method of `Peer` as ``do``. The process also takes the
orders of `sfglab.lab.workers.scenario_player`, as one host of scenarios of the reliability model. It
identifies samples by their values, because Fast DDS sets its own source time stamps. With ``crowd`` after
its name it has no node of its own, only those of `Peer.start`. The script runs in ROS 2's own interpreter,
from Python 3.10 on, and imports nothing of sfglab.
"""

from __future__ import annotations

import importlib
import json
import os
import re
import sys
import threading
import time
from collections import Counter
from contextlib import suppress
from operator import attrgetter
from random import Random
from typing import Any

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import QoSProfile, qos_profile_sensor_data

_OUT = os.fdopen(os.dup(1), "w", buffering=1)
os.dup2(2, 1)  # output of libraries must not mix with reports


def report(kind: str, **values: Any) -> None:
    """Write a report of a kind, with values by name, to standard output as one line of JSON."""
    _OUT.write(json.dumps({"is": kind, **values}) + "\n")


def interface(name: str) -> Any:
    """Return the class of an interface, ``package/msg/Name``, or of a part of it, ``Name.Impl.Part``."""
    package, kind, title = name.split("/")
    return attrgetter(title)(importlib.import_module(f"{package}.{kind}"))


_WARM = 1500
"""Number of samples after which an asynchronous Fast DDS adds a heartbeat to each
(`sfglab.rtps.FAST_DDS_ASYNC`)."""
_SPARE_NS = 50_000_000
_MISSED_NS = 50_000_000
"""Delay from which a tick is skipped, ns; as in a timer, skipped ticks are not made up for (rcl/timer.c)."""


def topic_of(flow: str) -> str:
    """Return the topic of a flow, in which no part begins with a digit."""
    return re.sub(r"/(?=\d)", "/_", flow)


def sample_of(value: int, size_bytes: int) -> bytes:
    """Return the CDR of a text of a given size that contains a value's number."""
    letters = size_bytes - 9
    text = f"{value:>{letters}}".encode()
    return b"\x00\x01\x00\x00" + (letters + 1).to_bytes(4, "little") + text + b"\x00"


def columns_of(rows: list[tuple[int, int]]) -> Any:
    """Return pairs of times and values as two columns."""
    return np.array(rows, np.int64).reshape(-1, 2).T


class Peer:
    """Node with its publishers, subscriptions and counts."""

    executor_type: type[Executor] = SingleThreadedExecutor

    def __init__(self, name: str, kind: str = "") -> None:
        rclpy.init()
        self.name = name
        self.node: Any = None if kind == "crowd" else rclpy.create_node(name)
        self.executor = self.executor_type()
        if self.node:
            self.executor.add_node(self.node)
        self.kept: list[Any] = []
        self.ages_ns: list[int] = []
        self.publishers: dict[str, Any] = {}
        self.flows: dict[str, dict[str, Any]] = {}
        self.received: dict[str, list[tuple[int, int]]] = {}
        self.written: dict[str, list[tuple[int, int]]] = {}
        self.free_ns: Counter[str] = Counter()
        self.seed = 0
        self.warm = False
        self.thread = threading.Thread(target=self.spin)
        self.thread.start()

    def spin(self) -> None:
        """Run the executor until the context is shut down, also while entities that it waits for are destroyed."""
        while rclpy.ok():
            with suppress(ExternalShutdownException, InvalidHandle):
                self.executor.spin()

    def end(self) -> None:
        """Shut rclpy down in order, because a killed participant leaves its shared memory behind."""
        rclpy.try_shutdown()
        self.thread.join()
        if self.node:
            self.node.destroy_node()
        else:
            os._exit(0)  # the orderly end of a crowd would take as long as its discovery

    def obey(self, order: dict[str, Any]) -> None:
        """Call the method that an order names in ``do``, with its other entries; report an error instead of raising."""
        try:
            getattr(self, order.pop("do"))(**order)
        except Exception as error:  # noqa: BLE001 - the sender of the order must learn of every error
            report("failed", why=f"{type(error).__name__}: {error}")

    def open(self, flows: list[dict[str, Any]], seed: int = 0) -> None:
        """Make the local endpoints of flows, and wait for the others; the seed is that of the sensors' changes."""
        self.seed = seed
        here, kind = self.node.get_name(), interface("std_msgs/msg/String")
        self.flows = {flow["name"]: flow for flow in flows}
        for name, flow in self.flows.items():
            sends = flow["source"] == here
            depth = None if sends else flow["reader_depth"]
            profile = QoSProfile(depth=depth or flow["qos"]["depth"])
            if sends:
                self.publishers[name] = self.node.create_publisher(kind, topic_of(name), profile)
            else:
                topic, heard = topic_of(name), self.hearing(name)
                self.kept.append(
                    self.node.create_subscription(kind, topic, heard, profile, raw=True)
                )
        counts = self.node.count_publishers, self.node.count_subscribers
        while not all(count(topic_of(name)) for name in self.flows for count in counts):
            time.sleep(0.01)
        while not all(publisher.get_subscription_count() for publisher in self.publishers.values()):
            time.sleep(0.01)
        self.written = {name: [] for name in self.publishers}
        if self.publishers and not self.warm:
            name, publisher = next(iter(self.publishers.items()))
            for _ in range(_WARM):
                publisher.publish(sample_of(-1, self.flows[name]["size_bytes"]))
                time.sleep(2e-4)
            self.warm = True
        report("matched")

    def hearing(self, name: str) -> Any:
        """Return a callback that records a flow's samples and the times at which its simulated executor is done."""
        flow, received = self.flows[name], self.received.setdefault(name, [])
        executor, then = flow["executor"] or name, flow["then"]
        cost_ns = round(flow["service_s"] * 1e9)

        def heard(cdr: bytes) -> None:
            now_ns, text = time.time_ns(), cdr[8 : 7 + int.from_bytes(cdr[4:8], "little")]
            if (value := int(text)) <= 0:
                return
            done_ns = self.free_ns[executor] = max(self.free_ns[executor], now_ns) + cost_ns
            received.append((value, done_ns))
            if then:
                time.sleep(max(0, done_ns - time.time_ns()) / 1e9)
                self.send(then, value)

        return heard

    def send(self, name: str, value: int) -> None:
        """Publish a sample of a flow, unless its endpoint was destroyed while the sample waited."""
        if name not in self.written:
            return
        self.written[name].append((time.time_ns(), value))
        self.publishers[name].publish(sample_of(value, self.flows[name]["size_bytes"]))

    def agenda(self, name: str, start_ns: int, last_ns: int) -> list[int]:
        """Return the times at which a flow's sensor publishes; a local cache omits unchanged values."""
        flow = self.flows[name]
        if not flow["rate_hz"]:
            return []  # the flow of a processing chain has no times
        first_ns = start_ns + round(flow["phase_s"] * 1e9)
        dues = range(first_ns, last_ns, round(1e9 / flow["rate_hz"]))
        if not flow["cached"] or not flow["change_s"]:
            return list(dues)
        random = Random(f"{self.seed} {name}")
        change_ns: float = first_ns
        changed = []
        for due_ns in dues:
            if due_ns >= change_ns:
                changed.append(due_ns)
            while due_ns >= change_ns:
                change_ns += 1e9 * random.expovariate(1 / flow["change_s"])
        return changed

    def play(self, start_ns: int, duration_s: float, drain_s: float, result: str) -> None:
        """Publish the flows on schedule, wait for late samples, and write published and received ones into a file.

        Args:
            start_ns: Start of the schedule, Unix time, ns.
            duration_s: Duration of the schedule, s.
            drain_s: Wait for late samples, s.
            result: Path of the file.
        """
        last_ns = start_ns + round(duration_s * 1e9)
        agenda = []
        for name in self.publishers:
            dues = self.agenda(name, start_ns, last_ns)
            agenda += [(due_ns, value, name) for value, due_ns in enumerate(dues, 1)]
        # A host without flows to send measures wake-ups instead: their delay shows whether it could receive
        # in time.
        agenda = agenda or [(due_ns, 0, "") for due_ns in range(start_ns, last_ns, 5_000_000)]
        late_ns = []
        for due_ns, value, name in sorted(agenda):
            time.sleep(max(0, due_ns - time.time_ns()) / 1e9)
            late_ns.append(time.time_ns() - due_ns)
            if time.time_ns() > last_ns + _SPARE_NS:
                break
            if name and late_ns[-1] < _MISSED_NS:
                self.send(name, value)
        time.sleep(max(0, last_ns + round(drain_s * 1e9) - time.time_ns()) / 1e9)
        # Samples may still arrive, in the executor's thread.
        received = {name: rows.copy() for name, rows in self.received.items()}
        arrays: dict[str, Any] = {}
        for name, rows in self.written.items():
            arrays[f"{name} written sent_ns"], arrays[f"{name} written value"] = columns_of(rows)
        for name, rows in received.items():
            arrays[f"{name} received value"], arrays[f"{name} received done_ns"] = columns_of(rows)
        np.savez(result, **arrays)
        report("done", late_p95_s=sorted(late_ns)[len(late_ns) * 95 // 100] / 1e9)

    def close(self) -> None:
        """Destroy the endpoints of flows."""
        for publisher in self.publishers.values():
            self.node.destroy_publisher(publisher)
        for subscription in self.kept:
            self.node.destroy_subscription(subscription)
        self.publishers, self.kept, self.received, self.written = {}, [], {}, {}
        self.free_ns.clear()
        report("closed")

    def start(self, fleet: list[str], talkers: int, listeners: int) -> None:
        """Make the nodes of the agent with this name, and report when the first of them knows those of the fleet.

        Each node has a context of its own, which is one participant as in a process.
        """
        text, nodes = interface("std_msgs/msg/String"), []
        for number in range(talkers + listeners):
            rclpy.init(context=(context := Context()))
            role, topic = ("talker", number) if number < talkers else ("listener", number - talkers)
            node = rclpy.create_node(f"{role}_{topic}", namespace=self.name, context=context)
            if role == "talker":
                node.create_publisher(text, f"chatter_{topic}", 7)
            else:
                node.create_subscription(text, f"chatter_{topic}", self.kept.append, 10)
            nodes.append(node)
        self.kept += nodes
        services = len(
            nodes[0].get_service_names_and_types_by_node(nodes[0].get_name(), f"/{self.name}")
        )
        topics = len(fleet) * (2 * services * len(nodes) + max(talkers, listeners))
        while not self.complete(nodes[0], fleet, len(nodes), topics):
            time.sleep(0.02)
        report("resolved", t_ns=time.time_ns())

    def complete(self, node: Any, fleet: list[str], each: int, topics: int) -> bool:
        """Return whether a node knows all nodes of the fleet by name, and all topics, also those of services."""
        found = node.get_publishers_info_by_topic("/parameter_events")
        if sum(info.node_namespace.strip("/") in fleet for info in found) < each * len(fleet):
            return False
        names = [
            f"{name}/".split("/")[1] for name, _ in node.get_topic_names_and_types(no_demangle=True)
        ]
        return sum(name in fleet for name in names) >= topics

    def shoot(self, topic: str, width: int, height: int, hz: float) -> None:
        """Publish raw images of noise at a fixed rate from now on, best effort."""
        image = interface("sensor_msgs/msg/Image")
        publisher = self.node.create_publisher(image, topic, qos_profile_sensor_data)
        picture = image(width=width, height=height, step=3 * width, encoding="bgr8")
        picture.data.frombytes(np.random.default_rng(0).bytes(3 * width * height))

        def send() -> None:
            picture.header.stamp = self.node.get_clock().now().to_msg()
            publisher.publish(picture)

        self.kept.append(self.node.create_timer(1 / hz, send))
        report("shooting")

    def look(self, topic: str, depth: int = 0, **_: Any) -> None:
        """Read every pixel of every image of a topic, as `sfglab.lab.workers.viewer` does, until `stop`.

        With a depth the subscription is reliable, otherwise it has the QoS of sensor data.
        """
        ordered_ns, self.ages_ns = time.time_ns(), []

        def see(picture: Any) -> None:
            seen_ns, stamp = time.time_ns(), picture.header.stamp
            self.ages_ns.append(seen_ns - stamp.sec * 10**9 - stamp.nanosec)
            np.bitwise_xor.reduce(np.frombuffer(picture.data, np.uint64))
            if len(self.ages_ns) == 1:
                report("first", ordered_ns=ordered_ns, seen_ns=seen_ns)

        image = interface("sensor_msgs/msg/Image")
        profile = QoSProfile(depth=depth) if depth else qos_profile_sensor_data
        self.looking = self.node.create_subscription(image, topic, see, profile)

    def stop(self) -> None:
        """End the subscription, and report the ages of the images."""
        self.node.destroy_subscription(self.looking)
        report("seen", frames=len(self.ages_ns), ages_ns=self.ages_ns)


def main(kind: type[Peer] = Peer) -> None:
    """Start a peer with the program's arguments, and follow its orders, one line of JSON each, until input ends."""
    peer = kind(*sys.argv[1:])
    report("ready", distribution=os.environ.get("ROS_DISTRO", ""))
    try:
        for line in sys.stdin:
            peer.obey(json.loads(line))
    finally:
        peer.end()


if __name__ == "__main__":
    main()
