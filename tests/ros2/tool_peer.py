"""A real node that says what the command line of ROS 2 would print, which its environments do not have."""

import random
import sys
import time
from hashlib import blake2b
from pathlib import Path

sys.path.append(str(Path(__file__).parent))

import service_peer
from topic_peer import interface, rclpy_peer, report


class Peer(service_peer.Peer):
    def seen(self):
        """Report topics and nodes, and endpoints in rclpy's words."""
        topics = dict(self.node.get_topic_names_and_types())
        report(
            "seen",
            topics=topics,
            nodes=[
                n.rstrip("/") + "/" + name for name, n in self.node.get_node_names_and_namespaces()
            ],
            ends={
                topic: [
                    [str(info) for info in self.node.get_publishers_info_by_topic(topic)],
                    [str(info) for info in self.node.get_subscriptions_info_by_topic(topic)],
                ]
                for topic in topics
            },
        )

    def beat(self, hz, seconds):
        """Publish numbered messages of topics on schedule, catching up what was missed; report when [s]."""
        made, sent_s = {topic: self.of_number(topic) for topic in hz}, {topic: [] for topic in hz}
        due = sorted(
            (n / hz[topic], topic, n) for topic in hz for n in range(round(hz[topic] * seconds))
        )
        start_s = time.perf_counter()
        for due_s, topic, number in due:
            time.sleep(max(0.0, start_s + due_s - time.perf_counter()))
            sent_s[topic].append(time.perf_counter() - start_s)
            self.publishers[topic].publish(made[topic](number))
        report("beaten", sent_s=sent_s)

    def of_number(self, topic):
        """Return what makes a topic's message with a number: text, or a picture of noise."""
        if "image" not in topic:
            return lambda number: interface("std_msgs/msg/String")(data=f"{number:07}")
        image = interface("sensor_msgs/msg/Image")(
            width=640, height=480, step=1920, encoding="bgr8"
        )
        image.data.frombytes(random.Random(1).randbytes(921600))

        def numbered(number):
            image.header.stamp.sec = number
            return image

        return numbered

    def gather(self, kinds):
        """Keep of each topic how many messages came, and the digest of their bytes without their heads."""
        self.digests = {topic: [0, blake2b()] for topic in kinds}
        for topic, kind in kinds.items():

            def take(cdr, kept=self.digests[topic]):
                kept[0] += 1
                kept[1].update(cdr[4:])

            self.kept.append(
                self.node.create_subscription(interface(kind), topic, take, 2000, raw=True)
            )
        report("gathering")

    def gathered(self):
        """Report what was kept."""
        report(
            "gathered",
            seen={topic: [n, kept.hexdigest()] for topic, (n, kept) in self.digests.items()},
        )


if __name__ == "__main__":
    rclpy_peer.main(Peer)
