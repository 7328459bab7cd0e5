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


async def test_another_process_gets_the_latched_image_whole_with_its_info(domain_id, child):
    reader = f"""
    async with Node("late", domain_id={domain_id}, interface="lo") as node:
        sub = node.create_subscription(Image, "/image", qos=LATCHED)
        message, info = await sub.take_with_info(60)
        data = message.data
        say(sum=int(data.sum()), shape=[message.height, message.width], writeable=data.flags.writeable)
        say(gid=info.publisher_gid.hex(), past=info.source_timestamp_ns <= info.received_timestamp_ns)
    """
    async with node(domain_id) as here:
        publisher = here.create_publisher(Image, "/image", LATCHED)
        publisher.publish(image(1))
        publisher.publish(image(3))
        async with child(reader) as late:
            heard = await late.hear() | await late.hear()
    image_ = {"sum": 3 * 640 * 360 * 3, "shape": [360, 640], "writeable": False}
    assert heard == image_ | {"gid": publisher.gid.hex(), "past": True}


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
