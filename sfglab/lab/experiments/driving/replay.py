"""The drawn lap as ROS messages in the log, which every MCAP viewer shows, and as a recording of Rerun.

Frames: ``map`` is the town, ``odom`` where the odometry began, ``car`` the car's true pose with x forward.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.messages import default_message, message_type, stamp_from_ns
from sfglab.soc.driving.town import LANE_M, Road

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from sfglab.lab.experiments.driving.recorder import Moment
    from sfglab.lab.experiments.driving.rows import DrivingTrackRow
    from sfglab.record import LogWriter


IMAGE_TOPIC, MASK_TOPIC = "/image/compressed", "/lane_mask/compressed"

_S = 1_000_000_000
_CUBE, _LINE_STRIP, _LINE_LIST, _SPHERE = 1, 4, 5, 2
_RED, _GREEN = (0.9, 0.15, 0.1), (0.1, 0.75, 0.2)
_PATH_M = np.linspace(0.6, 2.4, 7)


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
    """Write a lap.

    Args:
        log: Where.
        town: From `town_metadata`.
        moments: In the order of time.
    """
    if not moments:
        return
    log.write("/town", _town_markers(town), log_time_ns=0)
    start, lights = moments[0].row, ""
    for moment in moments:
        row, now_ns = moment.row, round(moment.row.t_s * _S)
        log.write("/tf", _transforms(start, row, now_ns), log_time_ns=now_ns)
        log.write("/pose", _odometry(row, now_ns), log_time_ns=now_ns)
        log.write("/cmd_vel", _command(row), log_time_ns=now_ns)
        if row.red != lights:
            lights = row.red
            log.write("/lights", _light_markers(town, row, now_ns), log_time_ns=now_ns)
        if moment.image_jpeg:
            log.write(IMAGE_TOPIC, _picture(moment.image_jpeg, "jpeg", now_ns), log_time_ns=now_ns)
            log.write(MASK_TOPIC, _picture(moment.mask_png, "png", now_ns), log_time_ns=now_ns)
            log.write("/lane/path", _path(row, now_ns), log_time_ns=now_ns)


def _header(frame: str, now_ns: int) -> Any:
    return message_type("std_msgs/msg/Header")(stamp=stamp_from_ns(now_ns), frame_id=frame)


def _turn(orientation: Any, yaw_rad: float) -> None:
    orientation.z, orientation.w = math.sin(yaw_rad / 2), math.cos(yaw_rad / 2)


def _transform(child: str, row: DrivingTrackRow, now_ns: int) -> Any:
    transform = default_message("geometry_msgs/msg/TransformStamped")
    transform.header = _header("map", now_ns)
    transform.child_frame_id = child
    transform.transform.translation.x, transform.transform.translation.y = row.x_m, row.y_m
    _turn(transform.transform.rotation, row.yaw_rad)
    return transform


def _transforms(start: DrivingTrackRow, row: DrivingTrackRow, now_ns: int) -> Any:
    both = [_transform("car", row, now_ns)]
    if row is start:
        both.append(_transform("odom", start, now_ns))
    return message_type("tf2_msgs/msg/TFMessage")(transforms=both)


def _odometry(row: DrivingTrackRow, now_ns: int) -> Any:
    message = default_message("geometry_msgs/msg/PoseStamped")
    message.header = _header("odom", now_ns)
    message.pose.position.x, message.pose.position.y = row.odometry_x_m, row.odometry_y_m
    _turn(message.pose.orientation, row.odometry_yaw_rad)
    return message


def _command(row: DrivingTrackRow) -> Any:
    message = default_message("geometry_msgs/msg/Twist")
    message.linear.x, message.angular.z = row.command_mps, row.command_rps
    return message


def _picture(data: bytes, kind: str, now_ns: int) -> Any:
    image = message_type("sensor_msgs/msg/CompressedImage")
    frame = "camera" if kind == "jpeg" else "car"
    return image(header=_header(frame, now_ns), format=kind, data=np.frombuffer(data, np.uint8))


def _path(row: DrivingTrackRow, now_ns: int) -> Any:
    message = default_message("nav_msgs/msg/Path")
    message.header = _header("car", now_ns)
    for x, y in lane_points(row):
        pose = default_message("geometry_msgs/msg/PoseStamped")
        pose.header = message.header
        pose.pose.position.x, pose.pose.position.y = x, y
        message.poses.append(pose)
    return message


def _marker(name: str, number: int, kind: int, rgb: tuple[float, float, float]) -> Any:
    message = default_message("visualization_msgs/msg/Marker")
    message.header = _header("map", 0)
    message.ns, message.id, message.type = name, number, kind
    message.color.r, message.color.g, message.color.b = (np.float32(part) for part in rgb)
    message.color.a = np.float32(1.0)
    message.scale.x = message.scale.y = message.scale.z = 0.05
    return message


def _town_markers(town: Mapping[str, Any]) -> Any:
    point = message_type("geometry_msgs/msg/Point")
    markers = []
    for number, (name, line) in enumerate(road_lines(town).items()):
        marker = _marker("road", number, _LINE_STRIP, (0.9, 0.75, 0.1) if name == "yellow" else (0.9,) * 3)
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
        marker.header = _header("map", now_ns)
        marker.pose.position.x, marker.pose.position.y, marker.pose.position.z = x, y, 0.5
        marker.scale.x = marker.scale.y = marker.scale.z = 0.3
        markers.append(marker)
    return message_type("visualization_msgs/msg/MarkerArray")(markers=markers)


def write_rerun(log: Path, path: Path) -> Path:
    """Write a run's drawn lap as a recording for the Rerun viewer (extra ``view``).

    Rerun opens the log itself as well, and shows images, transforms and poses, but no markers; the recording
    has town, lights and track.

    Args:
        log: The run's log.
        path: The recording, by convention ending in ``.rrd``.

    Raises:
        ModuleNotFoundError: rerun-sdk is not installed.
    """
    import rerun as rr

    from sfglab.record import LogReader

    with LogReader(log) as reader, rr.RecordingStream("sfglab_driving", recording_id=path.stem) as recording:
        recording.save(path)
        _rerun_town(recording, reader.metadata("town"))
        lights = np.array([light[:2] for light in reader.metadata("town")["lights"]])
        track: list[tuple[float, float]] = []
        rows: list[Any] = list(reader.table("track").itertuples())
        for row in rows:
            recording.set_time("time", duration=row.t_s)
            track.append((row.x_m, row.y_m))
            recording.log("map/track", rr.LineStrips2D([np.array(track)], colors=(0, 114, 178)))
            recording.log("map/car", rr.Points2D([track[-1]], radii=0.15, colors=(0, 114, 178)))
            colors = [(220, 40, 30) if red == "1" else (30, 170, 60) for red in row.red]
            recording.log("map/lights", rr.Points2D(lights, radii=0.2, colors=colors))
        for topic, entity in ((IMAGE_TOPIC, "camera"), (MASK_TOPIC, "lane_mask")):
            for entry in reader.decoded(topic):
                recording.set_time("time", duration=entry.log_time_ns / _S)
                kind = f"image/{entry.message.format}"
                recording.log(entity, rr.EncodedImage(contents=bytes(entry.message.data), media_type=kind))
    return path


def _rerun_town(recording: Any, town: Mapping[str, Any]) -> None:
    import rerun as rr

    for name, line in road_lines(town).items():
        color = (220, 180, 20) if name == "yellow" else (190, 190, 190)
        recording.log(f"map/{name}", rr.LineStrips2D([line], colors=color), static=True)
    walls = [[*corners, corners[0]] for corners in town["buildings"]]
    recording.log("map/buildings", rr.LineStrips2D(walls, colors=(150, 150, 150)), static=True)
