"""Rigid motions, SE(3): the position and the orientation of one frame in another.

A pose reads as ``target_from_source``: it converts a point's coordinates from the source frame to the
target frame. It is also the pose of the source frame in the target frame, as in TF. Quaternions have the
order of ROS: x, y, z, w. The module is plain Python, because one product with SciPy takes several times
as long.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

from sfglab.errors import InvalidValueError
from sfglab.messages import message_type, ns_from_stamp, stamp_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterable

    import numpy as np
    from numpy.typing import NDArray
    from scipy.spatial.transform import Rotation


Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]

_SHORTEST = 1e-6  #: Length below which a quaternion has no reliable direction.
#: Largest deviation of a squared norm from 1 with which a quaternion stays as it is, so that a stored
#: pose is read back bit by bit.
_UNIT = 1e-12
_NEARLY_PARALLEL = 1.0 - 1e-9
_new, _set = object.__new__, object.__setattr__  # faster by their own names


class PoseError(InvalidValueError):
    """Values are no pose: not 3 and 4 finite numbers, or a quaternion of almost no length."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseKeys:
    """Keys of a pose in a file: position and orientation."""

    position_m: Vec3  #: Position along x, y and z, m.
    quat_xyzw: Quat = (0.0, 0.0, 0.0, 1.0)  #: Quaternion x, y, z, w of length 1.


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """A position and an orientation of a frame in another one, ``target_from_source``.

    Quaternions with another length than 1 are normalised. q and -q are the same orientation, see
    `same_as`.

    Raises:
        PoseError: A number is not finite, the quaternion is shorter than 1e-6, or the counts are not 3
            and 4.
    """

    position_m: Vec3 = (0.0, 0.0, 0.0)  #: Position x, y, z, m.
    quat_xyzw: Quat = (0.0, 0.0, 0.0, 1.0)  #: Unit quaternion x, y, z, w.

    def __post_init__(self) -> None:
        position, quat = _checked(self.position_m, self.quat_xyzw, "pose")
        object.__setattr__(self, "position_m", position)
        object.__setattr__(self, "quat_xyzw", quat)

    @staticmethod
    def at(
        position_m: Iterable[float] = (0.0, 0.0, 0.0),
        quat_xyzw: Iterable[float] = (0.0, 0.0, 0.0, 1.0),
        *,
        place: str = "pose",
    ) -> Pose:
        """Return a pose from x, y, z and a quaternion x, y, z, w. Errors name the place.

        Raises:
            PoseError: As for the class.
        """
        position, quat = _checked(position_m, quat_xyzw, place)
        return _pose(position, quat)

    @staticmethod
    def from_rotation(position_m: Iterable[float], rotation: Rotation) -> Pose:
        """Return a pose from a position and one SciPy rotation."""
        return Pose.at(position_m, rotation.as_quat())

    @staticmethod
    def from_yaw(position_m: Iterable[float], yaw_rad: float) -> Pose:
        """Return a pose that is rotated about z only, by an angle in radians."""
        return Pose.at(position_m, (0.0, 0.0, math.sin(yaw_rad / 2), math.cos(yaw_rad / 2)))

    @staticmethod
    def from_msg(message: Any, *, place: str = "pose") -> Pose:
        """Return the pose of a `geometry_msgs/msg/Pose` or `Transform`.

        Raises:
            PoseError: As for the class; also for a message that contains only zeros.
        """
        is_pose = hasattr(message, "position")
        p = message.position if is_pose else message.translation
        q = message.orientation if is_pose else message.rotation
        return Pose.at((p.x, p.y, p.z), (q.x, q.y, q.z, q.w), place=place)

    def __matmul__(self, other: Pose) -> Pose:
        """Return the product: ``a_from_c = a_from_b @ b_from_c``."""
        product = _product(self.quat_xyzw, other.quat_xyzw)
        return _pose(self.apply(other.position_m), _normalised(*product))

    def inverse(self) -> Pose:
        """Return the inverse pose: ``b_from_a`` for ``a_from_b``."""
        x, y, z, w = self.quat_xyzw
        back = (-x, -y, -z, w)
        px, py, pz = _rotated(back, self.position_m)
        return _pose((-px, -py, -pz), back)

    def apply(self, point_m: Vec3) -> Vec3:
        """Return a point's coordinates in the target frame, given those in the source frame."""
        x, y, z = _rotated(self.quat_xyzw, point_m)
        px, py, pz = self.position_m
        return (x + px, y + py, z + pz)

    def interpolate(self, other: Pose, fraction: float) -> Pose:
        """Return the pose at a fraction of the way to another: linear position, SLERP the short way.

        Below 0 and above 1 the motion continues at the same rates.

        Source:
            K. Shoemake: Animating rotation with quaternion curves, SIGGRAPH 1985.
        """
        (ax, ay, az), (bx, by, bz) = self.position_m, other.position_m
        position = (ax + fraction * (bx - ax), ay + fraction * (by - ay), az + fraction * (bz - az))
        return _pose(position, _slerp(self.quat_xyzw, other.quat_xyzw, fraction))

    def distance_m(self, other: Pose) -> float:
        """Return the distance between the two positions, m."""
        return math.dist(self.position_m, other.position_m)

    def angle_rad(self, other: Pose) -> float:
        """Return the angle of the rotation to the other orientation, radians, 0 to pi."""
        x, y, z, w = self.quat_xyzw
        x, y, z, w = _product((-x, -y, -z, w), other.quat_xyzw)
        return 2.0 * math.atan2(math.hypot(x, y, z), abs(w))

    def same_as(self, other: Pose, *, within_m: float = 1e-9, within_rad: float = 1e-9) -> bool:
        """Return whether both have the same position and orientation. Signs of quaternions do not count."""
        return self.distance_m(other) <= within_m and self.angle_rad(other) <= within_rad

    @property
    def yaw_rad(self) -> float:
        """Heading: angle of the rotated x axis in the x-y plane, radians, above -pi to pi."""
        x, y, z, w = self.quat_xyzw
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    def matrix(self) -> NDArray[np.float64]:
        """Return the homogeneous matrix ``target_from_source``, shape (4, 4), in metres."""
        import numpy as np
        from scipy.spatial.transform import Rotation

        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_quat(self.quat_xyzw).as_matrix()
        matrix[:3, 3] = self.position_m
        return matrix

    def to_pose_msg(self) -> Any:
        """Return the pose as a `geometry_msgs/msg/Pose`."""
        position = _type("Point")(*self.position_m)
        return _type("Pose")(position=position, orientation=_type("Quaternion")(*self.quat_xyzw))

    def to_transform_msg(self) -> Any:
        """Return the pose as a `geometry_msgs/msg/Transform`."""
        translation = _type("Vector3")(*self.position_m)
        rotation = _type("Quaternion")(*self.quat_xyzw)
        return _type("Transform")(translation=translation, rotation=rotation)


@dataclass(frozen=True, slots=True, kw_only=True)
class StampedTransform:
    """The pose of a child frame in its parent frame at a time."""

    parent: str  #: Parent frame (`header.frame_id`).
    child: str  #: Child frame (`child_frame_id`).
    stamp_ns: int  #: Time, in nanoseconds since the epoch.
    pose: Pose  #: Pose ``parent_from_child``.

    @classmethod
    def from_msg(cls, message: Any) -> Self:
        """Return the value of a `geometry_msgs/msg/TransformStamped`, without leading slashes, as tf2.

        Raises:
            PoseError: The numbers are no pose; the error names the frames.
        """
        parent = message.header.frame_id.removeprefix("/")
        child = message.child_frame_id.removeprefix("/")
        pose = Pose.from_msg(message.transform, place=f"transform {parent} -> {child}")
        stamp_ns = ns_from_stamp(message.header.stamp)
        return cls(parent=parent, child=child, stamp_ns=stamp_ns, pose=pose)

    def to_msg(self) -> Any:
        """Return the transform as a `geometry_msgs/msg/TransformStamped`."""
        return _type("TransformStamped")(
            header=header_msg(self.parent, self.stamp_ns),
            child_frame_id=self.child,
            transform=self.pose.to_transform_msg(),
        )


def header_msg(frame_id: str, stamp_ns: int) -> Any:
    """Return a `std_msgs/msg/Header` with a frame and a time, in nanoseconds since the epoch."""
    return message_type("std_msgs/msg/Header")(stamp=stamp_from_ns(stamp_ns), frame_id=frame_id)


@functools.cache  # without it, a transform takes 1.7 us instead of 0.7
def _type(name: str) -> type[Any]:
    return message_type(f"geometry_msgs/msg/{name}")


def _pose(position_m: Vec3, quat_xyzw: Quat) -> Pose:
    """Return a pose without checks, which is four times as fast."""
    pose = _new(Pose)
    _set(pose, "position_m", position_m)
    _set(pose, "quat_xyzw", quat_xyzw)
    return pose


def _checked(position: Iterable[float], quat: Iterable[float], place: str) -> tuple[Vec3, Quat]:
    try:
        px, py, pz = map(float, position)
        x, y, z, w = map(float, quat)
    except (TypeError, ValueError) as error:
        raise PoseError(
            place, [position, quat], "3 numbers as position, 4 as quaternion"
        ) from error
    if not math.isfinite(px + py + pz):
        raise PoseError(f"{place}, position", [px, py, pz], "3 finite numbers")
    norm = math.hypot(x, y, z, w)
    if not _SHORTEST <= norm < math.inf:
        allowed = f"a finite length of at least {_SHORTEST:g}, usually 1"
        raise PoseError(f"{place}, quaternion", [x, y, z, w], allowed)
    if abs(norm * norm - 1.0) > _UNIT:
        x, y, z, w = x / norm, y / norm, z / norm, w / norm
    return (px, py, pz), (x, y, z, w)


def _product(a: Quat, b: Quat) -> Quat:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _normalised(x: float, y: float, z: float, w: float) -> Quat:
    """Return a quaternion with length 1, so that long chains do not drift."""
    scale = 1.0 / math.sqrt(x * x + y * y + z * z + w * w)
    return (x * scale, y * scale, z * scale, w * scale)


def _rotated(q: Quat, v: Vec3) -> Vec3:
    """Return v rotated by q: v + 2 w (u x v) + 2 u x (u x v), with u the vector part."""
    x, y, z, w = q
    vx, vy, vz = v
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )


def _slerp(a: Quat, b: Quat, fraction: float) -> Quat:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    dot = ax * bx + ay * by + az * bz + aw * bw
    sign = -1.0 if dot < 0.0 else 1.0
    dot *= sign
    if dot > _NEARLY_PARALLEL:  # the sines vanish; the chord is as good as the arc
        wa, wb = 1.0 - fraction, sign * fraction
    else:
        angle = math.acos(dot)
        sine = math.sin(angle)
        wa = math.sin((1.0 - fraction) * angle) / sine
        wb = sign * math.sin(fraction * angle) / sine
    return _normalised(wa * ax + wb * bx, wa * ay + wb * by, wa * az + wb * bz, wa * aw + wb * bw)
