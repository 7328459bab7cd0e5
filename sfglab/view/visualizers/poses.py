"""Places and motions: transforms, poses, paths and odometry."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import InvalidValueError
from sfglab.messages import ns_from_stamp
from sfglab.qos import DEFAULT, LATCHED, QoSProfile
from sfglab.view.rerunning import rr
from sfglab.view.slot import RateBudget
from sfglab.view.visualizer import Canvas, Input, Parameter, Update, Visualizer

if TYPE_CHECKING:
    from numpy.typing import NDArray

_TF = "tf2_msgs/msg/TFMessage"
_MOST_FRAMES = 10_000
"""Limit of frames, so that a sender of ever new ones does not fill the memory."""

_AXES = np.array([(255, 60, 60), (60, 220, 60), (80, 120, 255)], np.uint8)
_AXIS_LENGTH = Parameter(
    "axis_length_m", 0.3, "length of the axes, m; 0 hides them", minimum=0, maximum=100.0
)
_WIDTH = Parameter("width_m", 0.01, "radius of a line, m", minimum=0.001, maximum=1.0)


def pose_arrays(pose: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return position (3,), m, and unit quaternion (x, y, z, w) of a ``geometry_msgs/msg/Pose``.

    All zeros, which a sender leaves that does not care, are no rotation. Raises InvalidValueError where a
    number is not finite.
    """
    position = np.array([pose.position.x, pose.position.y, pose.position.z])
    return position, _unit(pose.orientation, position)


def _unit(rotation: Any, position: NDArray[np.float64]) -> NDArray[np.float64]:
    quaternion = np.array([rotation.x, rotation.y, rotation.z, rotation.w])
    if not (np.isfinite(quaternion).all() and np.isfinite(position).all()):
        raise InvalidValueError(
            "pose", [*position.tolist(), *quaternion.tolist()], "finite numbers"
        )
    length = np.linalg.norm(quaternion)
    return quaternion / length if length > 0 else np.array([0.0, 0.0, 0.0, 1.0])


def _log_axes(canvas: Canvas, entity: str, pose: Any, length_m: float, width_m: float) -> None:
    """Draw a pose as three arrows; the columns of its rotation matrix are its axes."""
    from scipy.spatial.transform import Rotation

    position, quaternion = pose_arrays(pose)
    vectors = Rotation.from_quat(quaternion).as_matrix().T * length_m
    origins = np.tile(position, (3, 1))
    canvas.log(entity, rr.Arrows3D(vectors=vectors, origins=origins, colors=_AXES, radii=width_m))


class Transforms(Visualizer):
    """The moving part of the frame tree; every frame stands at ``/tf/<frame>`` and has its own rate budget."""

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
        """Place each frame in its parent, at the transform's own time."""
        for transform in update.only.transforms:
            stamp_ns = ns_from_stamp(transform.header.stamp) or update.stamp_ns
            if self._static or self._budget(transform.child_frame_id).allows(stamp_ns):
                canvas.at(stamp_ns=stamp_ns, received_ns=update.received_ns)
                self._log(transform, canvas)

    def _budget(self, frame: str) -> RateBudget:
        if frame not in self._budgets and len(self._budgets) >= _MOST_FRAMES:
            raise InvalidValueError("frame", frame, f"{_MOST_FRAMES} frames at most")
        budget = self._budgets.setdefault(frame, RateBudget(self["frame_hz"]))
        if budget.max_hz != self["frame_hz"]:
            budget.max_hz = self["frame_hz"]
        return budget

    def _log(self, transform: Any, canvas: Canvas) -> None:
        child, moved = transform.child_frame_id.strip("/"), transform.transform
        position = np.array([moved.translation.x, moved.translation.y, moved.translation.z])
        placed = rr.Transform3D(
            translation=position,
            quaternion=_unit(moved.rotation, position),
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
    """The fixed part of the frame tree."""

    name = "tf_static"
    inputs = (Input("tf", _TF, pattern="*/tf_static", qos=replace(LATCHED, depth=100)),)
    _static = True


class Pose(Visualizer):
    """A ``PoseStamped`` as its axes."""

    name = "pose"
    inputs = (Input("pose", "geometry_msgs/msg/PoseStamped", qos=DEFAULT),)
    parameters = (_AXIS_LENGTH, _WIDTH)

    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw the axes."""
        canvas.place(self.entity, update.only.header.frame_id)
        _log_axes(canvas, self.entity, update.only.pose, self["axis_length_m"], self["width_m"])


class Path(Visualizer):
    """A ``nav_msgs/msg/Path`` as a line."""

    name = "path"
    inputs = (Input("path", "nav_msgs/msg/Path", qos=DEFAULT),)
    max_hz = 10.0
    parameters = (_WIDTH,)

    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw the line."""
        points = [pose_arrays(stamped.pose)[0] for stamped in update.only.poses]
        canvas.place(self.entity, update.only.header.frame_id)
        strips = [np.array(points)] if points else []
        canvas.log(self.entity, rr.LineStrips3D(strips, radii=self["width_m"]))


class Odometry(Visualizer):
    """The pose of a ``nav_msgs/msg/Odometry`` as its axes."""

    name = "odometry"
    inputs = (Input("odometry", "nav_msgs/msg/Odometry", qos=DEFAULT),)
    parameters = (_AXIS_LENGTH, _WIDTH)

    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw the axes."""
        message = update.only
        canvas.place(self.entity, message.header.frame_id)
        pose = message.pose.pose
        _log_axes(canvas, self.entity, pose, self["axis_length_m"], self["width_m"])
