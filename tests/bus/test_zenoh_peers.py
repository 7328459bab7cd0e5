"""Nodes over Zenoh beside nodes of pyzeros and zenoh-ros2-sdk, which have rmw_zenoh_cpp's layout as well."""

import asyncio
import sys
from contextlib import asynccontextmanager, suppress
from functools import partial
from pathlib import Path

import pytest

from sfglab.bus import BusTimeoutError, Node
from sfglab.bus.zenoh.backend import ZenohBackend
from sfglab.messages import default_message, message_type, service_type
from sfglab.qos import LATCHED

pytestmark = [pytest.mark.zenoh, pytest.mark.slow]

STRING, SET_BOOL = "std_msgs/msg/String", "std_srvs/srv/SetBool"
String = message_type(STRING)
SetBool = service_type(SET_BOOL)
STARTS_S = 120.0  # pyzeros compiles the reader of each type at its first message


@asynccontextmanager
async def peer(hub, name, *arguments):
    """A node of ours, and one of a library in its own process."""
    script = str(Path(__file__).with_name(name))
    pipe = asyncio.subprocess.PIPE
    argv = (sys.executable, "-W", "ignore", script, *arguments)
    process = await asyncio.create_subprocess_exec(*argv, stderr=pipe)
    try:
        async with Node("ours", namespace="/here", join=partial(ZenohBackend, hub)) as node:
            yield node
    finally:
        if process.returncode is None:
            process.kill()
        _, error = await process.communicate()
        sys.stderr.write(error.decode())  # of a failed test


async def test_topics_services_and_graph_with_pyzeros(hub):
    pytest.importorskip("pyzeros", exc_type=ImportError)
    async with peer(hub, "pyzeros_peer.py", *hub.connect) as node:
        said = node.create_publisher(STRING, "/to_peer")
        heard = node.create_subscription(STRING, "/from_peer", qos=100)
        await said.wait_for_subscriptions(timeout_s=STARTS_S)
        await heard.wait_for_publishers()

        # pyzeros announces a subscription before it declares it. It keeps ten samples and drops further ones, and
        # beside other work it is sometimes silent until the next sample comes. So a sample is sent until it answers.
        async def repeated(sent):
            while True:
                said.publish(String(data=sent))
                with suppress(BusTimeoutError):
                    while (got := await heard.take_with_info(2))[0].data != f"peer: {sent}":
                        pass
                    return got[1]

        for number in range(30):
            async with asyncio.timeout(STARTS_S):
                info = await repeated(str(number))
        assert [end.gid for end in node.graph.publishers("/from_peer")] == [info.publisher_gid]
        assert heard.lost == 0

        client = node.create_client(SET_BOOL, "/peer_serves")
        for value in (True, False) * 5:
            response = await client.call(SetBool.request(data=value), timeout_s=STARTS_S)
            assert (response.success, response.message) == (not value, "peer")

        def answer(request):
            return default_message(SetBool.response, success=request.data, message="ours")

        node.create_service(SET_BOOL, "/we_serve", answer)
        assert await node.graph.wait_for(
            lambda: any(
                end.topic == "rq/we_serveRequest" and end.kind.value == "subscription"
                for end in node.graph.endpoints()
            )
        )
        # The hub tells pyzeros of the server a moment later; pyzeros never ends a call without one.
        await asyncio.sleep(1)
        said.publish(String(data="call"))
        while not (answer_of_peer := (await heard.take(STARTS_S)).data).endswith("ours"):
            pass  # a number that was sent twice
        assert answer_of_peer == "peer: 1 ours"

        def shown():
            ends = node.graph.endpoints()
            return {(e.topic, e.type, e.kind.value) for e in ends if e.node == "/there/peer"}

        assert await node.graph.wait_for(lambda: len(shown()) == 6)
        assert shown() == {
            ("/from_peer", STRING, "publisher"),
            ("/to_peer", STRING, "subscription"),
            ("rq/peer_servesRequest", f"{SET_BOOL}_Request", "subscription"),
            ("rr/peer_servesReply", f"{SET_BOOL}_Response", "publisher"),
            ("rq/we_serveRequest", f"{SET_BOOL}_Request", "publisher"),
            ("rr/we_serveReply", f"{SET_BOOL}_Response", "subscription"),
        }
        assert await node.graph.wait_for(lambda: len(node.graph.nodes()) == 2)
        assert [one.full_name for one in node.graph.nodes()] == ["/here/ours", "/there/peer"]


async def test_zenoh_ros2_sdk_hears_the_history_of_a_latched_topic(hub):
    pytest.importorskip("zenoh_ros2_sdk", exc_type=ImportError)
    place = hub.connect[0].removeprefix("tcp/").split(":")
    async with peer(hub, "sdk_peer.py", *place) as node:
        heard = node.create_subscription(STRING, "/from_peer", qos=100)
        said = node.create_publisher(STRING, "/to_peer", LATCHED)
        for number in range(5):
            said.publish(String(data=str(number)))
        assert (await heard.take(STARTS_S)).data == "peer: 4"
        said.publish(String(data="new"))
        assert (await heard.take(30)).data == "peer: new"
