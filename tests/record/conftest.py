import numpy as np
import pytest
from meter_rows import MeterRow

from sfglab.messages import default_message, serialize
from sfglab.qos import LATCHED, QoSProfile, Reliability
from sfglab.record import LogWriter
from sfglab.spatial.poses import header_msg


@pytest.fixture
def image():
    """A function from a stamp to an image whose pixels do not compress."""

    def make(stamp_ns, height=36, width=64):
        shape = {"height": height, "width": width, "step": 3 * width, "encoding": "rgb8"}
        data = np.frombuffer(np.random.default_rng(stamp_ns).bytes(3 * height * width), np.uint8)
        return default_message(
            "sensor_msgs/msg/Image", header=header_msg("", stamp_ns), data=data, **shape
        )

    return make


@pytest.fixture
def given(tmp_path, image):
    """A log with a latched topic, our own rows, metadata, an attachment, and times that are not in order."""
    path = tmp_path / "given.mcap"
    with LogWriter(path) as log:
        log.write_metadata("config", {"seed": 1})
        log.attach("note", b"x", "text/plain")
        qos = QoSProfile(reliability=Reliability.BEST_EFFORT, depth=5)
        for number in (0, 2, 1, 3):
            times = {"log_time_ns": number * 10**9, "publish_time_ns": number}
            log.write_raw(
                "/image", "sensor_msgs/msg/Image", serialize(image(number)), qos=qos, **times
            )
        tree = default_message("tf2_msgs/msg/TFMessage")
        log.write_raw(
            "/tf_static", "tf2_msgs/msg/TFMessage", serialize(tree), log_time_ns=5, qos=LATCHED
        )
        row = MeterRow(agent="r1", received=4, mean_s=0.5, lossless=True)
        log.write_row("meter", row, log_time_ns=6)
    return path
