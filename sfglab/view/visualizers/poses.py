"""Visualizers of transforms, poses, paths and odometry."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from sfglab.errors import InvalidValueError
from sfglab.messages import ns_from_stamp
from sfglab.qos import DEFAULT, LATCHED, QoSProfile
from sfglab.spatial.poses import Pose
from sfglab.view.rerunning import rr
from sfglab.view.slot import RateBudget
from sfglab.view.visualizer import Canvas, Input, Parameter, Update, Visualizer

_TF = "tf2_msgs/msg/TFMessage"
_MOST_FRAMES = 10_000
"""Largest number of frames, so that a sender of ever new names does not fill the memory."""

_AXES = [(255, 60, 60), (60, 220, 60), (80, 120, 255)]
_AXIS_LENGTH = Parameter(
    "axis_length_m", 0.3, "length of the axes, m; 0 hides them", minimum=0, maximum=100.0
)
_WIDTH = Parameter("width_m", 0.01, "radius of a line, m", minimum=0.001, maximum=1.0)


def pose_of(message: Any) -> Pose:
    """Return the pose of a ``geometry_msgs/msg/Pose`` or ``Transform``.

    A quaternion of zeros, which nodes without an orientation send, means no rotation.

    Raises:
        PoseError: A number is not finite.
    """
    is_pose = hasattr(message, "position")
    p = message.position if is_pose else message.translation
    q = message.orientation if is_pose else message.rotation
    rotation = (q.x, q.y, q.z, q.w)
    return Pose.at((p.x, p.y, p.z), rotation if any(rotation) else (0.0, 0.0, 0.0, 1.0))


class Transforms(Visualizer):
    """Transforms of /tf; each frame has an entity ``/tf/<frame>`` and its own rate budget."""

    name = "tf"
    inputs = (Input("tf", _TF, pattern="*/tf", qos=QoSProfile(depth=100)),)
    max_hz = None
    queue = 200
    parameters = (
        _AXIS_LENGTH,
        Parameter("frame_hz", 50.0, "rate of one frame at most, Hz", minimum=0.1, maximum=1000.0),
    )
    _static = False

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._budgets: dict[str, RateBudget] = {}
        self._axes: dict[str, float] = {}

    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw each frame in its parent, at the time of its transform."""
        for transform in update.only.transforms:
            stamp_ns = ns_from_stamp(transform.header.stamp) or update.stamp_ns
            if self._static or self._is_due(transform.child_frame_id, stamp_ns):
                canvas.at(stamp_ns=stamp_ns, received_ns=update.received_ns)
                self._log(transform, canvas)

    def _is_due(self, frame: str, stamp_ns: int) -> bool:
        if frame not in self._budgets and len(self._budgets) >= _MOST_FRAMES:
            raise InvalidValueError("frame", frame, f"{_MOST_FRAMES} frames at most")
        budget = self._budgets.setdefault(frame, RateBudget())
        return budget.allows(stamp_ns, self["frame_hz"])

    def _log(self, transform: Any, canvas: Canvas) -> None:
        child, pose = transform.child_frame_id.strip("/"), pose_of(transform.transform)
        placed = rr.Transform3D(
            translation=pose.position_m,
            quaternion=pose.quat_xyzw,
            parent_frame=transform.header.frame_id.strip("/"),
            child_frame=child,
        )
        entity = f"/tf/{child}"
        canvas.place(entity, child)
        canvas.log(entity, placed, static=self._static)
        if self["axis_length_m"] != self._axes.get(child, 0.0):
            self._axes[child] = self["axis_length_m"]
            canvas.log(entity, rr.TransformAxes3D(self["axis_length_m"]), static=True)


class StaticTransforms(Transforms):
    """Static transforms of /tf_static."""

    name = "tf_static"
    inputs = (Input("tf", _TF, pattern="*/tf_static", qos=replace(LATCHED, depth=100)),)
    _static = True


class _Axes(Visualizer):
    """Base class: a pose in the frame of its message's header, drawn as three axes."""

    parameters = (_AXIS_LENGTH, _WIDTH)

    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw the axes, which are the columns of the rotation matrix."""
        matrix = pose_of(self._pose(update.only)).matrix()
        axes = rr.Arrows3D(
            vectors=matrix[:3, :3].T * self["axis_length_m"],
            origins=[matrix[:3, 3]] * 3,
            colors=_AXES,
            radii=self["width_m"],
        )
        canvas.place(self.entity, update.only.header.frame_id)
        canvas.log(self.entity, axes)

    def _pose(self, message: Any) -> Any:
        return message.pose


class PoseStamped(_Axes):
    """A ``geometry_msgs/msg/PoseStamped``, drawn as three axes."""

    name = "pose"
    inputs = (Input("pose", "geometry_msgs/msg/PoseStamped", qos=DEFAULT),)


class Odometry(_Axes):
    """The pose of a ``nav_msgs/msg/Odometry``, drawn as three axes."""

    name = "odometry"
    inputs = (Input("odometry", "nav_msgs/msg/Odometry", qos=DEFAULT),)

    def _pose(self, message: Any) -> Any:
        return message.pose.pose


class Path(Visualizer):
    """A ``nav_msgs/msg/Path``, drawn as a line."""

    name = "path"
    inputs = (Input("path", "nav_msgs/msg/Path", qos=DEFAULT),)
    max_hz = 10.0
    parameters = (_WIDTH,)

    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw the line."""
        points = [pose_of(stamped.pose).position_m for stamped in update.only.poses]
        canvas.place(self.entity, update.only.header.frame_id)
        canvas.log(self.entity, rr.LineStrips3D([points] if points else [], radii=self["width_m"]))
