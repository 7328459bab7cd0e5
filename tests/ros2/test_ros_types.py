"""Types of services and types without a wheel, beside rclpy: what it makes of them; transforms both ways."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from beside import LATCHED, bent, echoed, listen, publish, until
from random_messages import random_message

from sfglab.bus import Node
from sfglab.lab.ros2 import distributions
from sfglab.messages import deserialize, message_type, message_types, register_interfaces, serialize
from sfglab.names import TF, TF_STATIC
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.buffer import FrameBuffer
from sfglab.spatial.frames.listener import TF_QOS, TF_STATIC_QOS, TRANSFORMS, FramesListener

pytestmark = [pytest.mark.live, pytest.mark.ros]

OURS = "sfglab_interfaces"
HASHES = """import json, sys
from sfglab.messages import message_types, type_hash
print(json.dumps({name: type_hash(name) for name in message_types() if name in sys.argv}))"""
# rosidl's own for tests.
NOT_SHIPPED = {"test_msgs"}


@pytest.mark.feature("Services' types of ROS 2's own packages")
async def test_services_that_we_bring_are_those_of_the_distribution(peer, distribution):
    share = distributions()[distribution].python.parents[1] / "share"
    files = [f for f in sorted(share.glob("*/srv/*.srv")) if f.parents[1].name not in NOT_SHIPPED]
    names = [
        f"{f.parents[1].name}/srv/{f.stem}_{half}"
        for f in files
        for half in ("Request", "Response")
    ]
    assert len(names) == 46
    assert set(names) <= set(message_types())
    for file in files:
        register_interfaces(file)  # refuses other fields
    async with peer() as ros:
        assert await bent(ros, names, times=10, seed=21) == []


@pytest.mark.feature("Hashes (RIHS01) of the types of ROS 2's own packages")
def test_types_have_the_hashes_of_the_distribution(distribution):
    """In a process of its own, because a process has the types of one distribution."""
    share = distributions()[distribution].python.parents[1] / "share"
    files = {f"{file.parents[1].name}/msg/{file.stem}": file for file in share.glob("*/msg/*.json")}
    argv = [sys.executable, "-c", HASHES, *files]
    ours = json.loads(subprocess.run(argv, check=True, capture_output=True).stdout)
    assert len(ours) > 130
    for name, hash_ in ours.items():
        theirs = json.loads(files[name].read_text("utf-8"))["type_hashes"]
        assert {"type_name": name, "hash_string": hash_} in theirs


@pytest.mark.feature(
    "Interfaces of sfglab and tf2_msgs, built by rosidl from what `sfglab interfaces` writes"
)
async def test_our_messages_services_and_actions_are_what_rosidl_makes_of_them(peer, own_types):
    inner = ("_Goal", "_Result", "_Feedback")  # rclpy has them inside of others only
    names = [name for name in message_types() if name.startswith((f"{OURS}/", "tf2_msgs/"))]
    names = [name for name in names if not name.endswith(inner)]
    assert len(names) == 7 + 2 + 5 + 2 + 2 + 5
    async with peer(PYTHONPATH=own_types) as ros:
        assert await bent(ros, names, times=20, seed=22) == []


@pytest.mark.feature("Topics of sfglab's own messages, both ways")
async def test_our_messages_cross_both_ways(peer, own_types, domain_id):
    rng = np.random.default_rng(23)
    names = [name for name in message_types() if name.startswith(f"{OURS}/msg/")]
    given = {name: random_message(rng, name) for name in names}
    async with peer(PYTHONPATH=own_types) as ros, Node("us", domain_id=domain_id) as node:
        assert await echoed(ros, node, given) == {
            name: serialize(message) for name, message in given.items()
        }


THEIRS = """
import importlib, json, sys
from rclpy.serialization import serialize_message

made = {}
for name in json.load(sys.stdin):
    package, kind, type_ = name.split("/")
    try:
        cls = getattr(importlib.import_module(f"{package}.{kind}"), type_)
    except (ImportError, AttributeError):
        continue
    made[name] = serialize_message(cls()).hex()
print(json.dumps(made))
"""
OURS_DIFFERENT = """
import json, sys
from sfglab.messages import default_message, deserialize, message_types
from sfglab.messages.text import to_yaml, values_of

def text(message):
    return to_yaml(values_of(message))

different = []
for name, cdr in json.load(sys.stdin).items():
    if name in message_types():  # and was not registered by another test
        theirs = deserialize(bytes.fromhex(cdr), name)
        if text(theirs) != text(default_message(name)):
            different.append(name)
print(different)
"""


@pytest.mark.feature("Default values of message types")
def test_new_messages_have_the_defaults_of_rclpy(distribution):
    def run(argv, given, **options):
        done = subprocess.run(
            argv, input=given, capture_output=True, text=True, check=True, **options
        )
        return done.stdout

    theirs = run(
        distributions()[distribution].argv("-c", THEIRS), json.dumps(list(message_types()))
    )
    assert len(json.loads(theirs)) > 150
    environment = os.environ | {"ROS_DISTRO": distribution}
    assert run([sys.executable, "-c", OURS_DIFFERENT], theirs, env=environment) == "[]\n"


def tree(parent, child, *position_m):
    """The message with one transform."""
    one = StampedTransform(
        parent=parent, child=child, stamp_ns=10**9, pose=Pose(position_m=position_m)
    )
    return message_type(TRANSFORMS)(transforms=[one.to_msg()])


ROS_EDGES = ("map", "ros/odom", 0, 2, 0), ("ros/odom", "ros/base", 0.5, 0, 0)


@pytest.mark.feature("TF: /tf and latched /tf_static, both ways")
async def test_transforms_reach_both_sides_latched_ones_also_who_comes_later(
    peer, own_types, domain_id
):
    heard = {}
    buffer = FrameBuffer()
    async with Node("us", domain_id=domain_id) as node:
        node.create_publisher(TRANSFORMS, TF_STATIC, TF_STATIC_QOS).publish(
            tree("map", "us/odom", 1, 0, 0)
        )
        moving = node.create_publisher(TRANSFORMS, TF, TF_QOS)
        async with peer(PYTHONPATH=own_types) as ros:

            def note(report):
                if report["is"] == "heard":
                    message = deserialize(bytes.fromhex(report["cdr"]), TRANSFORMS)
                    heard.update(
                        {(report["topic"], t.child_frame_id): t for t in message.transforms}
                    )

            ros.on_report = note
            fixed, base = (serialize(tree(*edge)).hex() for edge in ROS_EDGES)
            await publish(ros, TF_STATIC, LATCHED, [fixed], TRANSFORMS)
            # As tf2_ros listens: of two latched trees, a depth of one keeps what came last.
            for topic, qos in ((TF_STATIC, LATCHED | {"depth": 100}), (TF, {"depth": 100})):
                await listen(ros, topic, qos, TRANSFORMS)
            async with FramesListener(node, buffer):

                async def both_hear():
                    moving.publish(tree("us/odom", "us/base", 0, 0, 3))
                    await publish(ros, TF, {"depth": 100}, [base], TRANSFORMS)
                    return {"ros/base", "ros/odom"} <= {edge.child for edge in buffer.edges} and {
                        (TF_STATIC, "us/odom"),
                        (TF, "us/base"),
                    } <= heard.keys()

                await until(both_hear)
    assert tuple(buffer.look_up("map", "ros/base").position_m) == (0.5, 2, 0)
    assert heard[TF_STATIC, "us/odom"].transform.translation.x == 1
    assert heard[TF, "us/base"].transform.translation.z == 3
