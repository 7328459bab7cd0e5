"""A real ROS 2 node that does as it is told: orders as JSON lines in, reports as JSON lines out.

Runs in ROS 2's own interpreter and imports nothing of sfglab. Messages travel as CDR in hexadecimal digits.
"""

import importlib
import json
import os
import sys
import threading
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message

OUT = os.fdopen(os.dup(1), "w", buffering=1)
os.dup2(2, 1)  # what libraries print is no report


def report(kind, **values):
    OUT.write(json.dumps({"is": kind, **values}) + "\n")


def interface(name):
    package, kind, title = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), title)


def profile_of(given):
    """Return a profile from names as ROS 2 prints them."""
    named = {k: v for k, v in given.items() if k in {"reliability", "durability", "history"}}
    times = {
        k: rclpy.duration.Duration(seconds=v)
        for k, v in given.items()
        if k.endswith(("deadline", "lifespan", "lease_duration"))
    }
    values = {
        name: QoSProfile(depth=1).__getattribute__(name).__class__[value.upper()]
        for name, value in named.items()
    }
    return QoSProfile(depth=given.get("depth", 10), **values, **times)


class Peer:
    def __init__(self, name):
        rclpy.init()
        self.node = rclpy.create_node(name)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.kept = []
        self.publishers = {}
        threading.Thread(target=self.spin, daemon=True).start()

    def spin(self):
        with suppress(ExternalShutdownException):
            self.executor.spin()

    def types(self, packages):
        """Report all message types that it has."""
        found = []
        for package in packages:
            module = importlib.import_module(f"{package}.msg")
            found += [
                f"{package}/msg/{name}"
                for name in dir(module)
                if hasattr(getattr(module, name), "_fields_and_field_types")
            ]
        report("types", types=found)

    def pass_through(self, kind, cdr):
        """Read and write messages: what rclpy makes of our bytes."""
        report(
            "passed",
            cdr=[
                serialize_message(deserialize_message(bytes.fromhex(one), interface(kind))).hex() for one in cdr
            ],
        )

    def echo(self, types, qos):
        """Publish below /back whatever is published below /forth, a topic a type."""
        for name in types:
            topic, kind, profile = name.replace("/", "_"), interface(name), profile_of(qos)
            publisher = self.node.create_publisher(kind, f"/back/{topic}", profile)
            self.kept.append(self.node.create_subscription(kind, f"/forth/{topic}", publisher.publish, profile))
        report("echoing")

    def listen(self, kind, topic, qos):
        """Report every message of a topic."""

        def heard(message):
            report("heard", topic=topic, cdr=serialize_message(message).hex())

        self.kept.append(self.node.create_subscription(interface(kind), topic, heard, profile_of(qos)))
        report("listening")

    def publish(self, kind, topic, qos, cdr):
        """Publish messages; the publisher stays."""
        if topic not in self.publishers:
            self.publishers[topic] = self.node.create_publisher(interface(kind), topic, profile_of(qos))
        for one in cdr:
            self.publishers[topic].publish(bytes.fromhex(one))
        report("published")

    def graph(self):
        """Report nodes, topics and endpoints as the ROS 2 command line has them."""
        topics = dict(self.node.get_topic_names_and_types())
        ends = {}
        for name in topics:
            infos = [
                *self.node.get_publishers_info_by_topic(name),
                *self.node.get_subscriptions_info_by_topic(name),
            ]
            ends[name] = [
                {
                    "node": i.node_namespace.rstrip("/") + "/" + i.node_name,
                    "kind": i.endpoint_type.name,
                    "type": i.topic_type,
                    "reliability": i.qos_profile.reliability.name.lower(),
                    "durability": i.qos_profile.durability.name.lower(),
                }
                for i in infos
            ]
        nodes = [ns.rstrip("/") + "/" + name for name, ns in self.node.get_node_names_and_namespaces()]
        report("graph", nodes=nodes, ends=ends)


def main():
    peer = Peer(sys.argv[1])
    report("ready", distribution=os.environ.get("ROS_DISTRO", ""))
    for line in sys.stdin:
        order = json.loads(line)
        try:
            getattr(peer, order.pop("do"))(**order)
        except Exception as error:  # noqa: BLE001 - a refusal of ROS 2 is an answer
            report("refused", why=f"{type(error).__name__}: {error}")
    os._exit(0)


main()
