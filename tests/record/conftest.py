import numpy as np
import pytest
from meter_rows import MeterRow

from sfglab.messages import default_message, stamp_from_ns


@pytest.fixture
def meter_row():
    """A function from some fields to a row."""

    def make(**fields):
        values = {"agent": "r1", "received": 1, "mean_s": 0.5, "lossless": True, "samples_s": ()}
        return MeterRow(**values | fields)

    return make


@pytest.fixture
def image():
    """A function from a stamp to an image whose pixels do not compress."""

    def make(stamp_ns, height=36, width=64):
        message = default_message("sensor_msgs/msg/Image")
        message.header.stamp = stamp_from_ns(stamp_ns)
        message.height, message.width, message.step, message.encoding = height, width, 3 * width, "rgb8"
        message.data = np.frombuffer(np.random.default_rng(stamp_ns).bytes(3 * height * width), np.uint8)
        return message

    return make
