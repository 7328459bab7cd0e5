"""Beyond the paper: where the base is in the tracked object, estimated from motions whose truth is known.

Asks whether the stated intervals hold, how the error falls with the length of the motion, what drift of the
odometry does to it, and what the estimate is worth when it goes through the bridge.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sfglab.lab.experiments.mocap.robot import AGENT, OBJECT, WORLD
from sfglab.lab.experiments.mocap.rows import OffsetRow
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames import FrameBuffer
from sfglab.spatial.mocap import (
    BridgeCore,
    MappedObject,
    MocapMapping,
    SyntheticConfig,
    SyntheticMotion,
    estimate_offset,
    pose_pairs,
    synthetic_captures,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.lab.experiments.mocap.config import Config
    from sfglab.spatial.mocap import OffsetEstimate


ODOM, BASE = f"{AGENT}/odom", f"{AGENT}/base"
CASES = ((False, True), (True, True), (True, False))
"""Whether the odometry drifts, and whether the estimate allows for it."""
OFFSET = Pose.at((0.031, -0.012, -0.118), (0.02, -0.03, 0.06, 1.0))
"""The base in the object's frame: a plate of markers that nobody has put on straight."""
_WORLD_FROM_ODOM = Pose.from_yaw((3.0, -1.0, 0.2), 0.8)
_CAMERAS = SyntheticConfig(rate_hz=20.0)
_ODOM_M, _ODOM_RAD = 0.003, 0.004
_DRIFT_M_S, _DRIFT_RAD_S = 0.01, 0.002
_REPLAY_S = 5.0
_OTHER_WAY = SyntheticMotion(radii_m=(1.0, 1.5, 0.2), period_s=7.0)


def offset_rows(config: Config) -> Iterator[OffsetRow]:
    """Yield an estimate for every length and motion, of all `CASES`.

    Args:
        config: Lengths, and how many recordings.
    """
    for drifts, modelled in CASES:
        for place, length_s in enumerate(config.lengths_s):
            for number in range(config.recordings):
                rng = np.random.default_rng([config.seed, 2, place, number])
                yield _row(length_s, rng, drifts=drifts, modelled=modelled)


def _row(length_s: float, rng: np.random.Generator, *, drifts: bool, modelled: bool) -> OffsetRow:
    motion = SyntheticMotion()
    made = list(synthetic_captures({OBJECT: motion}, _CAMERAS, rng, duration_s=length_s))
    captures = [m.capture for m in made]
    buffer = _odometry(motion, [c.capture_ns for c in captures], rng, drifts=drifts)
    found = estimate_offset(pose_pairs(captures, OBJECT, buffer, odom=ODOM, base=BASE), drift=modelled)
    error = _errors(found)
    sigmas = np.array([*found.sigma_rad, *found.sigma_m])
    (before_m, before_rad), (after_m, after_rad) = (_replayed(x) for x in (Pose(), found.object_from_base))
    return OffsetRow(
        length_s=length_s,
        drifts=drifts,
        modelled=modelled,
        pairs=found.pairs,
        error_mm=1e3 * float(np.linalg.norm(error[3:])),
        error_mrad=1e3 * float(np.linalg.norm(error[:3])),
        sigma_mm=1e3 * float(np.linalg.norm(sigmas[3:])),
        sigma_mrad=1e3 * float(np.linalg.norm(sigmas[:3])),
        covered=int((np.abs(error) <= 1.96 * sigmas).sum()),
        before_mm=1e3 * before_m,
        after_mm=1e3 * after_m,
        before_mrad=1e3 * before_rad,
        after_mrad=1e3 * after_rad,
    )


def _errors(found: OffsetEstimate) -> np.ndarray:
    """Return what is wrong with the estimate, in the order of its covariance."""
    turn = (OFFSET.rotation.inv() * found.object_from_base.rotation).as_rotvec()
    return np.concatenate([turn, np.subtract(found.object_from_base.position_m, OFFSET.position_m)])


def _odometry(
    motion: SyntheticMotion, times_ns: list[int], rng: np.random.Generator, *, drifts: bool
) -> FrameBuffer:
    """Return what the robot says of itself, at the times of the captures."""
    buffer = FrameBuffer(history_s=None)
    for time_ns in times_ns:
        time_s = time_ns / 1e9
        drift = Pose.from_yaw((_DRIFT_M_S * time_s, 0.0, 0.0), _DRIFT_RAD_S * time_s) if drifts else Pose()
        noise = Pose.at(rng.normal(size=3) * _ODOM_M, (*(rng.normal(size=3) * _ODOM_RAD / 2), 1.0))
        pose = drift @ _WORLD_FROM_ODOM.inverse() @ motion.pose_at(time_s) @ OFFSET @ noise
        buffer.insert(StampedTransform(parent=ODOM, child=BASE, stamp_ns=time_ns, pose=pose))
    return buffer


def _replayed(offset: Pose) -> tuple[float, float]:
    """Return the median error of the base through the bridge with an offset, in m and rad, on another way."""
    buffer = FrameBuffer()
    link = StampedTransform(parent=BASE, child=f"{AGENT}/camera", stamp_ns=0, pose=Pose())
    buffer.insert(link, static=True)
    mapped = MappedObject(id=OBJECT, via=BASE, offset=offset)
    core = BridgeCore(MocapMapping(world=WORLD, objects={OBJECT: mapped}), buffer)
    rng = np.random.default_rng(0)
    errors = []
    for made in synthetic_captures({OBJECT: _OTHER_WAY}, _CAMERAS, rng, duration_s=_REPLAY_S):
        for transform in core.take(made.capture, made.capture.receipt_ns):
            true = made.truth[OBJECT] @ OFFSET
            errors.append((transform.pose.distance_m(true), transform.pose.angle_rad(true)))
    metres, angles = np.median(errors, axis=0)
    return float(metres), float(angles)
