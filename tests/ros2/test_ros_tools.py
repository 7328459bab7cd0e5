"""Our tools beside real rclpy: what it sees in its graph, hears and says, they print."""

import asyncio
import json
import sys
from contextlib import asynccontextmanager
from hashlib import blake2b
from pathlib import Path
from signal import SIGINT
from time import monotonic

import numpy as np
import pytest
from beside import ANSWER_S, STRING, asked, listen, publish
from random_messages import random_message

from sfglab.bus import EndpointKind, Node
from sfglab.bus.api import entries
from sfglab.bus.listing import settled, tells_no_history
from sfglab.messages import deserialize, serialize
from sfglab.messages.text import message_from_yaml, to_yaml, values_of
from sfglab.qos import History
from sfglab.record import LogReader

pytestmark = [pytest.mark.live, pytest.mark.ros]
feature = pytest.mark.feature(
    "`sfglab topic` and `node`: graph, messages and rates as rclpy has them"
)
PEER = Path(__file__).with_name("tool_peer.py")
TYPES = ("sensor_msgs/msg/Imu", "sensor_msgs/msg/PointCloud2", "diagnostic_msgs/msg/KeyValue")
NAMELESS = "/".join(2 * ["_CREATED_BY_BARE_DDS_APP_"])  # rmw's name of who announces no node
QOS = {"reliability": "best_effort", "depth": 3}


@pytest.fixture
def tool(domain_id, monkeypatch):
    """A function that starts a command of ours in the test's domain."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))

    @asynccontextmanager
    async def start(*arguments):
        argv = [sys.executable, "-m", "sfglab", *arguments, "--interface", "lo"]
        if arguments[1] == "list":
            argv += ["--spin-time", "5"]  # a busy machine discovers slowly
        pipes = {"stdout": asyncio.subprocess.PIPE, "stderr": asyncio.subprocess.PIPE}
        process = await asyncio.create_subprocess_exec(*argv, **pipes)
        try:
            yield process
        finally:
            if process.returncode is None:
                process.send_signal(SIGINT)
                _, said = await process.communicate()
                assert process.returncode == 0
                assert said.endswith(b"ended\n")

    return start


@pytest.fixture
def printed(tool):
    """A function that runs a command of ours to its end and returns what it printed."""

    async def run(*arguments, status=0):
        async with tool(*arguments) as process:
            out, said = await process.communicate()
        assert process.returncode == status, said
        return (said if status else out).decode()

    return run


def as_rclpy_prints(endpoint):
    """Return an endpoint as the text of rclpy's TopicEndpointInfo."""
    namespace, _, name = (endpoint.node or NAMELESS).rpartition("/")
    qos = endpoint.qos
    kept = qos.history.name + (f" ({qos.depth})" if qos.history is History.KEEP_LAST else "")
    lines = [
        f"Node name: {name}",
        f"Node namespace: {namespace or '/'}",
        f"Topic type: {endpoint.type}",
        f"Topic type hash: {entries(endpoint.user_data).get('typehash', 'INVALID')}",
        f"Endpoint type: {endpoint.kind.name}",
        f"GID: {endpoint.gid.hex('.')}",
        "QoS profile:",
        f"  Reliability: {qos.reliability.name}",
        f"  History (Depth): {'UNKNOWN' if tells_no_history(endpoint) else kept}",
        f"  Durability: {qos.durability.name}",
        f"  Lifespan: {duration(qos.lifespan_ns)}",
        f"  Deadline: {duration(qos.deadline_ns)}",
        f"  Liveliness: {qos.liveliness.name}",
        f"  Liveliness lease duration: {duration(qos.lease_ns)}",
    ]
    return "\n".join(lines)


def duration(duration_ns):
    return "Infinite" if duration_ns is None else f"{duration_ns} nanoseconds"


@feature
async def test_lists_print_and_graphs_hold_what_rclpy_s_graph_has(peer, printed):
    async with peer("talker", program=PEER) as ros:
        await listen(ros, "/chatter", QOS)
        await publish(ros, "/chatter", cdr=[])
        await asked(ros, "serve", "serving", service="/enable")
        await asked(ros, "perform", "performing", action="/count")
        seen = await asked(ros, "seen", "seen")
        topics = {name: types for name, types in seen["topics"].items() if "/_" not in name}
        assert await printed("topic", "list", "-t") == "".join(
            f"{n} [{t}]\n" for n, (t,) in topics.items()
        )
        async with Node("looker", interface="lo") as node:
            graph = await settled(node, 5.0)
        assert [one.full_name for one in graph.nodes] == ["/talker"]
        for topic, sides in seen["ends"].items():
            ours = [
                [as_rclpy_prints(end) for end in graph.ends(topic, kind)] for kind in EndpointKind
            ]
            assert list(map(sorted, ours)) == list(map(sorted, sides))


@feature
async def test_echo_prints_what_rclpy_publishes_and_rclpy_hears_what_pub_says(peer, printed, tool):
    rng = np.random.default_rng(3)
    async with peer("talker", program=PEER) as ros:
        for name in TYPES[:2]:
            cdr, topic = serialize(random_message(rng, name)), f"/{name.rpartition('/')[2]}"
            await publish(ros, topic, cdr=[cdr.hex()], kind=name)
            said = await printed("topic", "echo", topic, "--once", "--full-length")
            assert said == to_yaml(values_of(deserialize(cdr, name))) + "---\n"
            read = message_from_yaml(name, said.removesuffix("---\n"), "echo")
            assert serialize(read) == serialize(deserialize(cdr, name))
        await listen(ros, "/chatter", {"depth": 10})
        out = await printed(
            "topic", "pub", "--once", "/chatter", "std_msgs/String", "{data: hällo}"
        )
        heard = await ros.expect("heard", timeout_s=30)
        assert deserialize(bytes.fromhex(heard["cdr"]), STRING).data == "hällo"
        assert "publishing #1:\ndata: hällo\n\n" in out


@feature
@pytest.mark.slow
async def test_hz_of_a_topic_at_a_kilohertz_is_within_a_percent(peer, tool):
    async with peer("talker", program=PEER) as ros:
        await publish(ros, "/chatter", {"depth": 1000}, [])
        async with tool("topic", "hz", "/chatter", "--json") as hz:
            while b"Subscribed" not in await hz.stderr.readline():
                pass
            sent = await asked(ros, "beat", "beaten", hz={"/chatter": 1000}, seconds=8)
            measured = {"window": 0}
            while measured["window"] <= 5000:  # all have been sent, however long that took
                measured = json.loads(await hz.stdout.readline())
    first_s, *_, last_s = sent["sent_s"]["/chatter"][: measured["window"] + 1]
    assert abs(measured["rate_hz"] / (measured["window"] / (last_s - first_s)) - 1) < 0.01


RATES = {f"/topic_{number}": 100.0 for number in range(10)} | {"/image": 30.0}
KINDS = {topic: "sensor_msgs/msg/Image" if topic == "/image" else STRING for topic in RATES}
SECONDS = 5


@pytest.mark.feature(
    "`sfglab log record` and `play`: 10 topics at 100 Hz and 30 images of 640 x 480 a second, none lost"
)
@pytest.mark.slow
async def test_what_rclpy_publishes_is_recorded_and_played_to_it(peer, tool, printed, tmp_path):
    bag = tmp_path / "bag.mcap"
    async with peer("talker", program=PEER) as ros:
        for topic, kind in KINDS.items():
            await publish(ros, topic, {"depth": 100}, [], kind)
        async with tool("log", "record", *RATES, "-o", str(bag)) as record:
            subscribed = 0
            while subscribed < len(RATES):
                subscribed += b"Subscribed" in await record.stdout.readline()
            await asyncio.sleep(2)  # the talker finds the recorder
            await asked(ros, "beat", "beaten", hz=RATES, seconds=SECONDS)
            await asyncio.sleep(2)
    digests = {topic: [0, blake2b()] for topic in RATES}
    with LogReader(bag) as log:
        for message in log.messages():
            digests[message.topic][0] += 1
            digests[message.topic][1].update(message.cdr[4:])
    recorded = {topic: [count, digest.hexdigest()] for topic, (count, digest) in digests.items()}
    counts = {topic: count for topic, (count, _) in recorded.items()}
    assert counts == {topic: hz * SECONDS for topic, hz in RATES.items()}
    async with peer("listener", program=PEER) as ros:
        await asked(ros, "gather", "gathering", kinds=KINDS)
        assert await printed("log", "play", str(bag)) == "played 5150 messages of 11 topics\n"
        seen, end = {}, monotonic() + ANSWER_S
        while seen != recorded and monotonic() < end:
            await asyncio.sleep(0.5)
            seen = (await asked(ros, "gathered", "gathered"))["seen"]
        assert {topic: count for topic, (count, _) in seen.items()} == counts
        assert seen == recorded
