"""The place of a robot's base in its tracked object's frame, from a recorded motion, with its uncertainty.

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
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from sfglab.spatial.frames.buffer import FrameBuffer, FrameError
from sfglab.spatial.mocap.tracking import Capture, MocapError
from sfglab.spatial.poses import Pose, Vec3
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray
    from scipy.spatial.transform import Rotation


_ALONE = 0.999
_SURE_M = 1e-5
_STEPS = 60
_SETTLED = 1e-8
Weights = tuple[float, float]
EQUAL: Weights = (100.0, 100.0)
_SIDES = ("world_from_object", "odom_from_base")


@dataclass(frozen=True, slots=True, kw_only=True)
class PosePair:
    """The same moment seen by both."""

    world_from_object: Pose  #: What the cameras say.
    odom_from_base: Pose  #: What the robot says.
    time_ns: int = 0  #: When; where all pairs have the same time, nothing can drift.


class Guess(NamedTuple):
    """The unknowns; how far the odometry drifts from the middle of the recording to its end, in the world."""

    x: Pose
    z: Pose
    turn_rad: NDArray[np.float64]
    walk_m: NDArray[np.float64]


class Problem:
    """The residuals of ``B^-1 Z^-1 A X``, which is the identity without errors, and how they change.

    Unknowns: a turn of X about its axes and a shift, the same of Z, then what Z does until the recording's end.
    """

    def __init__(self, pairs: Sequence[PosePair], height_m: float | None, *, drift: bool) -> None:
        self._a, self._b = (_stacked([getattr(p, side) for p in pairs]) for side in _SIDES)
        self._height_m = height_m
        times = np.array([p.time_ns for p in pairs], dtype=np.int64)
        ages_s = (times - times.min()) / NS_PER_S
        #: From the middle of the recording to its end; 0 where nothing may drift.
        self.half_s = float(ages_s.max()) / 2 if drift else 0.0
        self._moments = ages_s / self.half_s - 1.0 if self.half_s else np.zeros(len(pairs))
        self._unknowns = 18 if self.half_s else 12

    def improved(self, guess: Guess, weights: Weights) -> Guess:
        """Return what makes weighted squares least, by Gauss-Newton; MocapError where that does not settle."""
        for _ in range(_STEPS):
            step = np.zeros(18)
            least = np.linalg.lstsq(self.jacobian(guess, weights), self._weighted(guess, weights))[
                0
            ]
            step[: self._unknowns] = -least
            guess = Guess(
                _moved(guess.x, step[:6]),
                _moved(guess.z, step[6:12]),
                guess.turn_rad + step[12:15],
                guess.walk_m + step[15:],
            )
            if np.linalg.norm(step) < _SETTLED:
                return guess
        raise MocapError(
            "offset: the estimate does not settle; the pairs are not of one rigid motion"
        )

    def cost(self, guess: Guess) -> float:
        """Return the sum of squares that remains, all moments equal."""
        return float(np.sum(self._weighted(guess, EQUAL) ** 2))

    def weights(self, guess: Guess) -> Weights:
        """Return 1 over the deviations of turns (rad) and shifts (m)."""
        turns, shifts = self._residuals(guess)
        share = 2 * turns.size / max(1, 2 * turns.size - self._unknowns)
        turn, shift = (
            max(float(np.sqrt(np.mean(kind**2) * share)), 1e-9) for kind in (turns, shifts)
        )
        return 1.0 / turn, 1.0 / shift

    def jacobian(self, guess: Guess, weights: Weights) -> NDArray[np.float64]:
        """Return how the weighted residuals change, to first order in residuals and drifts that are turns."""
        (ra, ta), (rb, _) = self._a, self._b
        turned, rz, tz = self._drifted(guess)
        count, moments = len(ta), self._moments[:, None, None]
        back = (rb.inv() * rz.inv()).as_matrix()
        arms = rz.inv().apply(ra.apply(guess.x.position_m) + ta - tz)
        turns, shifts = np.zeros((count, 3, 18)), np.zeros((count, 3, 18))
        by_turn = np.stack([-rb.inv().as_matrix(), rb.inv().as_matrix() @ _crosses(arms)])
        turns[:, :, 0:3] = np.eye(3)
        shifts[:, :, 3:6] = back @ ra.as_matrix()
        turns[:, :, 6:9], shifts[:, :, 6:9] = by_turn @ turned.inv().as_matrix()
        turns[:, :, 12:15], shifts[:, :, 12:15] = by_turn * moments
        shifts[:, :, 9:12], shifts[:, :, 15:18] = -back, -back * moments
        parts = [turns.reshape(-1, 18) * weights[0], shifts.reshape(-1, 18) * weights[1]]
        if self._height_m is not None:
            parts.append(np.eye(18)[5:6] / _SURE_M)
        return np.concatenate(parts)[:, : self._unknowns]

    def _drifted(self, guess: Guess) -> tuple[Rotation, Rotation, NDArray[np.float64]]:
        """Return by how much Z is turned at every moment, and Z's turn and shift then."""
        from scipy.spatial.transform import Rotation

        turned = Rotation.from_rotvec(self._moments[:, None] * guess.turn_rad)
        shift = np.asarray(guess.z.position_m) + self._moments[:, None] * guess.walk_m
        return turned, guess.z.rotation * turned, shift

    def _residuals(self, guess: Guess) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        (ra, ta), (rb, tb) = self._a, self._b
        _, rz, tz = self._drifted(guess)
        turns = (rb.inv() * rz.inv() * ra * guess.x.rotation).as_rotvec()
        shifts = rb.inv().apply(rz.inv().apply(ra.apply(guess.x.position_m) + ta - tz) - tb)
        return turns, shifts

    def _weighted(self, guess: Guess, weights: Weights) -> NDArray[np.float64]:
        turns, shifts = self._residuals(guess)
        parts = [turns.ravel() * weights[0], shifts.ravel() * weights[1]]
        if self._height_m is not None:
            parts.append(np.array([(guess.x.position_m[2] - self._height_m) / _SURE_M]))
        return np.concatenate(parts)


def _moved(pose: Pose, step: NDArray[np.float64]) -> Pose:
    from scipy.spatial.transform import Rotation

    return Pose.from_rotation(
        np.add(pose.position_m, step[3:]), pose.rotation * Rotation.from_rotvec(step[:3])
    )


def _crosses(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrices of ``v x``, shape (n, 3, 3)."""
    return np.cross(vectors[:, None, :], np.eye(3)[None]).transpose(0, 2, 1)


def _stacked(poses: Sequence[Pose]) -> tuple[Rotation, NDArray[np.float64]]:
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat([p.quat_xyzw for p in poses]), np.array([p.position_m for p in poses])


def starts(pairs: Sequence[PosePair]) -> list[Guess]:
    """Return guesses of X and Z: Shah's closed form, or four headings where the motion turns about one axis.

    ``R_Z = R_A R_X R_B^T`` means ``vec R_Z = (R_B kron R_A) vec R_X`` for all pairs: both are the leading
    singular vectors of the mean, whose singular value is alone near 1 when the turns have two axes.
    """
    from scipy.spatial.transform import Rotation

    (ra, _), (rb, _) = (_stacked([getattr(p, side) for p in pairs]) for side in _SIDES)
    mean = np.mean(
        [np.kron(b, a) for a, b in zip(ra.as_matrix(), rb.as_matrix(), strict=True)], axis=0
    )
    _, values, right = np.linalg.svd(mean)
    if values[1] < _ALONE * values[0]:
        turn = right[0].reshape(3, 3, order="F")
        u, _, v = np.linalg.svd(turn * np.sign(np.linalg.det(turn)))
        guesses = [Rotation.from_matrix(u @ v)]
    else:
        guesses = [Rotation.from_euler("z", heading) for heading in np.arange(4) * np.pi / 2]
    return [_with_shifts(pairs, rx) for rx in guesses]


def _with_shifts(pairs: Sequence[PosePair], rx: Rotation) -> Guess:
    """Return all unknowns for a turn of X: the mean turn of Z, and shifts by linear least squares."""
    (ra, ta), (rb, tb) = (_stacked([getattr(p, side) for p in pairs]) for side in _SIDES)
    rz = (ra * rx * rb.inv()).mean()
    # R_A t_X - t_Z = R_Z t_B - t_A
    left = np.concatenate([np.hstack([m, -np.eye(3)]) for m in ra.as_matrix()])
    shifts = np.linalg.lstsq(left, (rz.apply(tb) - ta).ravel())[0]
    x, z = Pose.from_rotation(shifts[:3], rx), Pose.from_rotation(shifts[3:], rz)
    return Guess(x, z, np.zeros(3), np.zeros(3))


_FEWEST = 6
_UNSEEN = 1e-7
_ROUNDS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetEstimate:
    """The offset and its uncertainty."""

    object_from_base: Pose  #: The base in the object's frame, X.
    #: The odometry in the world, Z; in the middle of the recording if it drifts.
    world_from_odom: Pose
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
    """Return what cameras and robot, base in odometry, say at the same moments, where both do."""
    pairs = []
    for capture in captures:
        sight = capture.sights.get(object_id)
        if not isinstance(sight, Pose):
            continue
        try:
            odom_from_base = buffer.look_up(odom, base, capture.capture_ns)
        except FrameError:
            continue
        time_ns = capture.capture_ns
        pairs.append(
            PosePair(world_from_object=sight, odom_from_base=odom_from_base, time_ns=time_ns)
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
        MocapError: Too few moments, or a motion that leaves something open; says what.
    """
    if len(pairs) < _FEWEST:
        raise MocapError(f"offset: given {len(pairs)} moments, allowed are {_FEWEST} or more")
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
    open_ = [
        name for name, share in zip(names, np.abs(directions[-1][:6]), strict=True) if share > 0.1
    ]
    hint = "; give height_m if the robot turns about z only" if height_m is None else ""
    raise MocapError(
        f"offset: the motion leaves {', '.join(open_) or 'the odometry'} of the base in the object's frame "
        f"open; record one that turns about two axes at least{hint}"
    )
