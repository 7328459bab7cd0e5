"""The live rounds' robot and cameras: its tree of frames, where it really is, what its odometry says; pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sfglab.bus.address import BusAddress
from sfglab.lab.checks.trees import AGENT, OBJECT, WORLD
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.mocap.mapping import MappedObject, MocapMapping
from sfglab.spatial.mocap.synthetic import SyntheticConfig, SyntheticMotion

CAMERA = f"{AGENT}/camera"
MOTION = SyntheticMotion()
"""Of the markers, in the world."""
FAULTY = SyntheticConfig(occlusions_hz=0.5, occlusion_s=0.15, flips_hz=0.5, flip_s=0.1, dropped=0.02)
"""Cameras with noise and every fault."""
IDEAL = SyntheticConfig(noise_m=0.0, noise_rad=0.0)
"""Cameras that see without noise and fault, and as late: what is left is the bridge's and the tree's."""
ROUNDS = {"faulty": FAULTY, "ideal": IDEAL}
"""The cameras of each live round."""
TAIL_S = 0.6
"""How long robot and cameras go on behind a round, so that its last looks are answered."""
_BASE_FROM_MARKERS = Pose.at((0.1, 0.0, 0.2), (0.0, 0.05, 0.0, 1.0))
_HEAD_FROM_CAMERA = Pose.at((0.08, 0.0, 0.03), (0.5, -0.5, 0.5, -0.5))
_WORLD_FROM_ODOM = Pose.from_yaw((1.5, -0.7, 0.1), 0.6)
_DRIFT_M_S, _DRIFT_RAD_S = 0.02, 0.01
"""How fast the odometry walks and turns away: as much as wheels and legs do."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MocapWorkerConfig:
    """What a process of the live rounds does."""

    role: str  #: ``robot``, ``bridge`` or ``listener``.
    ways: dict[str, BusAddress]  #: Where each of `WAYS` leads along.
    seed: int  #: Of the cameras' noise and faults, and of the listener's times.


def description() -> tuple[StampedTransform, ...]:
    """Return what never moves in the robot: markers on its base, the camera in its head."""
    return _frame("base", "markers", 0, _BASE_FROM_MARKERS), _frame("head", "camera", 0, _HEAD_FROM_CAMERA)


def motions(start_ns: int, time_ns: int) -> tuple[StampedTransform, ...]:
    """Return what moves: the base in its odometry, which drifts from the way's start on, and the head on it."""
    time_s = (time_ns - start_ns) / 1e9
    drift = Pose.from_yaw((_DRIFT_M_S * time_s, 0.0, 0.0), _DRIFT_RAD_S * time_s)
    odom_from_base = drift @ _WORLD_FROM_ODOM.inverse() @ MOTION.pose_at(time_s) @ _BASE_FROM_MARKERS.inverse()
    return (_frame("odom", "base", time_ns, odom_from_base), _frame("base", "head", time_ns, _head(time_s)))


def world_from_camera(start_ns: int, time_ns: int) -> Pose:
    """Return where the camera really is."""
    time_s = (time_ns - start_ns) / 1e9
    world_from_base = MOTION.pose_at(time_s) @ _BASE_FROM_MARKERS.inverse()
    return world_from_base @ _head(time_s) @ _HEAD_FROM_CAMERA


def mapping() -> MocapMapping:
    """Return the bridge's: the markers stand for themselves, whatever is the robot's root is published."""
    return MocapMapping(world=WORLD, objects={OBJECT: MappedObject(id=OBJECT, via=OBJECT)})


def _head(time_s: float) -> Pose:
    return Pose.from_yaw((0.25, 0.0, 0.1), 0.6 * math.sin(2.0 * math.pi * time_s / 3.0))


def _frame(parent: str, child: str, stamp_ns: int, pose: Pose) -> StampedTransform:
    return StampedTransform(parent=f"{AGENT}/{parent}", child=f"{AGENT}/{child}", stamp_ns=stamp_ns, pose=pose)
