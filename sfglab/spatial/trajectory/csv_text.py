"""Trajectories as CSV, a line for every waypoint, and back bit by bit.

Columns: time in seconds with nine decimals, position, quaternion. Refuses to know files.
"""

from __future__ import annotations

import csv
import io
from decimal import Decimal, InvalidOperation

from sfglab.spatial.poses import Pose, PoseError
from sfglab.spatial.trajectory.path import Interpolation, Trajectory, TrajectoryError

COLUMNS = ("time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
_NS_PER_S = 1_000_000_000


def csv_from_trajectory(trajectory: Trajectory) -> str:
    """Return a header line and a line for every waypoint."""
    lines = [",".join(COLUMNS)]
    for waypoint in trajectory.waypoints:
        sec, ns = divmod(waypoint.time_ns, _NS_PER_S)
        numbers = (*waypoint.pose.position_m, *waypoint.pose.quat_xyzw)
        lines.append(",".join([f"{sec}.{ns:09d}", *map(repr, numbers)]))
    return "\n".join(lines) + "\n"


def trajectory_from_csv(
    text: str, *, file: str = "trajectory.csv", interpolation: Interpolation = Interpolation.POLYLINE
) -> Trajectory:
    """Return the waypoints of a CSV text.

    Args:
        text: What stands in the file.
        file: Its name, for messages.
        interpolation: How to go from one to the next.

    Raises:
        TrajectoryError: The header is another, a field is no number, or times do not grow; says file and line.
    """
    rows = csv.reader(io.StringIO(text))
    header = next(rows, [])
    if tuple(header) != COLUMNS:
        raise TrajectoryError(f"{file}:1", ",".join(header) or "nothing", ",".join(COLUMNS))
    pairs: list[tuple[int, Pose]] = []
    for row in rows:
        if row:
            pairs.append(_pair(row, f"{file}:{rows.line_num}", after_ns=pairs[-1][0] if pairs else -1))
    if not pairs:
        raise TrajectoryError(file, "no waypoint", "at least one")
    return Trajectory.of(pairs, interpolation)


def _pair(row: list[str], place: str, *, after_ns: int) -> tuple[int, Pose]:
    if len(row) != len(COLUMNS):
        raise TrajectoryError(place, f"{len(row)} fields", f"{len(COLUMNS)}: {', '.join(COLUMNS)}")
    try:
        time_ns = int((Decimal(row[0]) * _NS_PER_S).to_integral_value())
        numbers = [float(field) for field in row[1:]]
    except (InvalidOperation, ValueError, OverflowError) as error:
        raise TrajectoryError(place, ",".join(row), "eight numbers") from error
    if time_ns <= after_ns:
        raise TrajectoryError(place, f"{row[0]} s", f"a time above {after_ns / _NS_PER_S} s")
    try:
        return time_ns, Pose.at(numbers[:3], numbers[3:], place=place)
    except PoseError as error:
        raise TrajectoryError(place, error.given, str(error)) from error
