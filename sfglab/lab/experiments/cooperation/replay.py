"""A drawn run as ROS messages in the log, which every MCAP viewer shows, and as a recording of Rerun.

Topics are ``/<run>/<robot>/pose`` and ``/scan``, and the walls are markers. Areas lie beside each other, as in
the figures.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.hallway import AREAS, BEAMS_DEG, RADIUS_M, range_from_step, step_from_range
from sfglab.arp.hallway.course import scan
from sfglab.messages import default_message, message_type, stamp_from_ns

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import pandas as pd
    from numpy.typing import NDArray

    from sfglab.arp.hallway import Area
    from sfglab.lab.experiments.cooperation.rows import TrackRow
    from sfglab.record import LogWriter


AREA_SHIFT_M = 7.0
"""How far apart areas are drawn, to the right."""

_S = 1_000_000_000
_BY_ROBOT = {area.robot: (number, area) for number, area in enumerate(AREAS)}
_COLORS = {"success": (0, 158, 115), "failure": (213, 94, 0)}


def scan_at(area: Area, x: float, y: float, heading: float) -> NDArray[np.float64]:
    """Return what a robot's LIDAR measures at a pose, metres, infinity without an echo, shape (beams,)."""
    ranges = np.empty(len(BEAMS_DEG))
    scan(area.segments, np.array((x, y, heading)), np.radians(BEAMS_DEG), ranges)
    return np.array([range_from_step(step_from_range(range_m)) for range_m in ranges])


def write_messages(log: LogWriter, tracks: Sequence[TrackRow]) -> None:
    """Write a run's tracks as poses and scans, and its walls.

    Args:
        log: Where.
        tracks: In the order of time.
    """
    for area in AREAS if tracks else ():
        log.write(f"/{tracks[0].run}/{area.robot}/walls", _walls(area), log_time_ns=0)
    for track in tracks:
        now_ns, topic = round(track.t_s * _S), f"/{track.run}/{track.robot}"
        log.write(f"{topic}/pose", _pose(track, now_ns), log_time_ns=now_ns)
        log.write(f"{topic}/scan", _scan(track, now_ns), log_time_ns=now_ns)
        log.write("/tf", _transform(track, now_ns), log_time_ns=now_ns)


def _header(frame: str, now_ns: int) -> Any:
    return message_type("std_msgs/msg/Header")(stamp=stamp_from_ns(now_ns), frame_id=frame)


def _frame(track: TrackRow) -> str:
    return f"{track.run}/{track.robot}"


def _pose(track: TrackRow, now_ns: int) -> Any:
    message = default_message("geometry_msgs/msg/PoseStamped")
    message.header = _header("map", now_ns)
    message.pose.position.x = track.x_m + AREA_SHIFT_M * _BY_ROBOT[track.robot][0]
    message.pose.position.y = track.y_m
    _turn(message.pose.orientation, track.heading_rad)
    return message


def _turn(orientation: Any, heading_rad: float) -> None:
    orientation.z, orientation.w = math.sin(heading_rad / 2), math.cos(heading_rad / 2)


def _transform(track: TrackRow, now_ns: int) -> Any:
    transform = default_message("geometry_msgs/msg/TransformStamped")
    transform.header = _header("map", now_ns)
    transform.child_frame_id = _frame(track)
    transform.transform.translation.x = track.x_m + AREA_SHIFT_M * _BY_ROBOT[track.robot][0]
    transform.transform.translation.y = track.y_m
    _turn(transform.transform.rotation, track.heading_rad)
    message: Any = message_type("tf2_msgs/msg/TFMessage")(transforms=[transform])
    return message


def _scan(track: TrackRow, now_ns: int) -> Any:
    message = default_message("sensor_msgs/msg/LaserScan")
    message.header = _header(_frame(track), now_ns)
    message.angle_max = np.float32(math.radians(BEAMS_DEG[-1]))
    message.angle_increment = np.float32(math.radians(BEAMS_DEG[1]))
    message.scan_time = np.float32(0.1)
    message.range_min, message.range_max = np.float32(0.15), np.float32(12.0)
    ranges = scan_at(_BY_ROBOT[track.robot][1], track.x_m, track.y_m, track.heading_rad)
    message.ranges = ranges.astype(np.float32)
    return message


def _walls(area: Area) -> Any:
    message = default_message("visualization_msgs/msg/Marker")
    message.header = _header("map", 0)
    message.ns = area.robot
    message.type = 5  # LINE_LIST
    message.scale.x = 0.02
    message.color.r = message.color.g = message.color.b = np.float32(0.6)
    message.color.a = np.float32(1.0)
    point = message_type("geometry_msgs/msg/Point")
    message.points = [point(x=x, y=y, z=0.0) for x, y in _wall_points(area)]
    return message


def _wall_points(area: Area) -> list[tuple[float, float]]:
    """Return both ends of every wall, one after the other, where the area is drawn."""
    shift = AREA_SHIFT_M * _BY_ROBOT[area.robot][0]
    return [(float(x) + shift, float(y)) for x, y in area.segments.reshape(-1, 2)]


def write_rerun(tracks: pd.DataFrame, path: Path) -> Path:
    """Write tracks as a recording for the Rerun viewer (extra ``view``).

    Args:
        tracks: The log's table ``track``.
        path: The recording, by convention ending in ``.rrd``.

    Raises:
        ModuleNotFoundError: rerun-sdk is not installed.
    """
    import rerun as rr

    with rr.RecordingStream("sfglab_cooperation", recording_id=path.stem) as recording:
        recording.save(path)
        for area in AREAS:
            ends = np.array(_wall_points(area)).reshape(-1, 2, 2)
            walls = rr.LineStrips2D(ends, colors=(150, 150, 150))
            recording.log(f"areas/{area.robot}", walls, static=True)
        for row in tracks.sort_values("t_s").itertuples():
            _log_robot(recording, row)
    return path


def _log_robot(recording: Any, row: Any) -> None:
    import rerun as rr

    number, area = _BY_ROBOT[row.robot]
    middle = np.array((row.x_m + AREA_SHIFT_M * number, row.y_m))
    angles = row.heading_rad + np.radians(BEAMS_DEG)
    ranges = scan_at(area, row.x_m, row.y_m, row.heading_rad)
    seen = np.isfinite(ranges)
    ends = middle + (ranges[seen] * np.array((np.cos(angles[seen]), np.sin(angles[seen])))).T
    color = _COLORS.get(row.run, (0, 114, 178))
    recording.set_time("time", duration=row.t_s)
    place = f"{row.run}/{row.robot}"
    recording.log(place, rr.Points2D([middle], radii=RADIUS_M, colors=color))
    beams = [np.stack((middle, end)) for end in ends]
    recording.log(f"{place}/beams", rr.LineStrips2D(beams, colors=(*color, 90)))
