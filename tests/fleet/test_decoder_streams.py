"""Remote streams get local names by the schema, and what cannot be offered is named."""

import asyncio
import zlib
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest
from cameras import FFMPEG, IMAGE, INFO, LOCAL, LOCAL_INFO, STREAM

from sfglab.bus.address import BusAddress
from sfglab.bus.sim import run_simulated
from sfglab.codecs import COMPRESSED_IMAGE
from sfglab.component import Orders, beside
from sfglab.fleet.decoder import pipeline, streams
from sfglab.fleet.decoder.pipeline import (
    HISTORY_BYTES,
    LOCAL_QOS,
    Statistics,
    StreamCodec,
    dds_qos,
    image_prefix,
    message_bytes,
    write_message,
)
from sfglab.fleet.decoder.process import PipelineWorker, Worker, WorkerConfig, WorkerPool
from sfglab.fleet.decoder.streams import (
    CAMERA_INFO,
    RELAY,
    StreamError,
    StreamKind,
    routes_of_agent,
    routes_of_topic,
)
from sfglab.messages import default_message, serialize
from sfglab.names import Resource
from sfglab.qos import SENSOR_DATA
from sfglab.spatial.poses import header_msg

BYTES = "std_msgs/msg/UInt8MultiArray"


def metadata(topic=STREAM, **stream_fields):
    fields = {"topic": topic, "type": FFMPEG} | stream_fields
    stream = default_message("sfglab_interfaces/msg/StreamInfo", **fields)
    sensor = default_message("sfglab_interfaces/msg/SensorInfo", streams=[stream])
    return default_message("sfglab_interfaces/msg/AgentMetadata", agent="go2", sensors=[sensor])


@pytest.mark.parametrize(
    ("width", "height", "depth"),
    [(64, 64, 256), (640, 360, 74), (1280, 720, 21), (3840, 2160, LOCAL_QOS.depth), (0, 0, 24)],
)
def test_images_are_kept_for_readers_that_lag_behind_as_far_as_memory_allows(width, height, depth):
    (image,), _ = routes_of_agent(metadata(codec="h264", width=width, height=height))
    assert dds_qos(image) == replace(LOCAL_QOS, depth=depth)
    assert depth == LOCAL_QOS.depth or width * height * 3 * depth <= HISTORY_BYTES


def test_camera_info_has_the_usual_history_and_so_has_shared_memory():
    image, info = routes_of_topic(STREAM)
    assert dds_qos(info) == LOCAL_QOS
    made = {}

    def create_publisher(type_, topic, qos, *, transport):
        made[transport] = (type_, topic, qos)
        return SimpleNamespace(close=lambda: None)

    outputs = pipeline.Outputs(
        SimpleNamespace(create_publisher=create_publisher), image, ["dds", "shm"]
    )
    outputs.open()
    outputs.close()
    assert made == {"dds": (IMAGE, LOCAL, dds_qos(image)), "shm": (IMAGE, LOCAL, LOCAL_QOS)}


def test_a_stream_is_known_by_its_name_or_description_and_only_numbered_packets_have_a_replay():
    image, info = routes_of_topic(STREAM)
    assert (image.local_topic, image.source_type, image.codec) == (LOCAL, FFMPEG, "h264")
    assert (info.source_topic, info.local_topic, info.codec) == (INFO, LOCAL_INFO, RELAY)
    assert (image.replay_topic, info.replay_topic) == (f"{STREAM}_replay", "")
    routes, errors = routes_of_agent(metadata(codec="h264", camera_info_topic=INFO))
    assert [r.local_topic for r in routes] == [LOCAL, LOCAL_INFO]
    assert (routes[0].replay_topic, errors) == (image.replay_topic, ())
    fields = {"decoded_topic": "/local/go2/front", "type": "foxglove_msgs/msg/CompressedVideo"}
    (only,), _ = routes_of_agent(metadata(**fields))
    assert (only.local_topic, only.replay_topic) == ("/local/go2/front", "")
    image, _ = routes_of_topic("/global/go2/camera_front/depth/compressed_depth")
    assert image.local_topic == "/local/go2/camera_front/depth/image_raw"
    assert image.source_type == "sensor_msgs/msg/CompressedImage"


@pytest.mark.parametrize(
    ("topic", "why"),
    [
        ("/local/go2/camera_front/color/ffmpeg", "allowed: a global name"),
        ("/global/go2/get_metadata", "with agent and component"),
        ("camera", "absolute name"),
        ("/global/go2/imu/imu", "allowed as its last part"),
    ],
)
def test_what_is_no_remote_image_stream_is_refused_with_the_reason(topic, why):
    with pytest.raises(StreamError, match=why) as error:
        routes_of_topic(topic)
    assert error.value.topic == topic


class Inflate:
    """A codec of scans that are compressed with zlib."""

    def __init__(self, route):
        assert route.codec == "zlib"

    def feed(self, message):
        yield zlib.decompress(message.data.tobytes())


def test_a_new_kind_of_stream_is_one_entry_and_one_codec(monkeypatch):
    kind = StreamKind(
        source_type=COMPRESSED_IMAGE,
        codec="zlib",
        decoded_type=BYTES,
        decoded_resource=Resource.SCAN,
    )
    monkeypatch.setitem(streams.KINDS, Resource.POINTS, kind)
    monkeypatch.setitem(pipeline.CODECS, BYTES, StreamCodec(Inflate, lambda *parts: parts))
    topic, shown = "/global/go2/lidar/points", []
    route, _ = routes_of_topic(topic)
    (described,), errors = routes_of_agent(metadata(topic, type=COMPRESSED_IMAGE))
    assert (described.source_topic, described.decoded_type, errors) == (topic, BYTES, ())
    assert route.local_topic == described.local_topic == "/local/go2/lidar/scan"
    outputs = SimpleNamespace(open=lambda: None, publish=lambda *parts: shown.append(parts))
    data = np.frombuffer(zlib.compress(b"scan"), np.uint8)

    async def main(world):
        publisher = world.node("lidar").create_publisher(COMPRESSED_IMAGE, topic, SENSOR_DATA)
        told = {"remote": world.node("remote"), "outputs": outputs, "counts": Statistics()}
        async with beside(pipeline.run_pipeline(route, **told)):
            await publisher.wait_for_subscriptions(1, 5)
            publisher.publish(default_message(COMPRESSED_IMAGE, data=data))
            await asyncio.sleep(1)

    run_simulated(main, seed=1, limit_s=60)
    assert [scan for _, scan in shown] == [b"scan"]


def test_camera_info_is_relayed_unchanged_over_the_transports_that_are_served():
    received = []

    async def main(world):
        orders, local, remote = Orders(), world.node("local"), world.node("remote")
        worker = PipelineWorker(remote, local, lambda _: None)
        _, route = routes_of_topic(STREAM)
        orders.put_nowait({"do": "open", "stream": asdict(route), "transports": []})
        # The transports change before the pipeline has begun.
        orders.put_nowait({"do": "serve", "transports": ["dds"]})
        local.create_subscription(CAMERA_INFO, LOCAL_INFO, received.append)
        publisher = world.node("camera").create_publisher(CAMERA_INFO, INFO, SENSOR_DATA)
        async with beside(worker.run(orders)):
            await asyncio.sleep(1)
            publisher.publish(info)
            await asyncio.sleep(1)
            orders.put_nowait({"do": "serve", "transports": []})
            await asyncio.sleep(1)
            assert not local.graph.publishers(LOCAL_INFO)

    info = default_message(CAMERA_INFO, width=640, d=np.array([0.1, 0.2]))
    run_simulated(main, seed=1, limit_s=60)
    assert [serialize(message) for message in received] == [serialize(info)]


@pytest.mark.parametrize(
    ("shape", "dtype", "encoding"),
    [((4, 6, 3), np.uint8, "bgr8"), ((5, 3), np.uint16, "16UC1"), ((3, 3, 3), np.uint8, "bgr8")],
)
def test_an_image_written_in_two_parts_is_the_message_itself(shape, dtype, encoding):
    pixels = np.arange(np.prod(shape)).astype(dtype).reshape(shape)
    header = header_msg("camera", 1_700_000_000_123_456_789)
    prefix = image_prefix(header, pixels, encoding)
    buffer = bytearray(len(prefix) + pixels.nbytes)
    write_message(buffer, prefix, pixels)
    size = {"height": shape[0], "width": shape[1], "step": pixels.strides[0]}
    data = np.frombuffer(pixels.tobytes(), np.uint8)
    image = default_message(IMAGE, header=header, encoding=encoding, data=data, **size)
    padded = message_bytes(prefix, pixels)
    assert padded == serialize(image)
    assert padded.startswith(buffer)


class Process:
    """A pipeline process of a pool."""

    status = None

    def __init__(self, pid):
        self.pid = pid

    def assign(self, _):
        pass

    async def expect(self, *_, **__):
        pass

    async def end(self):
        self.status = 0


@pytest.mark.parametrize(
    ("options", "starts", "pids", "said"),
    [
        ({"spare": False}, 2, [(), (1,), ()], []),
        ({"refill": False}, 2, [(1,), (1,), (1,)], []),
        ({}, 2, [(1,), (1, 2), (2,)], []),
        ({}, 1, [(1,), (1,), (1,)], ["decoder: no spare pipeline process: none is left"]),
    ],
    ids=["a new one", "the same one", "another one", "another one fails"],
)
async def test_a_pool_has_spare_processes_as_it_is_told(
    monkeypatch, caplog, options, starts, pids, said
):
    made = []

    async def start(*_):
        if len(made) == starts:
            raise OSError("none is left")
        made.append(Process(len(made) + 1))
        return made[-1]

    monkeypatch.setattr("sfglab.fleet.decoder.process.REFILL_DELAY_S", 0)
    monkeypatch.setattr(Worker, "start", start)
    address = BusAddress(domain_id=1, interface="lo")
    pool = WorkerPool(WorkerConfig(remote=address, local=address), **options)
    await pool.start()
    seen = [pool.pids]
    worker = await pool.acquire(lambda *_: None)
    await asyncio.sleep(0.1)
    seen.append(pool.pids)
    await pool.release(worker)
    seen.append(pool.pids)
    await pool.close()
    assert (seen, pool.pids, caplog.messages) == (pids, (), said)
