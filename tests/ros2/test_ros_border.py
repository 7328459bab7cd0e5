"""The border beside real ROS 2: rclpy on both ends of two routers, each on a host of its own."""

from __future__ import annotations

import sys
from contextlib import AsyncExitStack, asynccontextmanager

import pytest
from beside import ANSWER_S, asked, until

from sfglab.bus.address import BusAddress
from sfglab.component import argument_of
from sfglab.fleet.decoder.node import DecoderConfig
from sfglab.fleet.router.node import RouterConfig
from sfglab.lab.hosts import Network
from sfglab.messages import default_message, serialize
from sfglab.processes import LineProcess

pytestmark = [pytest.mark.live, pytest.mark.ros, pytest.mark.netns]

STRING = "std_msgs/msg/String"
HELLO = serialize(default_message(STRING)).hex()
STATE = "/global/go2/state"
MAP = "/global/go2/map"
STREAM = "/global/go2/camera_front/color/ffmpeg"
DECODED = "/local/go2/camera_front/color/image_raw"
NAMELESS = "/".join(2 * ["_CREATED_BY_BARE_DDS_APP_"])
GLOBAL, DOMAINS = 5, {"go2": 7, "spot": 8}


@pytest.fixture(scope="module")
def network():
    with Network(grace_s=0.2) as made:
        for name in DOMAINS:
            made.add_host(name)
        yield made


@asynccontextmanager
async def component(host, module, config):
    argv = [sys.executable, "-m", module, argument_of(config)]
    process = await LineProcess.start(module, host.argv(argv))
    try:
        await process.expect("ready", timeout_s=ANSWER_S)
        yield process
    finally:
        await process.close()


@asynccontextmanager
async def agents(network, peer):
    """A real node of each agent, on a host of its own behind its router."""
    async with AsyncExitStack() as stack:
        peers = {}
        for name, domain in DOMAINS.items():
            host = network.hosts[name]
            local = BusAddress(domain_id=domain, interface="lo")
            remote = BusAddress(domain_id=GLOBAL, interface="eth0")
            config = RouterConfig(agent=name, local=local, remote=remote, linger_s=0.2, offers=True)
            await stack.enter_async_context(component(host, "sfglab.fleet.router.node", config))
            peers[name] = await stack.enter_async_context(peer(name, host, ROS_DOMAIN_ID=domain))
        yield peers


async def publish(ros, topic, qos, *, times=1):
    await asked(ros, "publish", "published", kind=STRING, topic=topic, qos=qos, cdr=[HELLO] * times)


def ends(graph, topic):
    return sorted((e["kind"], e["type"], e["durability"], e["node"]) for e in graph["ends"].get(topic, ()))


@pytest.mark.feature(
    "On demand, and still listed: `topic list`, `info -v`, `hz`, RViz", condition="agents offer it"
)
@pytest.mark.feature(
    "The node of an endpoint in `topic info -v`",
    cannot={"kilted": "Fast DDS 3 looks for a participant's GUID in what Cyclone DDS says of an endpoint"},
)
async def test_what_could_be_had_is_listed_before_anybody_subscribes(network, peer, distribution):
    async with agents(network, peer) as ros:
        names = distribution == "jazzy"
        await listed_then_opened(network, ros["go2"], ros["spot"], names=names)


async def listed_then_opened(network, go2, spot, *, names):
    await publish(go2, STATE, {})
    await publish(go2, MAP, {"durability": "transient_local", "depth": 1})
    local = BusAddress(domain_id=DOMAINS["spot"], interface="lo")
    config = DecoderConfig(remote=local, local=local, streams=(STREAM,), linger_s=0.1, spare=False)
    router, its_decoder = ("/router", "/agent_decoder") if names else 2 * (NAMELESS,)
    listed = {
        STATE: [("PUBLISHER", STRING, "volatile", router)],
        MAP: [("PUBLISHER", STRING, "transient_local", router)],
        DECODED: [("PUBLISHER", "sensor_msgs/msg/Image", "volatile", its_decoder)],
    }
    async with component(network.hosts["spot"], "sfglab.fleet.decoder.node", config) as decoder:

        async def seen():
            graph = await asked(spot, "graph", "graph")
            return {topic: ends(graph, topic) for topic in listed} == listed

        await until(seen)
        graph = await asked(go2, "graph", "graph")
        assert [kind for kind, *_ in ends(graph, STATE) + ends(graph, MAP)] == ["PUBLISHER"] * 2, "read at rest"
        decoder.order(do="tell")
        assert len((await decoder.expect("processes", timeout_s=ANSWER_S))["pids"]) == 0
        for topic, kind in ((STATE, STRING), (DECODED, "sensor_msgs/msg/Image")):
            await asked(spot, "listen", "listening", kind=kind, topic=topic, qos={})
        while (await decoder.expect("status", timeout_s=ANSWER_S))["state"] != "RUNNING":
            pass

        async def heard():
            await publish(go2, STATE, {})
            return (await asked(spot, "count", "counts"))["counts"].get(STATE)

        await until(heard)
