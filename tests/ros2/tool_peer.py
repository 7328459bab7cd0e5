"""A real node that says what the command line of ROS 2 would print, which its environments do not have."""

import sys
import time
from pathlib import Path

sys.path.append(str(Path(__file__).parent))

import service_peer
from rclpy.serialization import deserialize_message
from rclpy_peer import interface, report


class Peer(service_peer.Peer):
    def seen(self, node):
        """Report topics, services and nodes, endpoints in rclpy's words, and what one node has."""
        name, namespace = node.rpartition("/")[2], node.rpartition("/")[0] or "/"
        topics = dict(self.node.get_topic_names_and_types())
        asked = {"Subscribers": "subscriber", "Publishers": "publisher"}
        asked |= {"Service Servers": "service", "Service Clients": "client"}
        report(
            "seen",
            topics=topics,
            services=dict(self.node.get_service_names_and_types()),
            nodes=[n.rstrip("/") + "/" + name for name, n in self.node.get_node_names_and_namespaces()],
            ends={
                topic: [
                    [str(info) for info in self.node.get_publishers_info_by_topic(topic)],
                    [str(info) for info in self.node.get_subscriptions_info_by_topic(topic)],
                ]
                for topic in topics
            },
            of_node={
                head: dict(getattr(self.node, f"get_{kind}_names_and_types_by_node")(name, namespace))
                for head, kind in asked.items()
            },
        )

    def has(self, name, value):
        """Report the names of parameters, and one of them, which is declared so."""
        self.node.declare_parameter(name, value)
        report("has", names=sorted(self.node._parameters))

    def now(self, name):
        """Report a parameter."""
        report("now", value=list(self.node.get_parameter(name).value))

    def shown(self, kind, cdr):
        """Report messages as rclpy shows them."""
        report("shown", texts=[repr(deserialize_message(bytes.fromhex(one), interface(kind))) for one in cdr])

    def beat(self, topic, cdr, times, rate_hz):
        """Publish on schedule, catching up what was missed, and report how fast it was."""
        message, start_s = bytes.fromhex(cdr), time.perf_counter()
        for number in range(times):
            time.sleep(max(0.0, start_s + number / rate_hz - time.perf_counter()))
            self.publishers[topic].publish(message)
        report("beaten", rate_hz=(times - 1) / (time.perf_counter() - start_s))


if __name__ == "__main__":
    service_peer.rclpy_peer.main(Peer)
