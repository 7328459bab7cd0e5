"""Interoperability with real ROS 2: rclpy of two distributions on its own Fast DDS, beside our nodes."""

import asyncio
import itertools
import os
import sys
from collections import Counter

import numpy as np
import pytest
from beside import (
    OURS_LATCHED,
    STRING,
    asked,
    bent,
    echoed,
    listen,
    publish,
    started,
    until,
    without_padding,
)
from random_messages import random_message

from sfglab.bus import Node
from sfglab.lab.ros2 import distributions
from sfglab.messages import (
    default_message,
    message_types,
    register_interfaces,
    serialize,
    service_type,
)
from sfglab.messages.store import MessageError
from sfglab.qos import Durability, QoSProfile, Reliability, incompatibilities

PICTURES = 20
pytestmark = [pytest.mark.live, pytest.mark.ros]

PACKAGES = (
    *(
        "action_msgs",
        "builtin_interfaces",
        "geometry_msgs",
        "lifecycle_msgs",
        "nav_msgs",
        "rcl_interfaces",
    ),
    *("rosgraph_msgs", "sensor_msgs", "std_msgs", "trajectory_msgs", "unique_identifier_msgs"),
    "visualization_msgs",
)
# Later than Humble, whose types we have unless ROS_DISTRO says more; named here, so that more are noticed.
NEWER = {
    "geometry_msgs/msg/PolygonInstance",
    "geometry_msgs/msg/PolygonInstanceStamped",
    "geometry_msgs/msg/VelocityStamped",
    "nav_msgs/msg/Goals",
    "rcl_interfaces/msg/LoggerLevel",
    "rcl_interfaces/msg/SetLoggerLevelsResult",
}
# Added to a distribution after its release; rosbags does not have them there.
UNKNOWN = {"jazzy": {"nav_msgs/msg/Goals"}, "kilted": set()}
# One field more than in Humble: `test_types_are_those_of_the_distribution`.
CHANGED = {"sensor_msgs/msg/Range"}


async def common_types(process):
    theirs = set((await asked(process, "types", "types", packages=PACKAGES))["types"])
    assert theirs - set(message_types()) <= NEWER
    return sorted(theirs & set(message_types()) - CHANGED)


@pytest.mark.feature("Message types of ROS 2's own packages: 200 random values each")
@pytest.mark.slow
async def test_random_values_of_every_common_type_come_back_as_they_were(peer):
    async with peer() as ros:
        assert await bent(ros, await common_types(ros), times=200, seed=17) == []


NEWER_TYPES = """
import json, sys
import numpy as np
from random_messages import random_message
from sfglab.messages import deserialize, serialize
rng = np.random.default_rng(19)
given = {name: serialize(random_message(rng, name)) for name in sys.argv[1:]}
print(json.dumps({"is": "ready"}), flush=True)
sys.stdin.readline()
print(json.dumps({"is": "given", "cdr": {name: cdr.hex() for name, cdr in given.items()}}), flush=True)
back = {name: bytes.fromhex(cdr) for name, cdr in json.loads(sys.stdin.readline())["cdr"].items()}
same = {name: serialize(deserialize(cdr, name)) for name, cdr in back.items()} == given
print(json.dumps({"is": "compared", "same": same}), flush=True)
"""


@pytest.mark.feature("Types as this distribution has them")
async def test_types_are_those_of_the_distribution(peer, distribution):
    """In a process of its own, because a process has the types of one distribution."""
    names = sorted((NEWER | CHANGED) - {"rcl_interfaces/msg/LoggerLevel", *UNKNOWN[distribution]})
    argv = [
        "env",
        f"PYTHONPATH={os.pathsep.join(sys.path)}",
        sys.executable,
        "-c",
        NEWER_TYPES,
        *names,
    ]
    async with started("ours", argv) as ours, peer() as ros:
        given, back = (await asked(ours, "give", "given"))["cdr"], {}
        assert sorted(given) == names
        for name, cdr in given.items():
            (back[name],) = (await asked(ros, "pass_through", "passed", kind=name, cdr=[cdr]))[
                "cdr"
            ]
        assert (await asked(ours, "compare", "compared", cdr=back))["same"]


@pytest.mark.feature(
    "Own message packages, registered from their files", condition="without wstring"
)
async def test_a_package_of_a_user_s_own_is_registered_and_is_what_rclpy_has(peer, distribution):
    """rosidl's own package for tests: bounds, defaults, constants, arrays, and types of each other."""
    share = distributions()[distribution].python.parents[1] / "share" / "test_msgs"
    with pytest.raises(MessageError, match=r"given wstring, allowed: string"):
        register_interfaces(share / "msg" / "WStrings.msg")
    names = [name for name in register_interfaces(share) if "/msg/" in name]
    assert len(names) == 12
    assert service_type("test_msgs/srv/Arrays").name == "test_msgs/srv/Arrays"
    async with peer() as ros:
        assert await bent(ros, names, times=10, seed=20) == []


@pytest.mark.feature("Topics of every common type, both ways")
async def test_every_common_type_crosses_both_ways(peer, domain_id):
    rng = np.random.default_rng(18)
    async with peer() as ros, Node("us", domain_id=domain_id) as node:
        given = {
            name: without_padding(random_message(rng, name)) for name in await common_types(ros)
        }
        back = await echoed(ros, node, given)
        assert sorted(given.keys() - back.keys()) == []
        assert back == {name: serialize(message) for name, message in given.items()}


@pytest.mark.feature(
    "Images of 640 x 480, both ways",
    condition="reliable: best effort loses some with Linux's socket buffer, and a few in a hundred at 30 Hz",
)
async def test_pictures_come_back_whole(peer, domain_id):
    kind = "sensor_msgs/msg/Image"
    qos = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=PICTURES)
    rng = np.random.default_rng(21)
    given = []
    for _ in range(PICTURES):
        data = rng.integers(0, 256, 480 * 640 * 3, np.uint8)
        given.append(
            default_message(kind, height=480, width=640, step=3 * 640, encoding="rgb8", data=data)
        )
    back, own = [], {"durability": "transient_local", "depth": PICTURES}
    async with peer() as ros, Node("us", domain_id=domain_id) as node:
        node.create_subscription(kind, "/back/sensor_msgs_msg_Image", back.append, qos)
        publisher = node.create_publisher(kind, "/forth/sensor_msgs_msg_Image", qos)
        await asked(ros, "echo", "echoing", types=[kind], qos=own)
        for picture in given:
            publisher.publish(picture)
            await asyncio.sleep(0.1)
        await until(lambda: len(back) == PICTURES)
    assert [serialize(one) for one in back] == [serialize(one) for one in given]


PROFILES = [
    QoSProfile(reliability=reliability, durability=durability, depth=1)
    for reliability, durability in itertools.product(Reliability, Durability)
]


def named(profile):
    return {
        "reliability": profile.reliability.value,
        "durability": profile.durability.value,
        "depth": 1,
    }


@pytest.mark.feature("Reliability and durability: who hears whom")
async def test_who_hears_whom_is_what_request_versus_offered_says(peer, domain_id):
    pairs = dict(enumerate(itertools.product(PROFILES, PROFILES)))
    expected = {n for n, (o, r) in pairs.items() if not incompatibilities(offered=o, requested=r)}
    heard = Counter()
    async with peer() as ros, Node("us", domain_id=domain_id) as node:
        publishers = []
        for n, (offered, requested) in pairs.items():
            node.create_subscription(
                STRING, f"/to_us/pair{n}", lambda _, n=n: heard.update([n]), requested
            )
            publishers.append(node.create_publisher(STRING, f"/to_ros/pair{n}", offered))
            await listen(ros, f"/to_ros/pair{n}", named(requested))
        told = set()

        def note(report):
            if report["is"] == "heard":
                told.add(int(report["topic"].rpartition("pair")[2]))

        ros.on_report = note

        async def everybody():
            for n, (offered, _) in pairs.items():
                publishers[n].publish(default_message(STRING))
                await publish(ros, f"/to_us/pair{n}", named(offered))
            return expected <= told and expected <= heard.keys()

        await until(everybody)
        assert told == set(heard) == expected


@pytest.mark.feature("Graph: nodes, endpoints and QoS, also when they end")
async def test_each_side_sees_the_other_in_its_graph_and_sees_it_go(peer, domain_id):
    async with Node("us", domain_id=domain_id, namespace="/lab") as node:
        async with peer("ros_node") as ros:
            publisher = node.create_publisher(STRING, "/chatter", OURS_LATCHED)
            await publish(ros, "/answer", cdr=[])

            async def graph_has(node_name, topic):
                graph = await asked(ros, "graph", "graph")
                kinds = {
                    (e["kind"], e["reliability"], e["durability"])
                    for e in graph["ends"].get(topic, ())
                }
                return (
                    node_name in graph["nodes"]
                    and ("PUBLISHER", "reliable", "transient_local") in kinds
                )

            def we_see():
                names = {f"{each.namespace.rstrip('/')}/{each.name}" for each in node.graph.nodes()}
                found = [end.qos.durability for end in node.graph.publishers("/answer")]
                return "/ros_node" in names and found == [Durability.TRANSIENT_LOCAL]

            await until(lambda: graph_has("/lab/us", "/chatter"))
            await until(we_see)
            publisher.close()

            async def publisher_gone():
                return not (await asked(ros, "graph", "graph"))["ends"].get("/chatter")

            await until(publisher_gone)
        await until(lambda: not node.graph.publishers("/answer"))


@pytest.mark.feature("Bytes behind a message, as rclpy sends serialised ones")
async def test_bytes_behind_a_message_do_not_matter(peer, domain_id):
    message = default_message(STRING, data="three")
    heard = []
    async with peer() as ros, Node("us", domain_id=domain_id) as node:
        node.create_subscription(STRING, "/padded", lambda m: heard.append(m.data), OURS_LATCHED)
        await publish(ros, "/padded", cdr=[(serialize(message) + b"\0" * 8).hex()])
        await until(lambda: heard == ["three"])


@pytest.mark.feature("Nodes kept on this host")
async def test_nodes_kept_on_this_host_meet(peer, domain_id):
    heard = []
    async with (
        peer(ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST") as ros,
        Node("us", domain_id=domain_id, interface="lo") as node,
    ):
        node.create_subscription(STRING, "/here", heard.append, OURS_LATCHED)
        await publish(ros, "/here")
        await until(lambda: heard)
