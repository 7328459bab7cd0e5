"""Remote streams get local names by the schema, what cannot be offered is named; demand follows the graph."""

import numpy as np
import pytest
from cameras import FFMPEG, IMAGE, INFO, LOCAL, LOCAL_INFO, STREAM

from sfglab.bus.api import EndpointAdded, EndpointInfo, EndpointKind, EndpointRemoved
from sfglab.fleet.decoder.pipeline import image_bytes, image_prefix, write_image
from sfglab.fleet.decoder.streams import (
    RELAY,
    Demand,
    StreamError,
    routes_of_agent,
    routes_of_topic,
)
from sfglab.messages import default_message, deserialize
from sfglab.qos import SENSOR_DATA
from sfglab.spatial.poses import header_msg


def metadata(topic: str = STREAM, **stream_fields):
    fields = {"topic": topic, "type": FFMPEG} | stream_fields
    stream = default_message("sfglab_interfaces/msg/StreamInfo", **fields)
    sensor = default_message("sfglab_interfaces/msg/SensorInfo", streams=[stream])
    return default_message("sfglab_interfaces/msg/AgentMetadata", agent="go2", sensors=[sensor])


def test_a_stream_known_by_its_name_alone_is_offered_with_its_camera_info():
    image, info = routes_of_topic(STREAM)
    assert (image.local_topic, image.source_type, image.codec) == (LOCAL, FFMPEG, "h264")
    assert (info.source_topic, info.local_topic, info.codec) == (INFO, LOCAL_INFO, RELAY)


def test_depth_is_an_image_too_and_only_streams_of_numbered_packets_have_a_replay():
    image, info = routes_of_topic(STREAM)
    assert image.replay_topic == "/global/go2/camera_front/color/ffmpeg_replay"
    assert info.replay_topic == ""
    (described,), _ = routes_of_agent(metadata())
    assert described.replay_topic == image.replay_topic
    (other,), _ = routes_of_agent(metadata(type="foxglove_msgs/msg/CompressedVideo"))
    assert other.replay_topic == ""
    image, _ = routes_of_topic("/global/go2/camera_front/depth/compressed_depth")
    assert image.replay_topic == ""
    assert image.local_topic == "/local/go2/camera_front/depth/image_raw"
    assert image.source_type == "sensor_msgs/msg/CompressedImage"


@pytest.mark.parametrize(
    ("topic", "why"),
    [
        ("/local/go2/camera_front/color/ffmpeg", "global scope"),
        ("/global/go2/get_metadata", "agent and a component"),
        ("camera", "absolute name"),
        ("/global/go2/imu/imu", "known are the resources"),
    ],
)
def test_what_is_no_remote_image_stream_is_refused_with_the_reason(topic, why):
    with pytest.raises(StreamError, match=why) as error:
        routes_of_topic(topic)
    assert error.value.topic == topic


def test_an_agents_metadata_says_what_it_offers():
    routes, errors = routes_of_agent(metadata(codec="h264", camera_info_topic=INFO))
    assert [r.local_topic for r in routes] == [LOCAL, LOCAL_INFO]
    assert not errors
    (only,), _ = routes_of_agent(metadata(decoded_topic="/local/go2/front"))
    assert only.local_topic == "/local/go2/front"


@pytest.mark.parametrize(
    ("shape", "dtype", "encoding"),
    [((4, 6, 3), np.uint8, "bgr8"), ((5, 3), np.uint16, "16UC1"), ((3, 3, 3), np.uint8, "bgr8")],
)
def test_an_image_written_in_two_parts_is_the_message_itself(shape, dtype, encoding):
    pixels = np.arange(np.prod(shape)).astype(dtype).reshape(shape)
    header = header_msg("camera", 1_700_000_000_123_456_789)
    prefix = image_prefix(header, pixels, encoding)
    buffer = bytearray(len(prefix) + pixels.nbytes)
    write_image(buffer, prefix, pixels)
    for data in (bytes(buffer), image_bytes(prefix, pixels)):
        image = deserialize(data, "sensor_msgs/msg/Image")
        assert (image.height, image.width, image.step) == (shape[0], shape[1], pixels.strides[0])
        assert (image.encoding, image.header) == (encoding, header)
        assert np.array_equal(image.data.view(dtype).reshape(shape), pixels)
    assert len(image_bytes(prefix, pixels)) % 4 == 0


@pytest.mark.parametrize(
    ("events", "count", "transports"),
    [
        ("+shm1 +dds2 +shm3", 3, {"shm", "dds"}),
        ("+shm1 +dds2 +shm3 -dds2", 2, {"shm"}),
        ("-shm9 +shm1 +shm1", 1, {"shm"}),
        ("+shm1 +shm1 -shm1", 0, set()),
    ],
    ids=["by transport", "one leaves", "announced twice it counts once", "and leaves once"],
)
def test_demand_is_the_subscriptions_of_a_topic_and_publishers_are_none(events, count, transports):
    demand = Demand()
    for kind in (EndpointKind.SUBSCRIPTION, EndpointKind.PUBLISHER):
        for event in events.split():
            change = EndpointAdded if event[0] == "+" else EndpointRemoved
            gid, way = event[-1].encode() * 16, event[1:4]
            endpoint = EndpointInfo(
                kind=kind, topic=LOCAL, type=IMAGE, gid=gid, qos=SENSOR_DATA, transport=way
            )
            wanted = LOCAL if kind is EndpointKind.SUBSCRIPTION else None
            assert demand.feed(change(endpoint=endpoint)) == wanted
    assert (demand.count(LOCAL), demand.transports(LOCAL), demand.count("/elsewhere")) == (
        count,
        transports,
        0,
    )
