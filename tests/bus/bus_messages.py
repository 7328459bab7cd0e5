"""Messages that the bus's tests send, and endpoints that know each other."""

import numpy as np

from sfglab.messages import default_message, message_type, service_type, stamp_from_ns

STRING, IMAGE = "std_msgs/msg/String", "sensor_msgs/msg/Image"
String, Image = message_type(STRING), message_type(IMAGE)
SERVICE = "sfglab_interfaces/srv/GetMetadata"
Request = service_type(SERVICE).request
PIXELS = 640 * 360 * 3


def text(value):
    return String(data=str(value))


def response(value=""):
    return default_message(service_type(SERVICE).response, success=True, message=value)


def failures(caplog):
    """Classes of the exceptions that callbacks have raised."""
    return [record.exc_info[0] for record in caplog.records]


def image(fill):
    header = message_type("std_msgs/msg/Header")(
        stamp=stamp_from_ns(1_000_000_002), frame_id="camera"
    )
    data = np.full(PIXELS, fill, np.uint8)
    return Image(
        header=header, height=360, width=640, encoding="rgb8", is_bigendian=0, step=1920, data=data
    )


async def connected(here, there, qos=10, *, type_=STRING, transport="dds", raw=False, **limits):
    """A publisher and a subscription of a topic that know each other."""
    publisher = here.create_publisher(type_, "/t", qos, transport=transport, **limits)
    subscription = there.create_subscription(type_, "/t", qos=qos, transport=transport, raw=raw)
    await publisher.wait_for_subscriptions()
    await subscription.wait_for_publishers()
    return publisher, subscription
