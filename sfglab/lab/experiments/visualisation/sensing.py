"""What a robot's sensors say, and what a recording must hold of it: pictures, videos, points."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.codecs import (
    COMPRESSED_IMAGE,
    COMPRESSED_VIDEO,
    FFMPEG_PACKET,
    TABLE_2,
    H264Encoder,
    compressed_depth_fields,
    compressed_image_fields,
    ffmpeg_packet_fields,
)
from sfglab.lab.experiments.visualisation.moments import CAMERA, back_projected, camera_info, image_message
from sfglab.lab.experiments.visualisation.parts import Speaker
from sfglab.messages import default_message, message_type, stamp_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from sfglab.lab.experiments.visualisation.moments import Moment
    from sfglab.lab.experiments.visualisation.parts import Part


_IMAGE = "sensor_msgs/msg/Image"
_COLOR, _DEPTH = "/local/go2/camera_front/color", "/local/go2/camera_front/aligned_depth"
_ROOT = "/agents/go2/local/camera_front"
_RANGES = np.array([1.0, 2.0, np.inf, 3.0, 0.05, 4.0], np.float32)
"""The third is no hit and the fifth below the scanner's least range: neither may be shown."""


def _bgr(moment: Moment) -> NDArray[np.uint8]:
    return np.ascontiguousarray(moment.rgb[..., ::-1])


def _info(moment: Moment) -> Any:
    height, width = moment.depth_mm.shape
    return camera_info(moment.header(CAMERA), (width, height))


def _compressed(fields: Any, moment: Moment) -> Any:
    data = np.frombuffer(fields.data, np.uint8)
    return message_type(COMPRESSED_IMAGE)(header=moment.header(CAMERA), format=fields.format, data=data)


def pictures(moments: Sequence[Moment]) -> Iterator[Part]:
    """Yield raw and still pictures, and the camera that takes them."""
    jpegs = [compressed_image_fields(_bgr(moment), "jpeg") for moment in moments]
    topic = f"{_COLOR}/image_raw"
    raw = Speaker(
        kind="image", topic=topic, type=_IMAGE, say=lambda m: image_message(m.rgb, "rgb8", m.header(CAMERA))
    )
    yield raw.shown(moments, f"{_ROOT}/color/image_raw", "Image:buffer", lambda m: m.rgb.reshape(-1))
    still = Speaker(
        kind="compressed_image",
        topic="/global/go2/camera_front/color/compressed",
        type=COMPRESSED_IMAGE,
        say=lambda m: _compressed(jpegs[m.number], m),
    )
    yield still.shown(
        moments,
        "/agents/go2/global/camera_front/color/compressed",
        "EncodedImage:blob",
        lambda m: np.frombuffer(jpegs[m.number].data, np.uint8),
    )
    camera = Speaker(
        kind="camera_info", topic=f"{_DEPTH}/camera_info", type="sensor_msgs/msg/CameraInfo", say=_info
    )
    yield camera.shown(  # a matrix of Rerun stands column by column
        moments,
        f"{_ROOT}/aligned_depth/camera_info",
        "Pinhole:image_from_camera",
        lambda m: _info(m).k.reshape(3, 3).T.reshape(-1),
    )


def videos(moments: Sequence[Moment]) -> Iterator[Part]:
    """Yield the same video in each of the three messages that carry one."""
    height, width = moments[0].depth_mm.shape
    settings = replace(TABLE_2, encoder="libx264", width=width, height=height, gop=5)
    encoder = H264Encoder(settings)
    units = [unit for moment in moments for unit in encoder.encode(_bgr(moment))]

    def data(moment: Moment) -> NDArray[np.uint8]:
        return np.frombuffer(units[moment.number].data, np.uint8)

    def ffmpeg(moment: Moment) -> Any:
        fields = asdict(ffmpeg_packet_fields(units[moment.number], settings)) | {"data": data(moment)}
        return message_type(FFMPEG_PACKET)(header=moment.header(CAMERA), **fields)

    def foxglove(moment: Moment) -> Any:
        stamp = stamp_from_ns(moment.stamp_ns)
        return message_type(COMPRESSED_VIDEO)(
            timestamp=stamp, frame_id=CAMERA, format="h264", data=data(moment)
        )

    def still(moment: Moment) -> Any:
        return message_type(COMPRESSED_IMAGE)(header=moment.header(CAMERA), format="h264", data=data(moment))

    for kind, name, type_, say in (
        ("ffmpeg_video", "camera_front/color/ffmpeg", FFMPEG_PACKET, ffmpeg),
        ("compressed_video", "camera_left/color/compressed", COMPRESSED_VIDEO, foxglove),
        ("compressed_image_video", "camera_right/color/compressed", COMPRESSED_IMAGE, still),
    ):
        speaker = Speaker(kind=kind, topic=f"/global/go2/{name}", type=type_, say=say)
        yield speaker.shown(moments, f"/agents/go2/global/{name}", "VideoStream:sample", data)


def points(moments: Sequence[Moment]) -> Iterator[Part]:
    """Yield everything that is shown as points."""

    def depth(moment: Moment) -> NDArray[np.float64]:
        return back_projected(moment.depth_mm, _info(moment), step=4, max_m=10.0).reshape(-1)

    makers = (
        Speaker(
            kind="depth_cloud",
            topic=f"{_DEPTH}/image_raw",
            type=_IMAGE,
            say=lambda m: image_message(m.depth_mm, "16UC1", m.header(CAMERA)),
        ),
        Speaker(
            kind="compressed_depth_cloud",
            topic=f"{_DEPTH}/compressed_depth",
            type=COMPRESSED_IMAGE,
            say=lambda m: _compressed(compressed_depth_fields(m.depth_mm), m),
        ),
        Speaker(
            kind="point_cloud", topic="/local/go2/lidar/points", type="sensor_msgs/msg/PointCloud2", say=_cloud
        ),
        Speaker(kind="laser_scan", topic="/local/go2/lidar/scan", type="sensor_msgs/msg/LaserScan", say=_scan),
    )
    entities = (
        f"{_ROOT}/aligned_depth/image_raw/cloud",
        f"{_ROOT}/aligned_depth/compressed_depth/cloud",
        "/agents/go2/local/lidar/points",
        "/agents/go2/local/lidar/scan",
    )
    expected = (depth, depth, lambda m: _corners(m).reshape(-1), _hits)
    for maker, entity, of in zip(makers, entities, expected, strict=True):
        yield maker.shown(moments, entity, "Points3D:positions", of)


def _corners(moment: Moment) -> NDArray[np.float32]:
    grid = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(grid + moment.place, dtype=np.float32)


def _cloud(moment: Moment) -> Any:
    corners = _corners(moment)
    field = message_type("sensor_msgs/msg/PointField")
    return message_type("sensor_msgs/msg/PointCloud2")(
        header=moment.header("go2/lidar"),
        height=1,
        width=len(corners),
        fields=[field(name=axis, offset=4 * at, datatype=7, count=1) for at, axis in enumerate("xyz")],
        is_bigendian=False,
        point_step=12,
        row_step=12 * len(corners),
        data=corners.reshape(-1).view(np.uint8),
        is_dense=True,
    )


def _scan(moment: Moment) -> Any:
    scan = default_message("sensor_msgs/msg/LaserScan")
    scan.header, scan.ranges = moment.header("go2/lidar"), _RANGES + np.float32(moment.number / 16)
    scan.angle_min, scan.angle_increment = 0.0, float(np.pi / 6)
    scan.range_min, scan.range_max = 0.8, 10.0
    return scan


def _hits(moment: Moment) -> NDArray[np.float64]:
    kept = [0, 1, 3, 5]
    angles = np.arange(len(_RANGES))[kept] * np.pi / 6
    ranges = _RANGES[kept].astype(np.float64) + moment.number / 16
    return np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles), 0 * angles]).reshape(-1)
