"""A small fleet that says, in real messages, all that a visualizer can show, and what a recording must hold."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab import codecs
from sfglab.lab.sources import open_source
from sfglab.messages import default_message, message_type, stamp_from_ns
from sfglab.spatial.poses import Pose, StampedTransform, header_msg

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

#: The first moment; any time will do, this one is easily recognised.
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 100_000_000
RECEIVED_AFTER_NS = 2_000_000  #: How long after its stamp a message is in the log.
SIZE = (640, 360)  #: Width and height of a moment's picture.
CAMERA = "go2/camera_front_color"

_IMAGE, _INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
_TF, _MARKER = "tf2_msgs/msg/TFMessage", "visualization_msgs/msg/Marker"
_COLOR, _DEPTH = "/local/go2/camera_front/color", "/local/go2/camera_front/aligned_depth"
_MOUNT = np.array([0.25, 0.0, 0.125])
_SILENT_AFTER = 1  # the moment of pi1's only heartbeat: the view has to notice its end
_RANGES = np.array([1.0, 2.0, np.inf, 3.0, 0.05, 4.0], np.float32)
"""The third is no hit and the fifth below the scanner's least range: neither may be shown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """What the fleet looks like at one time."""

    number: int  #: Counter from 0.
    rgb: NDArray[np.uint8]  #: A picture, shape (H, W, 3).
    depth_mm: NDArray[np.uint16]  #: Depth registered to it, shape (H, W).

    @property
    def stamp_ns(self) -> int:
        """When everything was captured."""
        return START_NS + self.number * PERIOD_NS

    def header(self, frame: str) -> Any:
        """Return a header of this moment."""
        return header_msg(frame, self.stamp_ns)

    @property
    def bgr(self) -> NDArray[np.uint8]:
        """The picture as encoders take it."""
        return np.ascontiguousarray(self.rgb[..., ::-1])

    @property
    def place(self) -> NDArray[np.float64]:
        """Where the robot is, metres, exact in binary so that it survives every representation."""
        return np.array([self.number / 8, 1 - self.number / 16, 0.25])

    def halved(self) -> Moment:
        """Return the same with every second pixel of every second row."""
        picture, depth = self.rgb[::2, ::2], self.depth_mm[::2, ::2]
        return replace(
            self, rgb=np.ascontiguousarray(picture), depth_mm=np.ascontiguousarray(depth)
        )


def scene_moments(count: int, seed: int) -> list[Moment]:
    """Return pictures with measured depth, as a camera would see them that wanders over a scene."""
    source = open_source("stereo", width=SIZE[0], height=SIZE[1], seed=seed)
    found = []
    for number in range(count):
        frame = source.frame()
        assert frame.depth_mm is not None
        rgb = np.ascontiguousarray(frame.bgr[..., ::-1])
        found.append(Moment(number=number, rgb=rgb, depth_mm=frame.depth_mm))
    source.close()
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """One topic of the scene and what a recording must hold of it."""

    kind: str  #: The visualizer that is asked for.
    topic: str  #: Its topic.
    type: str  #: Its ROS type.
    messages: tuple[Any, ...]  #: One a moment, None where it does not speak.
    #: Entity and component; empty: nothing is compared message by message.
    place: tuple[str, str] = ("", "")
    is_timeless: bool = False  #: Whether it is shown for all times.
    expected: tuple[Any, ...] = ()  #: What a recording must hold there, for each message.


@dataclass(frozen=True, slots=True)
class _Speaker:
    """A topic, how its messages are made, and what each moment shows as which component of an entity."""

    kind: str
    topic: str
    type: str
    say: Callable[[Moment], Any]
    component: str = ""
    shows: Callable[[Moment], Any] | None = None
    below: str = ""
    entity: str = ""

    def part(self, moments: Sequence[Moment]) -> Part:
        entity = self.entity or entity_below("go2", self.topic) + self.below
        return Part(
            kind=self.kind,
            topic=self.topic,
            type=self.type,
            messages=tuple(map(self.say, moments)),
            place=(entity, self.component),
            expected=tuple(map(self.shows, moments)) if self.shows else (),
        )


def entity_below(agent: str, topic: str) -> str:
    """Return the entity of an agent's topic: ``/<scope>/<agent>/x`` is ``/agents/<agent>/<scope>/x``."""
    _, scope, *rest = topic.split("/")
    return "/".join(("/agents", agent, scope, *rest[1:]))


def make_parts(moments: Sequence[Moment]) -> tuple[Part, ...]:
    """Return the scene: all speak at every moment, but for what is said once; pictures at half the size."""
    small = [moment.halved() for moment in moments]
    sensors = (*_PICTURES, *_videos(small), *_POINTS)
    static = replace(_FIXED.part(small), is_timeless=True, expected=(_MOUNT,))
    parts = [speaker.part(small) for speaker in (*sensors, *_PLACED)]
    return (*parts, static, *(speaker.part(small) for speaker in _STATUS))


# What sensors say: pictures, videos, points.


def image_message(array: NDArray[Any], encoding: str, header: Any) -> Any:
    """Return an ``Image``."""
    return message_type(_IMAGE)(
        header=header,
        height=array.shape[0],
        width=array.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=array[0].nbytes,
        data=np.ascontiguousarray(array).reshape(-1).view(np.uint8),
    )


def compressed_message(fields: Any, header: Any) -> Any:
    """Return a ``CompressedImage`` of an encoder's fields."""
    data = np.frombuffer(fields.data, np.uint8)
    return message_type(codecs.COMPRESSED_IMAGE)(header=header, format=fields.format, data=data)


def camera_info(header: Any, size: tuple[int, int]) -> Any:
    """Return a ``CameraInfo`` of a rectified camera with a focal length of 0.72 widths."""
    focal, (width, height) = 0.72 * size[0], size
    k = np.array([focal, 0, width / 2 - 0.5, 0, focal, height / 2 - 0.5, 0, 0, 1])
    return default_message(_INFO, header=header, width=width, height=height, k=k)


def back_projected(
    depth_mm: NDArray[Any], info: Any, *, step: int, max_m: float
) -> NDArray[np.float64]:
    """Return the points of a depth image, mm, by its inverse intrinsics, in double precision, row by row.

    The image has shape (H, W), 0 where unknown; every `step`-th row and column is taken up to a depth of
    `max_m`.
    """
    inverse = np.linalg.inv(np.asarray(info.k, dtype=np.float64).reshape(3, 3))
    height, width = depth_mm.shape
    v, u = np.meshgrid(np.arange(0, height, step), np.arange(0, width, step), indexing="ij")
    z = depth_mm[v, u] / 1000.0
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ inverse.T
    return np.asarray((rays * z[..., None])[(z > 0) & (z <= max_m)])


def _info(moment: Moment) -> Any:
    height, width = moment.depth_mm.shape
    return camera_info(moment.header(CAMERA), (width, height))


def _intrinsics(moment: Moment) -> Any:
    """Return what is shown of a camera: a matrix of Rerun stands column by column."""
    return _info(moment).k.reshape(3, 3).T.reshape(-1)


def _raw(moment: Moment) -> Any:
    return image_message(moment.rgb, "rgb8", moment.header(CAMERA))


def _jpeg(moment: Moment) -> Any:
    return codecs.compressed_image_fields(moment.bgr, "jpeg")


_PICTURES = (
    _Speaker(
        "image", f"{_COLOR}/image_raw", _IMAGE, _raw, "Image:buffer", lambda m: m.rgb.reshape(-1)
    ),
    _Speaker(
        "compressed_image",
        "/global/go2/camera_front/color/compressed",
        codecs.COMPRESSED_IMAGE,
        lambda moment: compressed_message(_jpeg(moment), moment.header(CAMERA)),
        "EncodedImage:blob",
        lambda m: np.frombuffer(_jpeg(m).data, np.uint8),
    ),
    _Speaker(
        "camera_info",
        f"{_DEPTH}/camera_info",
        _INFO,
        _info,
        "Pinhole:image_from_camera",
        _intrinsics,
    ),
)


def _videos(moments: Sequence[Moment]) -> Iterator[_Speaker]:
    """Yield the same video in each of the three messages that carry one."""
    height, width = moments[0].depth_mm.shape
    settings = replace(codecs.TABLE_2, encoder="libx264", width=width, height=height, gop=5)
    encoder = codecs.H264Encoder(settings)
    units = [unit for moment in moments for unit in encoder.encode(moment.bgr)]

    def data(moment: Moment) -> NDArray[np.uint8]:
        return np.frombuffer(units[moment.number].data, np.uint8)

    def ffmpeg(moment: Moment) -> Any:
        fields = asdict(codecs.ffmpeg_packet_fields(units[moment.number], settings)) | {
            "data": data(moment)
        }
        return message_type(codecs.FFMPEG_PACKET)(header=moment.header(CAMERA), **fields)

    def foxglove(moment: Moment) -> Any:
        fields = {"frame_id": CAMERA, "format": "h264", "data": data(moment)}
        return message_type(codecs.COMPRESSED_VIDEO)(
            timestamp=stamp_from_ns(moment.stamp_ns), **fields
        )

    def still(moment: Moment) -> Any:
        return message_type(codecs.COMPRESSED_IMAGE)(
            header=moment.header(CAMERA), format="h264", data=data(moment)
        )

    for kind, name, type_, say in (
        ("ffmpeg_video", "camera_front/color/ffmpeg", codecs.FFMPEG_PACKET, ffmpeg),
        ("compressed_video", "camera_left/color/compressed", codecs.COMPRESSED_VIDEO, foxglove),
        ("compressed_image_video", "camera_right/color/compressed", codecs.COMPRESSED_IMAGE, still),
    ):
        yield _Speaker(kind, f"/global/go2/{name}", type_, say, "VideoStream:sample", data)


def _depth(moment: Moment) -> Any:
    return image_message(moment.depth_mm, "16UC1", moment.header(CAMERA))


def _compressed_depth(moment: Moment) -> Any:
    return compressed_message(
        codecs.compressed_depth_fields(moment.depth_mm), moment.header(CAMERA)
    )


def _back(moment: Moment) -> NDArray[np.float64]:
    return back_projected(moment.depth_mm, _info(moment), step=4, max_m=10.0).reshape(-1)


def _corners(moment: Moment) -> NDArray[np.float32]:
    grid = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(grid + moment.place, dtype=np.float32)


def _corner_list(moment: Moment) -> NDArray[np.float32]:
    return _corners(moment).reshape(-1)


def _cloud(moment: Moment) -> Any:
    corners = _corners(moment)
    field = message_type("sensor_msgs/msg/PointField")
    return message_type("sensor_msgs/msg/PointCloud2")(
        header=moment.header("go2/lidar"),
        height=1,
        width=len(corners),
        fields=[
            field(name=axis, offset=4 * at, datatype=7, count=1) for at, axis in enumerate("xyz")
        ],
        is_bigendian=False,
        point_step=12,
        row_step=12 * len(corners),
        data=corners.reshape(-1).view(np.uint8),
        is_dense=True,
    )


def _scan(moment: Moment) -> Any:
    given: dict[str, Any] = {
        "angle_increment": float(np.pi / 6),
        "range_min": 0.8,
        "range_max": 10.0,
    }
    given |= {
        "header": moment.header("go2/lidar"),
        "ranges": _RANGES + np.float32(moment.number / 16),
    }
    return default_message("sensor_msgs/msg/LaserScan", **given)


def _hits(moment: Moment) -> NDArray[np.float64]:
    kept = [0, 1, 3, 5]
    angles = np.arange(len(_RANGES))[kept] * np.pi / 6
    ranges = _RANGES[kept].astype(np.float64) + moment.number / 16
    return np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles), 0 * angles]).reshape(
        -1
    )


_LIDAR, _SPOTS = "/local/go2/lidar", "Points3D:positions"
_PACKED = f"{_DEPTH}/compressed_depth"
_POINTS = (
    _Speaker("depth_cloud", f"{_DEPTH}/image_raw", _IMAGE, _depth, _SPOTS, _back, "/cloud"),
    _Speaker(
        "compressed_depth_cloud",
        _PACKED,
        codecs.COMPRESSED_IMAGE,
        _compressed_depth,
        _SPOTS,
        _back,
        "/cloud",
    ),
    _Speaker(
        "point_cloud",
        f"{_LIDAR}/points",
        "sensor_msgs/msg/PointCloud2",
        _cloud,
        _SPOTS,
        _corner_list,
    ),
    _Speaker("laser_scan", f"{_LIDAR}/scan", "sensor_msgs/msg/LaserScan", _scan, _SPOTS, _hits),
)


# What is said of places: poses, ways, frames, markers.


def _pose(place: NDArray[np.float64]) -> Any:
    return Pose.at(place.tolist()).to_pose_msg()


def _stamped(moment: Moment, share: float = 1.0) -> Any:
    pose = _pose(moment.place * share)
    return message_type("geometry_msgs/msg/PoseStamped")(header=moment.header("map"), pose=pose)


def _path(moment: Moment) -> Any:
    poses = [_stamped(moment, share) for share in (0.0, 0.5, 1.0)]
    return message_type("nav_msgs/msg/Path")(header=moment.header("map"), poses=poses)


def _odometry(moment: Moment) -> Any:
    message = default_message("nav_msgs/msg/Odometry")
    message.header, message.child_frame_id = moment.header("map"), "go2/base"
    message.pose.pose = _pose(moment.place)
    message.pose.covariance = np.diag([0.01, 0.02, 0.01, 0, 0, 0]).reshape(-1)
    return message


def _imu(moment: Moment) -> Any:
    turning = message_type("geometry_msgs/msg/Vector3")(*map(float, moment.place))
    return default_message(
        "sensor_msgs/msg/Imu", header=moment.header("go2/imu"), angular_velocity=turning
    )


def transforms_message(moment: Moment, edges: Sequence[tuple[str, str, Pose]]) -> Any:
    """Return a ``TFMessage`` of a moment; an edge is parent, child, and where the child is."""
    found = [
        StampedTransform(parent=a, child=b, stamp_ns=moment.stamp_ns, pose=pose)
        for a, b, pose in edges
    ]
    return message_type(_TF)(transforms=[transform.to_msg() for transform in found])


def _moving(moment: Moment) -> Any:
    return transforms_message(moment, [("map", "go2/base", Pose.at(moment.place.tolist()))])


def _fixed(moment: Moment) -> Any:
    edges = [("go2/base", "go2/lidar", Pose.at(_MOUNT.tolist()))]
    return None if moment.number else transforms_message(moment, edges)


def _marker(moment: Moment) -> Any:
    named = {"header": moment.header("map"), "ns": "goal", "id": 3, "type": 1}
    marker = default_message(_MARKER, pose=_pose(moment.place), **named)
    marker.scale.x = marker.scale.y = marker.scale.z = 0.5
    marker.color.r = marker.color.a = 1.0
    return marker


def _markers(moment: Moment) -> Any:
    return message_type(f"{_MARKER}Array")(markers=[_marker(moment)])


def _axes(moment: Moment) -> NDArray[np.float64]:
    return np.tile(moment.place, 3)


def _line(moment: Moment) -> NDArray[np.float64]:
    return np.concatenate([0 * moment.place, moment.place / 2, moment.place])


_PLACE = attrgetter("place")
_LOCALIZATION, _IMU = "/global/go2/localization", "/local/go2/imu/imu"
_ARROWS, _MOVED, _SPINS = "Arrows3D:origins", "Transform3D:translation", "/angular_velocity"
_STRIPS, _BOXES = "LineStrips3D:strips", "Boxes3D:centers"
_POSE, _ODOMETRY = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Odometry"
_PLACED = (
    _Speaker("pose", f"{_LOCALIZATION}/pose", _POSE, _stamped, _ARROWS, _axes),
    _Speaker(
        "odometry", f"{_LOCALIZATION}/odometry", _ODOMETRY, _odometry, _ARROWS, _axes, "/pose"
    ),
    _Speaker("path", "/global/go2/planner/path", "nav_msgs/msg/Path", _path, _STRIPS, _line),
    _Speaker("imu", _IMU, "sensor_msgs/msg/Imu", _imu, "Scalars:scalars", _PLACE, _SPINS),
    _Speaker("tf", "/tf", _TF, _moving, _MOVED, _PLACE, entity="/tf/go2/base"),
    _Speaker("marker", "/goal", _MARKER, _marker, _BOXES, _PLACE, entity="/goal/goal/3"),
    _Speaker(
        "marker_array",
        "/goals",
        f"{_MARKER}Array",
        _markers,
        _BOXES,
        _PLACE,
        entity="/goals/goal/3",
    ),
)
_FIXED = _Speaker("tf_static", "/tf_static", _TF, _fixed, _MOVED, entity="/tf/go2/lidar")


# What agents say of themselves.


def _beat(moment: Moment) -> Any:
    agent = "pi1" if moment.number == _SILENT_AFTER else "go2"
    said = {"stamp": stamp_from_ns(moment.stamp_ns), "phase": message_type(_BEAT).STEADY}
    return default_message(_BEAT, agent=agent, period_s=0.2, incarnation=1, **said)


def _event(moment: Moment) -> Any:
    kinds = message_type(_EVENT)
    event = kinds.LOST if moment.number % 2 else kinds.DISCOVERED
    return default_message(_EVENT, stamp=stamp_from_ns(moment.stamp_ns), agent="go2", event=event)


def _told(moment: Moment) -> list[str]:
    return [f"go2 {'lost' if moment.number % 2 else 'discovered'}"]


_EVENT, _BEAT = (f"sfglab_interfaces/msg/Agent{name}" for name in ("DiscoveryEvent", "Heartbeat"))
_EVENTS, _LOG = "/agent_discovery_event", "/agents/go2/status/log"
_STATUS = (
    _Speaker(
        "agent_status",
        f"/local/ground{_EVENTS}",
        _EVENT,
        _event,
        "TextLog:text",
        _told,
        entity=_LOG,
    ),
    _Speaker("communication", "/global/agent_heartbeat", _BEAT, _beat),
)
