"""Nodes of rclpy behind two routers that meet over Zenoh, each on a host of its own."""

import asyncio
import sys
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from beside import ANSWER_S, EMPTY, LATCHED, agents, asked, listen, publish, until

from sfglab.bus.zenoh.address import ZenohAddress
from sfglab.messages import default_message, deserialize, serialize

pytestmark = [pytest.mark.live, pytest.mark.ros, pytest.mark.netns, pytest.mark.zenoh]

AGENTS = {"one": 33, "two": 34}
DOMAINS = {"hub": 0, **AGENTS}  # hosts
CALLS, MESSAGES, DEEP = 500, 200, {"depth": 1000}
TF, TRANSFORM = "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/TransformStamped"


@pytest.fixture
def ros_node(peer, own_types):
    options = {"program": Path(__file__).with_name("service_peer.py"), "PYTHONPATH": own_types}
    return lambda name, host=None, **values: peer(name, host, **options, **values)


@asynccontextmanager
async def met(network, how):
    """Return the agents' addresses over Zenoh, clients of a hub that starts late, or peers."""
    first = network.hosts["one"].address
    if how == "peers":
        yield {"one": ZenohAddress(hubs=()), "two": ZenohAddress(hubs=(), peers=(first,))}
        return
    place = network.hosts["hub"].address
    argv = [sys.executable, "-m", "sfglab", "hub", "--bind", place]
    hub = await asyncio.create_subprocess_exec(*network.hosts["hub"].argv(argv))
    try:
        yield dict.fromkeys(AGENTS, ZenohAddress(hubs=(place,)))
    finally:
        hub.terminate()
        await hub.wait()


@pytest.mark.feature(
    "Topics, transforms and services across two routers over Zenoh",
    condition="ROS 2 beside each router",
)
@pytest.mark.parametrize("how", ["hub", "peers"])
async def test_topics_transforms_and_services_cross_over_zenoh(network, ros_node, python, how):
    async with (
        met(network, how) as remotes,
        agents(network, ros_node, AGENTS, remotes=remotes) as ros,
    ):
        for name, other in (("one", "two"), ("two", "one")):
            await all_cross(ros[name], ros[other], f"/global/{name}")
            await frames_cross(ros[name], ros[other], name)


async def all_cross(server, client, names):
    latched, state, service = f"{names}/map", f"{names}/state", f"{names}/enable"
    await publish(server, latched)
    await asked(server, "serve", "serving", service=service)
    await listen(client, state, DEEP, quiet=True)

    async def heard(topic):
        return (await asked(client, "count", "counts"))["counts"].get(topic, 0)

    async def arrived():
        await publish(server, state, DEEP)
        await asyncio.sleep(0.5)
        return await heard(state)

    async def complete():
        return await heard(state) == goal

    await until(arrived)
    goal = await heard(state) + MESSAGES
    server.order(do="repeat", topic=state, cdr=EMPTY, times=MESSAGES, rate_hz=50)
    await until(complete)
    await listen(client, latched, LATCHED, quiet=True)
    await until(lambda: heard(latched))
    called = await asked(client, "call", "called", service=service, times=CALLS, timeout_s=ANSWER_S)
    assert called["answers"] == [number % 2 == 1 for number in range(CALLS)]
    assert await heard(latched) == 1


async def frames_cross(server, client, name):
    transform = default_message(TRANSFORM, child_frame_id="lidar")
    transform.header.frame_id = "base"
    cdr = serialize(default_message(TF, transforms=[transform])).hex()
    await publish(server, "/tf_static", LATCHED, [cdr], TF)
    await listen(client, "/tf_static", LATCHED | {"depth": 100}, TF)

    async def prefixed():
        report = await client.expect("heard", timeout_s=ANSWER_S)
        (heard,) = deserialize(bytes.fromhex(report["cdr"]), TF).transforms
        return (heard.header.frame_id, heard.child_frame_id) == (f"{name}/base", f"{name}/lidar")

    await until(prefixed)
