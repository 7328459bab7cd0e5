"""Trajectories as CSV and as ROS messages, and back: nav_msgs/Path, trajectory_msgs/MultiDOFJointTrajectory.

All carry waypoints, to the nanosecond and bit by bit, and none says how to go from one to the next: whoever
reads chooses, and whoever writes for a reader that knows only polylines resamples first.
"""

from __future__ import annotations

import csv
import io
from decimal import Decimal, InvalidOperation
from typing import TYPE_CHECKING, Any

from sfglab.messages import message_type, ns_from_stamp
from sfglab.spatial.poses import Pose, PoseError, header_msg
from sfglab.spatial.trajectory.motion import sample
from sfglab.spatial.trajectory.path import Interpolation, Trajectory, TrajectoryError
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray


_MOST_S = 2**33  # what 64 bits of nanoseconds hold
COLUMNS = ("time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


def csv_from_trajectory(trajectory: Trajectory) -> str:
    """Return a header line and a line for every waypoint."""
    lines = [",".join(COLUMNS)]
    for waypoint in trajectory.waypoints:
        sec, ns = divmod(waypoint.time_ns, NS_PER_S)
        numbers = (*waypoint.pose.position_m, *waypoint.pose.quat_xyzw)
        lines.append(",".join([f"{sec}.{ns:09d}", *map(repr, numbers)]))
    return "\n".join(lines) + "\n"


def trajectory_from_csv(
    text: str,
    *,
    file: str = "trajectory.csv",
    interpolation: Interpolation = Interpolation.POLYLINE,
) -> Trajectory:
    """Return the waypoints of a CSV text, whose file's name is for messages.

    Raises:
        TrajectoryError: The header is another, a field is no number, or times do not grow; says file and line.
    """
    try:
        rows = csv.reader(io.StringIO(text, newline=None))
        header: list[str] = next(rows, [])
        if tuple(header) != COLUMNS:
            raise TrajectoryError(f"{file}:1", ",".join(header) or "nothing", ",".join(COLUMNS))
        pairs: list[tuple[int, Pose]] = []
        for row in rows:
            if row:
                pairs.append(
                    _pair(row, f"{file}:{rows.line_num}", after_ns=pairs[-1][0] if pairs else -1)
                )
        if not pairs:
            raise TrajectoryError(file, "no waypoint", "at least one")
        return Trajectory.of(pairs, interpolation)
    except csv.Error as error:
        raise TrajectoryError(file, str(error), "lines of numbers with commas between") from error


def _pair(row: list[str], place: str, *, after_ns: int) -> tuple[int, Pose]:
    if len(row) != len(COLUMNS):
        raise TrajectoryError(place, f"{len(row)} fields", f"{len(COLUMNS)}: {', '.join(COLUMNS)}")
    try:
        seconds = Decimal(row[0])
        is_time = -_MOST_S < seconds < _MOST_S  # of others, so many digits might be written out
        time_ns = int((seconds * NS_PER_S).to_integral_value()) if is_time else after_ns
        numbers = [float(field) for field in row[1:]]
    except (InvalidOperation, ValueError, OverflowError) as error:
        raise TrajectoryError(place, ",".join(row), "eight numbers") from error
    if time_ns <= after_ns:
        allowed = f"a time above {after_ns / NS_PER_S} s and below {_MOST_S} s"
        raise TrajectoryError(place, f"{row[0]} s", allowed)
    try:
        return time_ns, Pose.at(numbers[:3], numbers[3:], place=place)
    except PoseError as error:
        raise TrajectoryError(error.place, error.given, error.allowed) from error


def path_from_trajectory(trajectory: Trajectory, *, frame_id: str, start_ns: int = 0) -> Any:
    """Return a `nav_msgs/msg/Path`, a stamped pose for every waypoint; times count from `start_ns`, Unix time.

    Raises:
        MessageError: A time does not fit into a stamp.
    """
    stamped = message_type("geometry_msgs/msg/PoseStamped")
    poses = [
        stamped(header=header_msg(frame_id, start_ns + w.time_ns), pose=w.pose.to_pose_msg())
        for w in trajectory.waypoints
    ]
    return message_type("nav_msgs/msg/Path")(header=header_msg(frame_id, start_ns), poses=poses)


def trajectory_from_path(
    message: Any, *, interpolation: Interpolation = Interpolation.POLYLINE
) -> Trajectory:
    """Return the waypoints of a `nav_msgs/msg/Path`; the header's stamp is their time 0.

    Raises:
        TrajectoryError: There is no pose, or the stamps do not grow.
        PoseError: A pose is none.
    """
    zero_ns = ns_from_stamp(message.header.stamp)
    pairs = (
        (
            ns_from_stamp(p.header.stamp) - zero_ns,
            Pose.from_msg(p.pose, place=f"path, pose {index}"),
        )
        for index, p in enumerate(message.poses)
    )
    return Trajectory.of(pairs, interpolation)


def multi_dof_from_trajectory(
    trajectory: Trajectory, joint: str, *, frame_id: str, start_ns: int = 0
) -> Any:
    """Return a `trajectory_msgs/msg/MultiDOFJointTrajectory` of one joint, from `start_ns` (Unix time) on.

    Velocities are those of the segment that leaves a waypoint, at last of the one that arrives. Accelerations
    stay empty for polylines, whose corners have none.

    Raises:
        MessageError: A time does not fit into a stamp.
    """
    found = sample(trajectory, [w.time_ns / NS_PER_S for w in trajectory.waypoints])
    curved = trajectory.interpolation is Interpolation.CATMULL_ROM
    point = message_type("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint")
    points = [
        point(
            transforms=[w.pose.to_transform_msg()],
            velocities=[_twist(found.velocities_m_s[i], found.angular_rad_s[i])],
            accelerations=[_twist(found.accelerations_m_s2[i], 0.0 * found.angular_rad_s[i])]
            if curved
            else [],
            time_from_start=duration_msg(w.time_ns),
        )
        for i, w in enumerate(trajectory.waypoints)
    ]
    return message_type("trajectory_msgs/msg/MultiDOFJointTrajectory")(
        header=header_msg(frame_id, start_ns), joint_names=[joint], points=points
    )


def trajectory_from_multi_dof(
    message: Any, joint: str = "", *, interpolation: Interpolation = Interpolation.POLYLINE
) -> Trajectory:
    """Return the waypoints of one joint, else the first, of a `trajectory_msgs/msg/MultiDOFJointTrajectory`.

    Raises:
        TrajectoryError: It has no such joint, a point lacks its transform, or times do not grow.
        PoseError: A transform is no pose.
    """
    names = list(message.joint_names)
    if not names or (joint and joint not in names):
        raise TrajectoryError(
            "joint", repr(joint), f"one of {', '.join(names) or 'none, there are no joints'}"
        )
    column = names.index(joint) if joint else 0
    pairs = []
    for index, point in enumerate(message.points):
        place = f"point {index}"
        if len(point.transforms) != len(names):
            allowed = f"{len(names)}, one for each joint"
            raise TrajectoryError(place, f"{len(point.transforms)} transforms", allowed)
        pose = Pose.from_msg(point.transforms[column], place=place)
        pairs.append((ns_from_stamp(point.time_from_start), pose))
    return Trajectory.of(pairs, interpolation)


def duration_msg(time_ns: int) -> Any:
    """Return a `builtin_interfaces/msg/Duration`."""
    sec, nanosec = divmod(time_ns, NS_PER_S)
    return message_type("builtin_interfaces/msg/Duration")(sec=sec, nanosec=nanosec)


def _twist(linear: NDArray[Any], angular: NDArray[Any]) -> Any:
    vector = message_type("geometry_msgs/msg/Vector3")
    return message_type("geometry_msgs/msg/Twist")(
        linear=vector(*map(float, linear)), angular=vector(*map(float, angular))
    )
