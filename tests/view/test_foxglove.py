"""Foxglove's door, held against a client of its protocol, and its bytes against another reader of CDR."""

import asyncio
import json
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from commands import called
from rosbags.typesys import Stores, get_typestore
from seen import at_work, interrupted
from waiting import until

from sfglab.bus import Node
from sfglab.errors import SfglabError
from sfglab.messages import default_message
from sfglab.qos import Durability, QoSProfile

pytest.importorskip("foxglove", reason="the extra 'view' is not installed")
websockets = pytest.importorskip("websockets", reason="the extra 'view' is not installed")

SCAN, WORD = "sensor_msgs/msg/LaserScan", "std_msgs/msg/String"
LATCHED = QoSProfile(durability=Durability.TRANSIENT_LOCAL)


async def advertised(client, *topics):
    """Wait until topics are advertised; return the channels by topic."""
    found = {}
    while not found.keys() >= set(topics):
        said = await client.recv()
        if isinstance(said, str) and (told := json.loads(said))["op"] == "advertise":
            found |= {channel["topic"]: channel for channel in told["channels"]}
    return found


async def message(client):
    """Return number of the subscription and bytes of the next message: opcode 1, number, time, bytes."""
    while True:
        said = await client.recv()
        if isinstance(said, bytes) and said[0] == 1:
            return struct.unpack_from("<I", said, 1)[0], said[13:]


async def looked_at(process, domain_id):
    """Publish a scan and a latched word, look at both as Foxglove's app does, and stop looking."""
    address = re.search(r"ws://\S+(?=;)", await asyncio.to_thread(process.stdout.readline))[0]
    async with (
        asyncio.timeout(120),
        Node("robot", domain_id=domain_id, interface="lo") as node,
        websockets.connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None) as client,
    ):
        scans, words = (
            node.create_publisher(SCAN, "/scan"),
            node.create_publisher(WORD, "/word", qos=LATCHED),
        )
        words.publish(default_message(WORD, data="said before"))
        channels = await advertised(client, "/scan", "/word")
        assert (scans.get_subscription_count(), words.get_subscription_count()) == (0, 0), (
            "nobody looks yet"
        )
        numbers = {topic: channels[topic]["id"] for topic in ("/scan", "/word")}
        wanted = [{"id": 10 + i, "channelId": number} for i, number in enumerate(numbers.values())]
        await asyncio.sleep(1)  # the library advertises a channel a moment before it knows it
        await client.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        await until(lambda: scans.get_subscription_count() == words.get_subscription_count() == 1)
        scans.publish(default_message(SCAN, ranges=np.array([1.0, 2.5], np.float32)))
        heard = dict([await message(client), await message(client)])
        await client.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [10, 11]}))
        await until(lambda: scans.get_subscription_count() == words.get_subscription_count() == 0)
        return channels, heard


@pytest.mark.live
def test_its_app_sees_topics_of_a_domain_and_only_what_it_looks_at_is_read(domain_id):
    where = ("--domain", domain_id, "--interface", "lo", "--to", "foxglove:0")
    with at_work("view", *where) as process:
        channels, heard = asyncio.run(looked_at(process, domain_id))
        assert interrupted(process) == (["ended"], 0)
    other = get_typestore(Stores.ROS2_HUMBLE)
    assert list(other.deserialize_cdr(heard[10], SCAN).ranges) == [1.0, 2.5]
    assert other.deserialize_cdr(heard[11], WORD).data == "said before"
    assert channels["/scan"] | {"id": 0, "schema": ""} == {
        "id": 0,
        "topic": "/scan",
        "encoding": "cdr",
        "schemaName": SCAN,
        "schemaEncoding": "ros2msg",
        "schema": "",
    }
    assert "float32[] ranges" in channels["/scan"]["schema"]


def test_a_fleets_layout_shows_its_frame_and_the_pictures_that_the_decoder_offers(tmp_path):
    fleet = Path(__file__).parents[2] / "data" / "fleets" / "lab.yaml"
    called("view", "--fleet", str(fleet), "--to", str(tmp_path / "a.json"))
    text = (tmp_path / "a.json").read_text()
    assert json.loads(text)["content"]["type"] == "split"
    pictures = re.findall(r'"imageTopic":"([^"]+)"', text)
    assert len(pictures) == 2
    assert all(re.fullmatch(r"/local/\w+/\w+/\w+/image_raw", topic) for topic in pictures)
    assert '"fixedFrame":"map"' in text


@pytest.mark.parametrize("more", [["a.mcap"], ["--to", "a.rrd"], ["--frame", "map"], ["--thin"]])
def test_it_is_live_and_alone(more):
    with pytest.raises(SfglabError, match=r"--to foxglove: given with more, allowed are --topic"):
        called("view", "--to", "foxglove", *more)


@pytest.mark.parametrize("place", ["foxglove:port", "foxglove::-1", "foxglove:256.0.0.1:99999"])
def test_an_address_that_is_none_is_named(place):
    with pytest.raises(SfglabError, match=r"given .*(port|-1|99999)"):
        called("view", "--to", place)
