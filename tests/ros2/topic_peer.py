"""A real ROS 2 node that publishes, receives and reports its graph, like that of `sfglab.lab.ros2`.

Messages travel as CDR in hexadecimal digits.
"""

import importlib
import sys
from collections import Counter
from functools import partial
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "sfglab" / "lab" / "workers"))

import rclpy_peer
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rclpy_peer import interface, report


def profile_of(given):
    """Return a profile from names as ROS 2 prints them."""
    named = {
        k: v
        for k, v in given.items()
        if k in {"reliability", "durability", "history", "liveliness"}
    }
    spans_s = {
        k: v for k, v in given.items() if k.endswith(("deadline", "lifespan", "lease_duration"))
    }
    times = {name: Duration(seconds=span_s) for name, span_s in spans_s.items()}
    usual = QoSProfile(depth=1)
    values = {name: type(getattr(usual, name))[value.upper()] for name, value in named.items()}
    return QoSProfile(depth=given.get("depth", 10), **values, **times)


class Peer(rclpy_peer.Peer):
    def __init__(self, name):
        self.counts = Counter()
        super().__init__(name)

    def types(self, packages):
        """Report all message types that it has."""
        found = []
        for package in packages:
            module = importlib.import_module(f"{package}.msg")
            names = [
                name
                for name in dir(module)
                if hasattr(getattr(module, name), "_fields_and_field_types")
            ]
            found += [f"{package}/msg/{name}" for name in names]
        report("types", types=found)

    def pass_through(self, kind, cdr):
        """Read and write messages: what rclpy makes of our bytes."""
        messages = [deserialize_message(bytes.fromhex(one), interface(kind)) for one in cdr]
        report("passed", cdr=[serialize_message(message).hex() for message in messages])

    def echo(self, types, qos):
        """Publish each message below /forth again below /back, on one topic for each type."""
        for name in types:
            topic, kind, profile = name.replace("/", "_"), interface(name), profile_of(qos)
            publisher = self.node.create_publisher(kind, f"/back/{topic}", profile)
            self.kept.append(
                self.node.create_subscription(kind, f"/forth/{topic}", publisher.publish, profile)
            )
        report("echoing")

    def listen(self, kind, topic, qos, *, quiet=False):
        """Report every message of a topic, or only count them, and what happens to its QoS."""

        def heard(message):
            self.counts[topic] += 1
            if not quiet:
                report("heard", topic=topic, cdr=serialize_message(message).hex())

        def told(event, status):
            report("told", topic=topic, event=event, alive=getattr(status, "alive_count", None))

        tellers = {
            name: partial(told, name) for name in ("incompatible_qos", "deadline", "liveliness")
        }
        events = SubscriptionEventCallbacks(**tellers)
        message, profile = interface(kind), profile_of(qos)
        self.kept.append(
            self.node.create_subscription(message, topic, heard, profile, event_callbacks=events)
        )
        report("listening")

    def count(self):
        """Report how many messages of each topic came."""
        report("counts", counts=self.counts)

    def repeat(self, topic, cdr, times, rate_hz):
        """Publish a message again and again, and report the end of it."""
        publisher, message, left = self.publishers[topic], bytes.fromhex(cdr), iter(range(times))

        def send():
            if next(left, None) is not None:
                publisher.publish(message)
            else:
                timer.cancel()
                report("repeated", topic=topic)

        timer = self.node.create_timer(1 / rate_hz, send)

    def publish(self, kind, topic, qos, cdr):
        """Publish messages; the publisher stays."""
        if topic not in self.publishers:
            self.publishers[topic] = self.node.create_publisher(
                interface(kind), topic, profile_of(qos)
            )
        for one in cdr:
            self.publishers[topic].publish(bytes.fromhex(one))
        report("published")

    def unpublish(self, topics):
        """End publishers."""
        for topic in topics:
            self.node.destroy_publisher(self.publishers.pop(topic))
        report("unpublished")

    def graph(self):
        """Report nodes, topics and endpoints as the ROS 2 command line has them."""
        topics = dict(self.node.get_topic_names_and_types())
        ends = {}
        for name in topics:
            infos = [*self.node.get_publishers_info_by_topic(name)]
            infos += self.node.get_subscriptions_info_by_topic(name)
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
        nodes = [
            ns.rstrip("/") + "/" + name for name, ns in self.node.get_node_names_and_namespaces()
        ]
        report("graph", nodes=nodes, ends=ends)


if __name__ == "__main__":
    rclpy_peer.main(Peer)
