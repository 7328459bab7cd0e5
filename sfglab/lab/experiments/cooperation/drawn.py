"""The module `cooperation.drawn` writes the laps that the figures show, as tracks and as ROS messages.

The topics of a lap are ``/<lap>/<robot>/pose``, ``/<lap>/<robot>/scan``, ``/<lap>/<robot>/walls`` and ``/tf``.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp import hallway
from sfglab.arp.hallway import ROBOTS
from sfglab.arp.hallway.simulation import SimulatedLap
from sfglab.arp.robots import BEST
from sfglab.lab.experiments.cooperation.experiment import (
    NONE,
    Config,
    CourseRow,
    course_row,
    exp,
    settings_of_row,
    track_rows,
)
from sfglab.messages import default_message, message_type
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.poses import header_msg
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from sfglab.arp.hallway.simulation import Snapshot
    from sfglab.lab.bench import Bench
    from sfglab.lab.experiments.cooperation.experiment import TrackRow
    from sfglab.record import LogWriter

SUCCESS, FAILURE = "success", "failure"  #: Names of the laps that the figures show.
HALLWAY_SHIFT_M = 7.0
"""Distance between the robots' hallways in the messages, to the right. The simulated hallways are congruent."""

_SHIFTS_M = {robot: HALLWAY_SHIFT_M * number for number, robot in enumerate(ROBOTS)}


@exp.part("drawn runs")
def write_drawn_laps(bench: Bench[Config]) -> None:
    """Simulate the laps of the figures again, and write the tracks and messages of these laps."""
    examples = examples_of(bench.rows["course"])
    named = {name: asdict(row) for name, row in examples.items()}
    bench.metadata("examples", named)
    for name, row in examples.items():
        settings = settings_of_row(row)
        lap = SimulatedLap(settings, row.seed, record=True)
        again = course_row(settings, row.seed, lap.run())
        assert again == row, "the same settings and seed give the same lap"
        write_tracks(bench, track_rows(name, lap.snapshots))
        _write_walls(bench.log, name)
        for snapshot in lap.snapshots:
            _write_snapshot(bench.log, name, snapshot)


def examples_of(rows: Sequence[CourseRow]) -> dict[str, CourseRow]:
    """Return the laps for the figures: the first suitable laps in the sweep's order.

    Fig. 17 shows a completed lap, Fig. 18 a failed lap. The paper names the method of neither lap. By section 3.2
    OPT+LC completes the lap, so the completed lap is one with OPT+LC, and the failed lap is one without any method.
    If the named method has no suitable lap, a lap of another method takes its place.
    """
    examples = {}
    for name, method in ((SUCCESS, BEST), (FAILURE, NONE)):
        is_success = name == SUCCESS
        ended_so = [row for row in rows if (row.end == hallway.End.SUCCESS.value) == is_success]
        of_method = [row for row in ended_so if row.method == method]
        for row in [*of_method, *ended_so][:1]:
            examples[name] = row
    return examples


def write_tracks(bench: Bench[Config], tracks: Iterable[TrackRow]) -> None:
    """Write the rows of tracks at the times of their poses."""
    for track in tracks:
        bench.write(track, at_ns=round(track.t_s * NS_PER_S))


def _write_snapshot(log: LogWriter, lap: str, snapshot: Snapshot) -> None:
    """Write the robots' poses, scans and transforms."""
    stamped = message_type("geometry_msgs/msg/PoseStamped")
    transforms = message_type("tf2_msgs/msg/TFMessage")
    now_ns = round(snapshot.time_s * NS_PER_S)
    for number, robot in enumerate(ROBOTS):
        frame = f"{lap}/{robot}"
        x_m, y_m, heading_rad = snapshot.poses[number].tolist()
        pose = Pose.from_yaw((x_m + _SHIFTS_M[robot], y_m, 0.0), heading_rad)
        transform = StampedTransform(parent="map", child=frame, stamp_ns=now_ns, pose=pose)
        messages = {
            f"/{frame}/pose": stamped(header=header_msg("map", now_ns), pose=pose.to_pose_msg()),
            f"/{frame}/scan": _scan(snapshot.measured_m[number], frame, now_ns),
            "/tf": transforms(transforms=[transform.to_msg()]),
        }
        for topic, message in messages.items():
            log.write(topic, message, log_time_ns=now_ns)


def _scan(ranges_m: Any, frame: str, now_ns: int) -> Any:
    return default_message(
        "sensor_msgs/msg/LaserScan",
        header=header_msg(frame, now_ns),
        angle_max=np.float32(math.radians(hallway.BEAMS_DEG[-1])),
        angle_increment=np.float32(math.radians(hallway.BEAMS_DEG[1])),
        scan_time=np.float32(1 / hallway.SCAN_HZ),
        range_min=np.float32(0.15),
        range_max=np.float32(12.0),
        ranges=ranges_m.astype(np.float32),
    )


def _write_walls(log: LogWriter, lap: str) -> None:
    """Write each robot's walls and boxes as pairs of points."""
    kind = message_type("visualization_msgs/msg/Marker")
    point = message_type("geometry_msgs/msg/Point")
    grey = dict.fromkeys("rgb", np.float32(0.6))
    for area in hallway.AREAS:
        ends = area.segments.reshape(-1, 2).tolist()
        message = default_message(
            kind,
            header=header_msg("map", 0),
            ns=area.robot,
            type=kind.LINE_LIST,
            color=default_message("std_msgs/msg/ColorRGBA", a=np.float32(1.0), **grey),
            points=[point(x=x_m + _SHIFTS_M[area.robot], y=y_m, z=0.0) for x_m, y_m in ends],
        )
        message.scale.x = 0.02
        log.write(f"/{lap}/{area.robot}/walls", message, log_time_ns=0)
