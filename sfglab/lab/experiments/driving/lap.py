"""The lap that is drawn: its town, its moments five times a second, some with pictures, as ROS messages.

Every MCAP viewer shows the messages. Frames: ``map`` is the town, ``odom`` where the odometry began, ``car``
the car's true pose with x forward.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from sfglab.lab.experiments.driving.experiment import (
    Config,
    DrivingTrackRow,
    chain_of,
    exp,
    nodes_of,
    transfers_of,
)
from sfglab.messages import default_message, message_type
from sfglab.soc.driving import Camera, Frame, Lap, Rules, Stack, Town, make_town, run_lap
from sfglab.soc.driving.town import LANE_M, Road, Signals
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.poses import header_msg
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from sfglab.lab.bench import Bench
    from sfglab.record import LogWriter
    from sfglab.soc.driving.car import CarState

IMAGE_TOPIC, MASK_TOPIC = "/image/compressed", "/lane_mask/compressed"

_CUBE, _LINE_STRIP, _LINE_LIST, _SPHERE = 1, 4, 5, 2
_RED, _GREEN = (0.9, 0.15, 0.1), (0.1, 0.75, 0.2)
_PATH_M = np.linspace(0.6, 2.4, 7)

PICTURE_SIZE = (240, 180)  #: Width and height of pictures in the log; the camera's are larger.

_TRACK_FRAMES, _PICTURE_FRAMES, _STANDING_FRAMES = 3, 6, 30
"""Of 15 frames a second, which are moments, and which of these have a picture: driving and standing."""

_JPEG_QUALITY = 25
_STANDING_MPS = 0.02


@exp.part("drawn lap", timed=False)
def draw_lap(bench: Bench[Config]) -> None:
    """Drive the first lap again and keep its moments; write what the graph says of the chain."""
    config = bench.config
    lap, moments = record_lap(config.seed, config.lap.limit_s)
    verdict = asdict(lap.verdict)
    judged = {name: getattr(bench.rows["lap"][0], name) for name in verdict}
    assert judged == verdict, "the same seed is the same lap"
    chain = chain_of(config.chain)
    bench.write_all("node", nodes_of(chain))
    bench.write_all("transfer", transfers_of(chain))
    town = town_metadata(config.seed)
    bench.metadata("town", town)
    for moment in moments:
        bench.write("track", moment.row, at_ns=round(moment.row.t_s * NS_PER_S))
    write_messages(bench.log, town, moments)


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """A moment as it goes into the log."""

    row: DrivingTrackRow  #: What there is in numbers.
    image_jpeg: bytes = b""  #: The camera's image, smaller; empty without one.
    mask_png: bytes = b""  #: The lane planner's bird's view; empty without one.


def record_lap(seed: int, limit_s: float) -> tuple[Lap, list[Moment]]:
    """Drive a lap again; return it, without node times, and its moments."""
    stack = Stack(Camera())
    recorder = Recorder(make_town(np.random.default_rng(seed)), stack)
    lap = run_lap(seed, stack=stack, rules=Rules(timeout_s=limit_s), watch=recorder.watch)
    return lap, recorder.moments


class Recorder:
    """Watches a lap in its town, driven by a stack of nodes."""

    def __init__(self, town: Town, stack: Stack) -> None:
        self.moments: list[Moment] = []
        self._town, self._stack = town, stack
        self._signals = Signals(
            town
        )  # they change by the car's place alone, so these are the lap's
        self._frames = 0

    def watch(self, now_s: float, car: CarState, frame: Frame) -> None:
        """Take a frame of `run_lap`."""
        place = self._town.lane.place(car.x_m, car.y_m)
        red = [since is not None for since in self._signals.red_since_s(now_s, place)]
        number, self._frames = self._frames, self._frames + 1
        if number % _TRACK_FRAMES:
            return
        every = _STANDING_FRAMES if car.speed_mps < _STANDING_MPS else _PICTURE_FRAMES
        pictured = number % every == 0
        lane, pose, command = frame.lane, frame.pose, frame.command
        row = DrivingTrackRow(
            t_s=now_s,
            x_m=car.x_m,
            y_m=car.y_m,
            yaw_rad=car.yaw_rad,
            speed_mps=car.speed_mps,
            left_m=place.left_m,
            red="".join(str(int(one)) for one in red),
            held=self._stack.control.held,
            lane_seen=lane is not None,
            lane_offset_m=lane.offset_m if lane else math.nan,
            lane_slope=lane.slope if lane else math.nan,
            lane_bend_per_m=lane.bend_per_m if lane else math.nan,
            odometry_x_m=pose.x_m,
            odometry_y_m=pose.y_m,
            odometry_yaw_rad=pose.yaw_rad,
            command_mps=command.speed_mps,
            command_rps=command.yaw_rate_rps,
            pictured=pictured,
        )
        seen = {"image_jpeg": _jpeg(frame.image), "mask_png": _png(frame.mask)} if pictured else {}
        self.moments.append(Moment(row=row, **seen))


def town_metadata(seed: int) -> dict[str, Any]:
    """Return what stands in the town of a seed, in numbers for the log: metres, to the millimetre.

    Returns:
        ``seed``; ``road``: the yellow line's points; ``buildings``: four corners each; ``lights``: middle of
        the stop line, heading, and whether it rests in red.
    """
    town = make_town(np.random.default_rng(seed))
    return {
        "seed": seed,
        "road": town.road.points_xy[::4].round(3).tolist(),
        "buildings": [
            _corners(b.x_m, b.y_m, b.yaw_rad, b.length_m, b.width_m) for b in town.buildings
        ],
        "lights": [
            [*(round(value, 3) for value in town.lane.at(light.stop_m)), light.wait_s is not None]
            for light in town.lights
        ],
    }


def _corners(
    x_m: float, y_m: float, yaw_rad: float, length_m: float, width_m: float
) -> list[list[float]]:
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    corners = signs * (length_m / 2, width_m / 2) @ np.array([[cos, sin], [-sin, cos]]) + (x_m, y_m)
    rounded: list[list[float]] = corners.round(3).tolist()
    return rounded


def _jpeg(bgr: NDArray[np.uint8]) -> bytes:
    small = cv2.resize(bgr, PICTURE_SIZE, interpolation=cv2.INTER_AREA)
    return cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


def _png(mask: NDArray[np.uint8]) -> bytes:
    return cv2.imencode(".png", mask, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()


def lane_points(row: Any) -> list[tuple[float, float]]:
    """Return points of the lane that was seen at a moment, in the car's frame, metres; none without a lane."""
    if not row.lane_seen:
        return []
    y = row.lane_offset_m + row.lane_slope * _PATH_M + row.lane_bend_per_m * _PATH_M**2
    return list(zip(_PATH_M.tolist(), y.tolist(), strict=True))


def road_lines(town: Mapping[str, Any]) -> dict[str, list[list[float]]]:
    """Return a town's closed lines: ``yellow`` in the middle, ``white`` on the right, ``white_left``."""
    road = Road(np.array(town["road"]))
    sides = {"yellow": 0.0, "white": -LANE_M, "white_left": LANE_M}
    lines = {name: road.beside(left)[::4] for name, left in sides.items()}
    return {name: np.vstack([line, line[:1]]).tolist() for name, line in lines.items()}


def write_messages(log: LogWriter, town: Mapping[str, Any], moments: Sequence[Moment]) -> None:
    """Write a lap's moments, in the order of time, and its town, as from `town_metadata`."""
    if not moments:
        return
    log.write("/town", _town_markers(town), log_time_ns=0)
    start, lights = moments[0].row, ""
    for moment in moments:
        row, now_ns = moment.row, round(moment.row.t_s * NS_PER_S)
        log.write("/tf", _transforms(start, row, now_ns), log_time_ns=now_ns)
        log.write("/pose", _odometry(row, now_ns), log_time_ns=now_ns)
        command = default_message("geometry_msgs/msg/Twist")
        command.linear.x, command.angular.z = row.command_mps, row.command_rps
        log.write("/cmd_vel", command, log_time_ns=now_ns)
        if row.red != lights:
            lights = row.red
            log.write("/lights", _light_markers(town, row, now_ns), log_time_ns=now_ns)
        if moment.image_jpeg:
            log.write(IMAGE_TOPIC, _picture(moment.image_jpeg, "jpeg", now_ns), log_time_ns=now_ns)
            log.write(MASK_TOPIC, _picture(moment.mask_png, "png", now_ns), log_time_ns=now_ns)
            log.write("/lane/path", _path(row, now_ns), log_time_ns=now_ns)


def _transforms(start: DrivingTrackRow, row: DrivingTrackRow, now_ns: int) -> Any:
    pose = Pose.from_yaw((row.x_m, row.y_m, 0.0), row.yaw_rad)
    children = ("car", "odom") if row is start else ("car",)
    moved = [
        StampedTransform(parent="map", child=child, stamp_ns=now_ns, pose=pose)
        for child in children
    ]
    return message_type("tf2_msgs/msg/TFMessage")(transforms=[each.to_msg() for each in moved])


def _odometry(row: DrivingTrackRow, now_ns: int) -> Any:
    pose = Pose.from_yaw(
        (row.odometry_x_m, row.odometry_y_m, 0.0), row.odometry_yaw_rad
    ).to_pose_msg()
    return message_type("geometry_msgs/msg/PoseStamped")(
        header=header_msg("odom", now_ns), pose=pose
    )


def _picture(data: bytes, kind: str, now_ns: int) -> Any:
    image = message_type("sensor_msgs/msg/CompressedImage")
    frame = "camera" if kind == "jpeg" else "car"
    return image(header=header_msg(frame, now_ns), format=kind, data=np.frombuffer(data, np.uint8))


def _path(row: DrivingTrackRow, now_ns: int) -> Any:
    message = default_message("nav_msgs/msg/Path", header=header_msg("car", now_ns))
    for x, y in lane_points(row):
        pose = default_message("geometry_msgs/msg/PoseStamped", header=message.header)
        pose.pose.position.x, pose.pose.position.y = x, y
        message.poses.append(pose)
    return message


def _marker(name: str, number: int, kind: int, rgb: tuple[float, float, float]) -> Any:
    named = {"ns": name, "id": number, "type": kind}
    message = default_message("visualization_msgs/msg/Marker", header=header_msg("map", 0), **named)
    message.color.r, message.color.g, message.color.b = (np.float32(part) for part in rgb)
    message.color.a = np.float32(1.0)
    message.scale.x = message.scale.y = message.scale.z = 0.05
    return message


def _town_markers(town: Mapping[str, Any]) -> Any:
    point = message_type("geometry_msgs/msg/Point")
    markers = []
    for number, (name, line) in enumerate(road_lines(town).items()):
        marker = _marker(
            "road", number, _LINE_STRIP, (0.9, 0.75, 0.1) if name == "yellow" else (0.9,) * 3
        )
        marker.points = [point(x=x, y=y, z=0.0) for x, y in line]
        markers.append(marker)
    walls = _marker("buildings", 0, _LINE_LIST, (0.6, 0.6, 0.6))
    for corners in town["buildings"]:
        for (ax, ay), (bx, by) in zip(corners, [*corners[1:], corners[0]], strict=True):
            walls.points += [point(x=ax, y=ay, z=0.0), point(x=bx, y=by, z=0.0)]
    return message_type("visualization_msgs/msg/MarkerArray")(markers=[*markers, walls])


def _light_markers(town: Mapping[str, Any], row: DrivingTrackRow, now_ns: int) -> Any:
    markers = []
    for number, ((x, y, *_), red) in enumerate(zip(town["lights"], row.red, strict=True)):
        marker = _marker("lights", number, _SPHERE, _RED if red == "1" else _GREEN)
        marker.header = header_msg("map", now_ns)
        marker.pose.position.x, marker.pose.position.y, marker.pose.position.z = x, y, 0.5
        marker.scale.x = marker.scale.y = marker.scale.z = 0.3
        markers.append(marker)
    return message_type("visualization_msgs/msg/MarkerArray")(markers=markers)
