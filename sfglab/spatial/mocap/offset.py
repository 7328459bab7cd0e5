"""Where a robot's base is in its tracked object's frame, from a recorded motion, and how well that is known.

The cameras say where the object is in the world, A_i; the robot says where its base is in its odometry, B_i.
With X the base in the object's frame and Z the odometry in the world, ``A_i X = Z B_i`` at all times: the
robot-world and hand-eye problem. Shah's closed form begins, least squares end, in which both kinds of residual
weigh by what they turn out to be; the normal matrix then is the inverse covariance.

Odometry drifts. Where the pairs have times, Z may walk and turn at a constant rate, which is estimated with the
rest; what drifts otherwise is not seen, so record seconds, not minutes. Errors of the object's orientation
enter the position through the lever arm and are counted as errors of position.

Source: M. Shah: Solving the robot-world/hand-eye calibration problem using the Kronecker product, ASME J.
Mechanisms and Robotics 5(3), 2013.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.spatial.frames import FrameError
from sfglab.spatial.mocap.hand_eye import EQUAL, OffsetError, PosePair, Problem, starts
from sfglab.spatial.poses import Pose, Vec3

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from sfglab.spatial.frames import FrameBuffer
    from sfglab.spatial.mocap.capture import Capture


_FEWEST = 6
_UNSEEN = 1e-7
_ROUNDS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetEstimate:
    """The offset and its uncertainty."""

    object_from_base: Pose  #: The base in the object's frame, X.
    world_from_odom: Pose  #: The odometry in the world, Z; in the middle of the recording if it drifts.
    #: Of X: turn about the base's x, y, z (rad), then position in the object's frame (m); 6 x 6.
    covariance: tuple[tuple[float, ...], ...]
    residual_m: float  #: Standard deviation of the position that remains unexplained, per axis.
    residual_rad: float  #: The same of the orientation.
    pairs: int  #: How many moments were used.
    drift_m_s: float = 0.0  #: How fast the odometry walks in the world.
    drift_rad_s: float = 0.0  #: How fast it turns.

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
        pairs.append(
            PosePair(world_from_object=sight, odom_from_base=odom_from_base, time_ns=capture.capture_ns)
        )
    return pairs


def estimate_offset(
    pairs: Sequence[PosePair], *, height_m: float | None = None, drift: bool = True
) -> OffsetEstimate:
    """Estimate where a base is in its tracked object's frame.

    Args:
        pairs: At least 6 moments of a motion that turns about two axes at least.
        height_m: The base's z in the object's frame, measured by hand, for robots that turn about z only:
            their motion does not show it.
        drift: Whether the odometry may drift at a constant rate, if the pairs have times.

    Returns:
        The estimate; 1.96 of its standard deviations hold the truth in 95 % of recordings.

    Raises:
        OffsetError: Too few moments, or a motion that leaves something open; says what.
    """
    if len(pairs) < _FEWEST:
        raise OffsetError(f"offset: given {len(pairs)} moments, allowed are {_FEWEST} or more")
    problem = Problem(pairs, height_m, drift=drift)
    found = min((problem.improved(start, EQUAL) for start in starts(pairs)), key=problem.cost)
    for _ in range(_ROUNDS):
        weights = problem.weights(found)
        found = problem.improved(found, weights)
    jacobian = problem.jacobian(found, weights)
    _check_seen(jacobian, height_m)
    covariance = np.linalg.inv(jacobian.T @ jacobian)[:6, :6]
    half_s = problem.half_s or 1.0
    return OffsetEstimate(
        object_from_base=found.x,
        world_from_odom=found.z,
        covariance=tuple(tuple(row) for row in covariance.tolist()),
        residual_rad=1.0 / weights[0],
        residual_m=1.0 / weights[1],
        pairs=len(pairs),
        drift_m_s=float(np.linalg.norm(found.walk_m)) / half_s,
        drift_rad_s=float(np.linalg.norm(found.turn_rad)) / half_s,
    )


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
