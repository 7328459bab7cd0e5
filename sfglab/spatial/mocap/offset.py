"""Where a robot's base is in its tracked object's frame, from a recorded motion, and how well that is known.

The cameras say where the object is in the world, A_i; the robot says where its base is in its odometry, B_i.
With X the base in the object's frame and Z the odometry in the world, ``A_i X = Z B_i`` at all times: the
robot-world and hand-eye problem. Shah's closed form begins, least squares end, in which both kinds of residual
weigh by what they turn out to be; the normal matrix then is the inverse covariance.

Takes the odometry for free of drift over the recording, so record seconds, not minutes. Errors of the object's
orientation enter the position through the lever arm and are counted as errors of position.

Source: M. Shah: Solving the robot-world/hand-eye calibration problem using the Kronecker product, ASME J.
Mechanisms and Robotics 5(3), 2013.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.spatial.frames import FrameError
from sfglab.spatial.mocap.capture import Capture, MocapError
from sfglab.spatial.poses import Pose, Vec3

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray
    from scipy.spatial.transform import Rotation

    from sfglab.spatial.frames import FrameBuffer

__all__ = ["OffsetError", "OffsetEstimate", "PosePair", "estimate_offset", "pose_pairs"]

_FEWEST = 6
_UNSEEN = 1e-7
_ALONE = 0.999
_ROUNDS = 3
_SURE_M = 1e-5
_STEPS = 60
_SETTLED = 1e-10
Weights = tuple[float, float]
_EQUAL: Weights = (100.0, 100.0)
_SIDES = ("world_from_object", "odom_from_base")


class OffsetError(MocapError, ValueError):
    """A recording from which the offset cannot be found."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PosePair:
    """The same moment seen by both.

    Attributes:
        world_from_object: What the cameras say.
        odom_from_base: What the robot says.
    """

    world_from_object: Pose
    odom_from_base: Pose


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetEstimate:
    """The offset and its uncertainty.

    Attributes:
        object_from_base: The base in the object's frame, X.
        world_from_odom: The odometry in the world, Z.
        covariance: Of X: turn about the base's x, y, z (rad), then position in the object's frame (m); 6 x 6.
        residual_m: Standard deviation of the position that remains unexplained, per axis.
        residual_rad: The same of the orientation.
        pairs: How many moments were used.
    """

    object_from_base: Pose
    world_from_odom: Pose
    covariance: tuple[tuple[float, ...], ...]
    residual_m: float
    residual_rad: float
    pairs: int

    @property
    def sigma_rad(self) -> Vec3:
        """Standard deviations of the turn about the base's x, y and z."""
        return self._sigmas(0)

    @property
    def sigma_m(self) -> Vec3:
        """Standard deviations of the position along the object's x, y and z."""
        return self._sigmas(3)

    def _sigmas(self, first: int) -> Vec3:
        a, b, c = (self.covariance[i][i] ** 0.5 for i in range(first, first + 3))
        return (a, b, c)


def pose_pairs(
    captures: Iterable[Capture], object_id: str, buffer: FrameBuffer, *, odom: str, base: str
) -> list[PosePair]:
    """Return what cameras and robot say at the same moments; captures without either are left out.

    Args:
        captures: A recording, of an object that is seen soundly.
        object_id: The object.
        buffer: The robot's transforms over the same time.
        odom: The frame of its odometry.
        base: The frame that is looked for.
    """
    pairs = []
    for capture in captures:
        sight = capture.sights.get(object_id)
        if not isinstance(sight, Pose):
            continue
        try:
            odom_from_base = buffer.look_up(odom, base, capture.capture_ns)
        except FrameError:
            continue
        pairs.append(PosePair(world_from_object=sight, odom_from_base=odom_from_base))
    return pairs


def estimate_offset(pairs: Sequence[PosePair], *, height_m: float | None = None) -> OffsetEstimate:
    """Estimate where a base is in its tracked object's frame.

    Args:
        pairs: At least 6 moments of a motion that turns about two axes at least.
        height_m: The base's z in the object's frame, measured by hand, for robots that turn about z only:
            their motion does not show it.

    Returns:
        The estimate; 1.96 of its standard deviations hold the truth in 95 % of recordings.

    Raises:
        OffsetError: Too few moments, or a motion that leaves something open; says what.
    """
    if len(pairs) < _FEWEST:
        raise OffsetError(f"offset: given {len(pairs)} moments, allowed are {_FEWEST} or more")
    problem = _Problem(pairs, height_m)
    x, z = min((problem.improved(*start, _EQUAL) for start in _starts(pairs)), key=problem.cost)
    for _ in range(_ROUNDS):
        weights = problem.weights(x, z)
        x, z = problem.improved(x, z, weights)
    jacobian = problem.jacobian(x, z, weights)
    _check_seen(jacobian, height_m)
    covariance = np.linalg.inv(jacobian.T @ jacobian)[:6, :6]
    return OffsetEstimate(
        object_from_base=x,
        world_from_odom=z,
        covariance=tuple(tuple(row) for row in covariance.tolist()),
        residual_rad=1.0 / weights[0],
        residual_m=1.0 / weights[1],
        pairs=len(pairs),
    )


class _Problem:
    """The residuals of ``B^-1 Z^-1 A X``, which is the identity without errors, and how they change.

    The unknowns are small: a turn of X about its own axes and a shift, then the same of Z.
    """

    def __init__(self, pairs: Sequence[PosePair], height_m: float | None) -> None:
        self._a, self._b = (_stacked([getattr(p, side) for p in pairs]) for side in _SIDES)
        self._height_m = height_m

    def improved(self, x: Pose, z: Pose, weights: Weights) -> tuple[Pose, Pose]:
        """Return X and Z where the weighted squares are least, by Gauss and Newton's steps.

        Raises:
            OffsetError: They do not settle.
        """
        from scipy.spatial.transform import Rotation

        for _ in range(_STEPS):
            step = -np.linalg.lstsq(self.jacobian(x, z, weights), self._weighted(x, z, weights))[0]
            x, z = (
                Pose.from_rotation(
                    np.add(pose.position_m, part[3:]), pose.rotation * Rotation.from_rotvec(part[:3])
                )
                for pose, part in ((x, step[:6]), (z, step[6:]))
            )
            if np.linalg.norm(step) < _SETTLED:
                return x, z
        raise OffsetError("offset: the estimate does not settle; the pairs are not of one rigid motion")

    def cost(self, found: tuple[Pose, Pose]) -> float:
        """Return the sum of squares that remains, all moments equal."""
        return float(np.sum(self._weighted(*found, _EQUAL) ** 2))

    def weights(self, x: Pose, z: Pose) -> Weights:
        """Return 1 over the deviations of turns (rad) and shifts (m)."""
        turns, shifts = self._residuals(x, z)
        share = 2 * turns.size / (2 * turns.size - 12)
        turn, shift = (max(float(np.sqrt(np.mean(kind**2) * share)), 1e-9) for kind in (turns, shifts))
        return 1.0 / turn, 1.0 / shift

    def jacobian(self, x: Pose, z: Pose, weights: Weights) -> NDArray[np.float64]:
        """Return how the weighted residuals change, to first order in residuals that are turns."""
        (ra, ta), (rb, _) = self._a, self._b
        count = len(ta)
        back = (rb.inv() * z.rotation.inv()).as_matrix()
        arms = z.rotation.inv().apply(ra.apply(x.position_m) + ta - z.position_m)
        turns, shifts = np.zeros((count, 3, 12)), np.zeros((count, 3, 12))
        turns[:, :, 0:3] = np.eye(3)
        turns[:, :, 6:9] = -rb.inv().as_matrix()
        shifts[:, :, 3:6] = back @ ra.as_matrix()
        shifts[:, :, 6:9] = rb.inv().as_matrix() @ _crosses(arms)
        shifts[:, :, 9:12] = -back
        parts = [turns.reshape(-1, 12) * weights[0], shifts.reshape(-1, 12) * weights[1]]
        if self._height_m is not None:
            parts.append(np.eye(12)[5:6] / _SURE_M)
        return np.concatenate(parts)

    def _residuals(self, x: Pose, z: Pose) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        (ra, ta), (rb, tb) = self._a, self._b
        back = z.rotation.inv()
        turns = (rb.inv() * back * ra * x.rotation).as_rotvec()
        shifts = rb.inv().apply(back.apply(ra.apply(x.position_m) + ta - z.position_m) - tb)
        return turns, shifts

    def _weighted(self, x: Pose, z: Pose, weights: Weights) -> NDArray[np.float64]:
        turns, shifts = self._residuals(x, z)
        parts = [turns.ravel() * weights[0], shifts.ravel() * weights[1]]
        if self._height_m is not None:
            parts.append(np.array([(x.position_m[2] - self._height_m) / _SURE_M]))
        return np.concatenate(parts)


def _crosses(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrices of ``v x``, shape (n, 3, 3)."""
    return np.cross(vectors[:, None, :], np.eye(3)[None]).transpose(0, 2, 1)


def _stacked(poses: Sequence[Pose]) -> tuple[Rotation, NDArray[np.float64]]:
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat([p.quat_xyzw for p in poses]), np.array([p.position_m for p in poses])


def _starts(pairs: Sequence[PosePair]) -> list[tuple[Pose, Pose]]:
    """Return guesses of X and Z: Shah's closed form, or four headings where the motion turns about one axis.

    ``R_Z = R_A R_X R_B^T`` means ``vec R_Z = (R_B kron R_A) vec R_X`` for all pairs: both are the leading
    singular vectors of the mean, whose singular value is alone near 1 when the turns have two axes.
    """
    from scipy.spatial.transform import Rotation

    (ra, _), (rb, _) = (_stacked([getattr(p, side) for p in pairs]) for side in _SIDES)
    mean = np.mean([np.kron(b, a) for a, b in zip(ra.as_matrix(), rb.as_matrix(), strict=True)], axis=0)
    _, values, right = np.linalg.svd(mean)
    if values[1] < _ALONE * values[0]:
        turn = right[0].reshape(3, 3, order="F")
        u, _, v = np.linalg.svd(turn * np.sign(np.linalg.det(turn)))
        guesses = [Rotation.from_matrix(u @ v)]
    else:
        guesses = [Rotation.from_euler("z", heading) for heading in np.arange(4) * np.pi / 2]
    return [_with_shifts(pairs, rx) for rx in guesses]


def _with_shifts(pairs: Sequence[PosePair], rx: Rotation) -> tuple[Pose, Pose]:
    """Return X and Z for a turn of X: the mean turn of Z, and shifts by linear least squares."""
    (ra, ta), (rb, tb) = (_stacked([getattr(p, side) for p in pairs]) for side in _SIDES)
    rz = (ra * rx * rb.inv()).mean()
    # R_A t_X - t_Z = R_Z t_B - t_A
    left = np.concatenate([np.hstack([m, -np.eye(3)]) for m in ra.as_matrix()])
    shifts = np.linalg.lstsq(left, (rz.apply(tb) - ta).ravel())[0]
    return Pose.from_rotation(shifts[:3], rx), Pose.from_rotation(shifts[3:], rz)


def _check_seen(jacobian: NDArray[np.float64], height_m: float | None) -> None:
    """Refuse a motion that leaves a direction of the unknowns open."""
    scaled = jacobian / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-12)
    _, values, directions = np.linalg.svd(scaled, full_matrices=False)
    if values[-1] > _UNSEEN * values[0]:
        return
    names = ("turn about x", "turn about y", "turn about z", "x", "y", "z")
    open_ = [name for name, share in zip(names, np.abs(directions[-1][:6]), strict=True) if share > 0.1]
    hint = "; give height_m if the robot turns about z only" if height_m is None else ""
    raise OffsetError(
        f"offset: the motion leaves {', '.join(open_) or 'the odometry'} of the base in the object's frame "
        f"open; record one that turns about two axes at least{hint}"
    )
