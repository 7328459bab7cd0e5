"""The DDS back-end between real processes on the loopback interface."""

from __future__ import annotations

import numpy as np
import pytest

from sfglab import bus
from sfglab.messages import message_type, service_type
from sfglab.qos import LATCHED

pytestmark = pytest.mark.live

STRING = "std_msgs/msg/String"
String = message_type(STRING)
SERVICE = "sfglab_interfaces/srv/GetMetadata"
Request = service_type(SERVICE).request
Image = message_type("sensor_msgs/msg/Image")
Header = message_type("std_msgs/msg/Header")
Time = message_type("builtin_interfaces/msg/Time")


def node(domain_id, name="here", **options):
    return bus.Node(name, domain_id=domain_id, interface="lo", **options)


def image(fill):
    data = np.full(640 * 360 * 3, fill, np.uint8)
    header = Header(stamp=Time(sec=1, nanosec=2), frame_id="camera")
    return Image(header=header, height=360, width=640, encoding="rgb8", is_bigendian=0, step=1920, data=data)


async def test_a_message_and_its_info_cross_to_another_process_and_back(domain_id, child):
    echo = f"""
    async with Node("echo", domain_id={domain_id}, interface="lo") as node:
        out = node.create_publisher(String, "/pong")
        node.create_subscription("{STRING}", "/ping", lambda m: out.publish(String(data=m.data + "!")))
        await out.wait_for_subscriptions()
        say(ready=True)
        await asyncio.to_thread(sys.stdin.readline)
    """
    async with child(echo) as other, node(domain_id) as here:
        pong = here.create_subscription(String, "/pong")
        ping = here.create_publisher(STRING, "ping")
        await other.hear()
        await ping.wait_for_subscriptions()
        await pong.wait_for_publishers()
        ping.publish(String(data="marco"))
        message, info = await pong.take_with_info(60)
        assert message.data == "marco!"
        assert info.source_timestamp_ns <= info.received_timestamp_ns
        assert info.publisher_gid == here.graph.publishers("/pong")[0].gid
        await other.end()


async def test_a_late_joiner_gets_the_latched_message_and_an_image_arrives_whole(domain_id, child):
    reader = f"""
    async with Node("late", domain_id={domain_id}, interface="lo") as node:
        sub = node.create_subscription(Image, "/image", qos=LATCHED)
        message = await sub.take(60)
        data = message.data
        say(sum=int(data.sum()), shape=[message.height, message.width], writeable=data.flags.writeable)
    """
    async with node(domain_id) as here:
        publisher = here.create_publisher(Image, "/image", LATCHED)
        publisher.publish(image(1))
        publisher.publish(image(3))
        async with child(reader) as late:
            heard = await late.hear()
    assert heard == {"sum": 3 * 640 * 360 * 3, "shape": [360, 640], "writeable": False}


SERVER = """
async with Node("server", domain_id={domain_id}, interface="lo", lease_s=1.0) as node:
    response = default_message("sfglab_interfaces/srv/GetMetadata_Response")
    node.create_service("sfglab_interfaces/srv/GetMetadata", "/agent/get_metadata", lambda _: response)
    await hear()
"""


async def test_a_servers_death_is_a_timeout(domain_id, child):
    async with node(domain_id) as here, child(SERVER.format(domain_id=domain_id)) as server:
        client = here.create_client(SERVICE, "/agent/get_metadata")
        await client.wait_for_service(60)
        assert not (await client.call(Request())).success
        await server.kill()
        with pytest.raises(bus.BusTimeoutError, match=r"has gone|did not respond"):
            await client.call(Request(), timeout_s=0.2)
        assert await client._pair.changed.wait_until(lambda: not client.service_is_ready(), 60)
