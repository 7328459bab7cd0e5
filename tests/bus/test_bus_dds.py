"""The DDS back-end between real processes on the loopback interface."""

from __future__ import annotations

import pytest
from bus_messages import IMAGE, PIXELS, SERVICE, Request, image

from sfglab import bus
from sfglab.qos import LATCHED

pytestmark = pytest.mark.live
world = pytest.fixture(lambda live: live)


async def test_another_process_gets_the_latched_image_whole_with_its_info(here, child):
    reader = """
    sub = node.create_subscription(Image, "/image", qos=LATCHED)
    message, info = await sub.take_with_info(60)
    data = message.data
    say(sum=int(data.sum()), shape=[message.height, message.width], writeable=data.flags.writeable)
    say(gid=info.publisher_gid.hex(), past=info.source_timestamp_ns <= info.received_timestamp_ns)
    """
    publisher = here.create_publisher(IMAGE, "/image", LATCHED)
    publisher.publish(image(1))
    publisher.publish(image(3))
    async with child(reader, "late") as late:
        heard = await late.hear() | await late.hear()
    image_ = {"sum": 3 * PIXELS, "shape": [360, 640], "writeable": False}
    assert heard == image_ | {"gid": publisher.gid.hex(), "past": True}


SERVER = """
response = default_message("sfglab_interfaces/srv/GetMetadata_Response")
node.create_service("sfglab_interfaces/srv/GetMetadata", "/agent/get_metadata", lambda _: response)
await hear()
"""


async def test_a_servers_death_is_a_timeout(here, child):
    async with child(SERVER, "server", lease_s=1.0) as server:
        client = here.create_client(SERVICE, "/agent/get_metadata")
        await client.wait_for_service(60)
        assert not (await client.call(Request())).success
        await server.kill()
        with pytest.raises(bus.BusTimeoutError, match=r"has gone|did not respond"):
            await client.call(Request(), timeout_s=0.2)
        assert await client._pair.changed.wait_until(lambda: not client.service_is_ready(), 60)
