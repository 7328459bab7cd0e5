"""A small fleet that says, in real messages, everything that a visualizer of the list can show.

What a recording must hold is computed from the numbers that the messages are made of, and not by the view.
Refuses to know the view. Here are places and agents; `sensing` has what sensors say.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.visualisation.parts import Part, Place, Speaker
from sfglab.lab.experiments.visualisation.sensing import pictures, points, videos
from sfglab.messages import default_message, message_type, stamp_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from sfglab.lab.experiments.visualisation.moments import Moment

    Said = tuple[Speaker, str, str, Callable[[Moment], Any]]


_TF, _MARKER = "tf2_msgs/msg/TFMessage", "visualization_msgs/msg/Marker"
_MOUNT = np.array([0.25, 0.0, 0.125])
_SILENT_AFTER = 1  # the moment of pi1's only heartbeat: the view has to notice its end


def make_parts(moments: Sequence[Moment]) -> tuple[Part, ...]:
    """Return the scene: everything speaks at every moment, but for what is said once.

    Args:
        moments: What it looks like; pictures are shown at half the size.
    """
    small = [moment.halved() for moment in moments]
    return (*pictures(small), *videos(small), *points(small), *_space(small), *_fleet(small))


def _pose(place: NDArray[np.float64]) -> Any:
    pose = default_message("geometry_msgs/msg/Pose")
    pose.position.x, pose.position.y, pose.position.z = map(float, place)
    pose.orientation.w = 1.0
    return pose


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
    message = default_message("sensor_msgs/msg/Imu")
    message.header, turning = moment.header("go2/imu"), message.angular_velocity
    turning.x, turning.y, turning.z = map(float, moment.place)
    return message


def _transforms(moment: Moment, parent: str, child: str, place: NDArray[np.float64]) -> Any:
    found = default_message("geometry_msgs/msg/TransformStamped")
    found.header, found.child_frame_id = moment.header(parent), child
    moved = found.transform
    moved.translation.x, moved.translation.y, moved.translation.z = map(float, place)
    moved.rotation.w = 1.0
    return message_type(_TF)(transforms=[found])


def _moving(moment: Moment) -> Any:
    return _transforms(moment, "map", "go2/base", moment.place)


def _fixed(moment: Moment) -> Any:
    return None if moment.number else _transforms(moment, "go2/base", "go2/lidar", _MOUNT)


def _marker(moment: Moment) -> Any:
    marker = default_message(_MARKER)
    marker.header, marker.ns, marker.id, marker.type = moment.header("map"), "goal", 3, 1
    marker.pose = _pose(moment.place)
    marker.scale.x = marker.scale.y = marker.scale.z = 0.5
    marker.color.r = marker.color.a = 1.0
    return marker


def _markers(moment: Moment) -> Any:
    return message_type(f"{_MARKER}Array")(markers=[_marker(moment)])


def _place(moment: Moment) -> NDArray[np.float64]:
    return moment.place


def _axes(moment: Moment) -> NDArray[np.float64]:
    return np.tile(moment.place, 3)


def _said(kind: str, topic: str, type_: str, say: Callable[[Moment], Any]) -> Speaker:
    return Speaker(kind=kind, topic=topic, type=type_, say=say)


def _placed() -> Iterator[Said]:
    """Yield who says where something is, and where and what it is shown as."""
    root, localization = "/agents/go2", "/global/go2/localization"
    pose = _said("pose", f"{localization}/pose", "geometry_msgs/msg/PoseStamped", _stamped)
    yield pose, f"{root}/global/localization/pose", "Arrows3D:origins", _axes
    odometry = _said("odometry", f"{localization}/odometry", "nav_msgs/msg/Odometry", _odometry)
    yield odometry, f"{root}/global/localization/odometry/pose", "Arrows3D:origins", _axes
    path = _said("path", "/global/go2/planner/path", "nav_msgs/msg/Path", _path)
    yield path, f"{root}/global/planner/path", "LineStrips3D:strips", _line
    imu = _said("imu", "/local/go2/imu/imu", "sensor_msgs/msg/Imu", _imu)
    yield imu, f"{root}/local/imu/imu/angular_velocity", "Scalars:scalars", _place
    yield _said("tf", "/tf", _TF, _moving), "/tf/go2/base", "Transform3D:translation", _place
    yield _said("marker", "/goal", _MARKER, _marker), "/goal/goal/3", "Boxes3D:centers", _place
    markers = _said("marker_array", "/goals", f"{_MARKER}Array", _markers)
    yield markers, "/goals/goal/3", "Boxes3D:centers", _place


def _line(moment: Moment) -> NDArray[np.float64]:
    return np.concatenate([0 * moment.place, moment.place / 2, moment.place])


def _space(moments: Sequence[Moment]) -> Iterator[Part]:
    for speaker, entity, component, of in _placed():
        yield speaker.shown(moments, entity, component, of)
    place = Place(entity="/tf/go2/lidar", component="Transform3D:translation", is_timeless=True)
    static = _said("tf_static", "/tf_static", _TF, _fixed).part(moments)
    yield replace(static, place=place, expected=(_MOUNT,))


def _beat(moment: Moment) -> Any:
    beat = default_message("sfglab_interfaces/msg/AgentHeartbeat")
    beat.agent = "pi1" if moment.number == _SILENT_AFTER else "go2"
    beat.stamp, beat.period_s, beat.incarnation = stamp_from_ns(moment.stamp_ns), 0.2, 1
    beat.phase = beat.STEADY
    return beat


def _event(moment: Moment) -> Any:
    event = default_message("sfglab_interfaces/msg/AgentDiscoveryEvent")
    event.stamp, event.agent = stamp_from_ns(moment.stamp_ns), "go2"
    event.event = event.LOST if moment.number % 2 else event.DISCOVERED
    return event


def _told(moment: Moment) -> list[str]:
    return [f"go2 {'lost' if moment.number % 2 else 'discovered'}"]


def _fleet(moments: Sequence[Moment]) -> Iterator[Part]:
    messages = "sfglab_interfaces/msg"
    events = _said(
        "agent_status", "/local/ground/agent_discovery_event", f"{messages}/AgentDiscoveryEvent", _event
    )
    yield events.shown(moments, "/agents/go2/status/log", "TextLog:text", _told)
    yield _said("communication", "/global/agent_heartbeat", f"{messages}/AgentHeartbeat", _beat).part(moments)
