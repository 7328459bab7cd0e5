"""Endpoints of zenoh-ros2-sdk: it repeats what it hears on a latched topic; with a router's host and port."""

import sys
import threading

from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

where = {"router_ip": sys.argv[1], "router_port": int(sys.argv[2]), "domain_id": 0}
string = {"msg_type": "std_msgs/msg/String", "msg_definition": "string data\n"}
latched = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=10)

publisher = ROS2Publisher(topic="/from_peer", node_name="peer", **string, **where)
subscriber = ROS2Subscriber(
    topic="/to_peer",
    callback=lambda message: publisher.publish(data=f"peer: {message.data}"),
    node_name="peer",
    qos=latched,
    **string,
    **where,
)
threading.Event().wait()
