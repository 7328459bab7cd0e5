"""A user's environment, publishers that come and go, and processes that die, beside real ROS 2."""

import asyncio
import sys
import time
from collections import Counter

import numpy as np
import pytest
from beside import ANSWER_S, OURS_LATCHED, STRING, asked, listen, publish, started, until

from sfglab.bus import Node
from sfglab.errors import InvalidValueError
from sfglab.messages import default_message
from sfglab.qos import Durability, QoSProfile

pytestmark = [pytest.mark.live, pytest.mark.ros]

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
ELSEWHERE = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='none0'/></Interfaces></General></Domain>"
    "</CycloneDDS>"
)
ENVIRONMENT = pytest.mark.feature(
    "A user's environment: domain, localhost only, discovery range, static peers"
)


@ENVIRONMENT
@pytest.mark.parametrize(
    "both",
    [
        {RANGE: "SUBNET", "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"},
        {"ROS_LOCALHOST_ONLY": "1"},
        {RANGE: "LOCALHOST", "ROS_STATIC_PEERS": "127.0.0.1", "CYCLONEDDS_URI": ELSEWHERE},
    ],
    ids=["subnet", "localhost only", "localhost and peers"],
)
async def test_the_same_environment_brings_both_together(peer, domain_id, monkeypatch, both):
    for name, value in {"ROS_DOMAIN_ID": str(domain_id), **both}.items():
        monkeypatch.setenv(name, value)
    heard = []
    async with peer(**both) as ros, Node("us") as node:
        node.create_subscription(STRING, "/here", heard.append, OURS_LATCHED)
        await publish(ros, "/here")
        await until(lambda: heard)


@ENVIRONMENT
async def test_range_off_keeps_everybody_out(peer, domain_id, monkeypatch):
    """A second node of ours, without the range, hears: so nothing was merely late."""
    heard = Counter()
    async with peer() as ros, Node("open", domain_id=domain_id) as there:
        there.create_subscription(STRING, "/here", lambda _: heard.update(["open"]), OURS_LATCHED)
        argv = [sys.executable, "-c", OURS, "shut", str(domain_id)]
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
        async with started("shut", argv) as shut:
            await publish(ros, "/here")
            await until(lambda: heard)
            assert "/shut" not in (await asked(ros, "graph", "graph"))["nodes"]
            assert (await asked(shut, "count", "counted"))["heard"] == 0


OURS = """
import asyncio, json, sys
from sfglab.bus import Node
from sfglab.qos import Durability, QoSProfile

async def main():
    heard = []
    async with Node(sys.argv[1], domain_id=int(sys.argv[2]), lease_s=1.5) as node:
        latched = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=1)
        node.create_subscription("std_msgs/msg/String", "/here", heard.append, latched)
        print(json.dumps({"is": "ready"}), flush=True)
        await asyncio.to_thread(sys.stdin.readline)
        print(json.dumps({"is": "counted", "heard": len(heard)}), flush=True)
        await asyncio.to_thread(sys.stdin.readline)

asyncio.run(main())
"""


@ENVIRONMENT
def test_a_domain_that_is_none_is_refused(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "seven")
    said = "ROS_DOMAIN_ID: given 'seven', allowed: a whole number from 0 to 232"
    with pytest.raises(InvalidValueError, match=said):
        Node("us")


CHURN = pytest.mark.feature("Publishers and processes that come, go and die")
ROUNDS, TOPICS = 3, 20


@CHURN
@pytest.mark.slow
async def test_publishers_come_and_go_on_either_side_and_nothing_is_left(peer, domain_id):
    topics = [f"/churn/t{n}" for n in range(TOPICS)]
    heard, told = Counter(), Counter()
    qos, ours = {"durability": "transient_local"}, QoSProfile(durability=Durability.TRANSIENT_LOCAL)
    async with peer() as ros, Node("us", domain_id=domain_id) as node:
        ros.on_report = lambda report: told.update(
            [report["topic"]] if report["is"] == "heard" else []
        )
        for topic in topics:
            node.create_subscription(
                STRING, topic, lambda _, topic=topic: heard.update([topic]), ours
            )
            await listen(ros, topic, qos)
        for wave in range(1, ROUNDS + 1):
            publishers = [node.create_publisher(STRING, topic, ours) for topic in topics]
            for publisher, topic in zip(publishers, topics, strict=True):
                publisher.publish(default_message(STRING))
                await publish(ros, topic, qos)
            enough = dict.fromkeys(topics, 2 * wave)
            await until(lambda enough=enough: told >= Counter(enough) and heard >= Counter(enough))
            for publisher in publishers:
                publisher.close()
            await asked(ros, "unpublish", "unpublished", topics=topics)
        assert max(told.values()) == max(heard.values()) == 2 * ROUNDS, "nothing twice"

        async def nobody_left():
            ends = (await asked(ros, "graph", "graph"))["ends"]
            kinds = {end["kind"] for topic in topics for end in ends[topic]}
            return kinds == {"SUBSCRIPTION"} and not any(
                node.graph.publishers(topic) for topic in topics
            )

        await until(nobody_left)


@CHURN
async def test_a_process_that_is_killed_leaves_ros_2_s_graph(peer, domain_id):
    async with (
        peer() as ros,
        started("dying", [sys.executable, "-c", OURS, "dying", str(domain_id)]) as ours,
    ):

        async def seen():
            graph = await asked(ros, "graph", "graph")
            return "/dying" in graph["nodes"] and bool(graph["ends"].get("/here"))

        async def gone():
            graph = await asked(ros, "graph", "graph")
            return "/dying" not in graph["nodes"] and not graph["ends"].get("/here")

        await until(seen)
        ours.signal(9)
        await until(gone)


@CHURN
async def test_a_real_node_hears_on_when_flows_are_taken_away_before_a_sample_s_turn(
    peer, tmp_path
):
    """An answer that is due after the flow was removed is not sent, and the next flow is received."""
    usual = {"qos": {"depth": 9}, "reader_depth": 9, "executor": "", "then": "", "service_s": 0}
    usual |= {"size_bytes": 24, "rate_hz": 100, "phase_s": 0, "change_s": 0, "cached": False}
    there = {**usual, "name": "out", "source": "there"}
    back = {**usual, "name": "back", "source": "here", "rate_hz": 0}
    async with peer("there") as sender, peer("here") as hearer:
        both = {"out": sender, "in": hearer}

        async def played(*flows):
            for one in both.values():
                one.order(do="open", flows=flows)
            for one in both.values():
                await one.expect("matched", timeout_s=ANSWER_S)
            times = {"start_ns": time.time_ns() + 10**8, "duration_s": 0.2, "drain_s": 0.1}
            for name, one in both.items():
                one.order(do="play", **times, result=str(tmp_path / f"{name}.npz"))
            for one in both.values():
                await one.expect("done", timeout_s=ANSWER_S)
                await asked(one, "close", "closed")
            return np.load(tmp_path / "in.npz")["out received value"]

        assert (await played({**there, "then": "back", "service_s": 1}, back)).size
        await asyncio.sleep(1.5)
        assert (await played(there)).size
