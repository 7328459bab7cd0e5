"""Trajectories as ROS messages: trajectory_msgs/MultiDOFJointTrajectory and back, and nav_msgs/Path.

Both have waypoints, to the nanosecond and bit by bit. Neither names an interpolation: readers assume
polylines, so splines are resampled before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.messages import message_type, ns_from_stamp
from sfglab.spatial.poses import Pose, header_msg
from sfglab.spatial.trajectory.motion import sample
from sfglab.spatial.trajectory.path import Interpolation, Trajectory, TrajectoryError
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray


def path_from_trajectory(trajectory: Trajectory, *, frame_id: str, start_ns: int = 0) -> Any:
    """Return a `nav_msgs/msg/Path` with a stamped pose per waypoint.

    Args:
        trajectory: The trajectory.
        frame_id: Frame of the poses.
        start_ns: Unix time of the trajectory's time 0, ns.

    Raises:
        MessageError: A time does not fit into a stamp.
    """
    stamped = message_type("geometry_msgs/msg/PoseStamped")
    poses = []
    for waypoint in trajectory.waypoints:
        header = header_msg(frame_id, start_ns + waypoint.time_ns)
        poses.append(stamped(header=header, pose=waypoint.pose.to_pose_msg()))
    return message_type("nav_msgs/msg/Path")(header=header_msg(frame_id, start_ns), poses=poses)


def multi_dof_from_trajectory(
    trajectory: Trajectory, joint: str, *, frame_id: str, start_ns: int = 0
) -> Any:
    """Return a `trajectory_msgs/msg/MultiDOFJointTrajectory` of one joint.

    Velocities are those of the segment that leaves a waypoint; at the last, of the segment that arrives.
    Accelerations are empty.

    Args:
        trajectory: The trajectory.
        joint: Name of the joint.
        frame_id: Frame of the poses.
        start_ns: Unix time of the trajectory's time 0, ns.

    Raises:
        MessageError: A time does not fit into a stamp.
    """
    found = sample(trajectory, [w.time_ns / NS_PER_S for w in trajectory.waypoints])
    point = message_type("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint")
    points = []
    for index, waypoint in enumerate(trajectory.waypoints):
        velocity = _twist(found.velocities_m_s[index], found.angular_rad_s[index])
        points.append(
            point(
                transforms=[waypoint.pose.to_transform_msg()],
                velocities=[velocity],
                accelerations=[],
                time_from_start=duration_msg(waypoint.time_ns),
            )
        )
    return message_type("trajectory_msgs/msg/MultiDOFJointTrajectory")(
        header=header_msg(frame_id, start_ns), joint_names=[joint], points=points
    )


def trajectory_from_multi_dof(
    message: Any, joint: str = "", *, interpolation: Interpolation = Interpolation.POLYLINE
) -> Trajectory:
    """Return the waypoints of a joint in a `trajectory_msgs/msg/MultiDOFJointTrajectory`; empty: the first.

    Raises:
        TrajectoryError: It has no such joint, a point lacks its transform, or times do not grow.
        PoseError: A transform is no pose.
    """
    names = list(message.joint_names)
    if not names or (joint and joint not in names):
        allowed = f"one of {', '.join(names) or 'none, there are no joints'}"
        raise TrajectoryError("joint", repr(joint), allowed)
    column = names.index(joint) if joint else 0
    timed = []
    for index, point in enumerate(message.points):
        place = f"point {index}"
        if len(point.transforms) != len(names):
            allowed = f"{len(names)}, one for each joint"
            raise TrajectoryError(place, f"{len(point.transforms)} transforms", allowed)
        pose = Pose.from_msg(point.transforms[column], place=place)
        timed.append((ns_from_stamp(point.time_from_start), pose))
    return Trajectory.of(timed, interpolation)


def duration_msg(time_ns: int) -> Any:
    """Return a `builtin_interfaces/msg/Duration`."""
    sec, nanosec = divmod(time_ns, NS_PER_S)
    return message_type("builtin_interfaces/msg/Duration")(sec=sec, nanosec=nanosec)


def _twist(linear: NDArray[Any], angular: NDArray[Any]) -> Any:
    vector = message_type("geometry_msgs/msg/Vector3")
    return message_type("geometry_msgs/msg/Twist")(
        linear=vector(*map(float, linear)), angular=vector(*map(float, angular))
    )
