"""A simulated motion capture system: objects on known paths, with noise, occlusions and lost captures.

`synthetic_captures` computes captures, and `SyntheticSource` yields them in a node's time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sfglab.spatial.mocap.tracking import Capture, Lapse, Sight
from sfglab.spatial.poses import Pose, Vec3
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Iterable, Iterator, Mapping

    import numpy as np

    from sfglab.bus import Clock

_RADII_M = (2.0, 1.0, 0.1)  # half axes of the ellipse along x, y and z
_PERIOD_S = 10.0  # time of one round
_SWAY_RAD = 0.15  # amplitude of roll and pitch
_NOISE_M = 0.0005  # standard deviation of each coordinate
_NOISE_RAD = 0.002  # standard deviation of the rotation about each axis
_LATENCY_S = 0.006  # shortest time from capture to receipt
_JITTER_S = 0.0005  # mean of the exponential part of that time


@dataclass(frozen=True, slots=True, kw_only=True)
class SyntheticMotion:
    """A closed path: an ellipse whose height, roll and pitch vary; the x axis points forward."""

    centre_m: Vec3 = (0.0, 0.0, 0.5)  #: Centre of the ellipse, x, y, z, m.

    def pose_at(self, time_s: float) -> Pose:
        """Return the pose at a time, seconds."""
        from scipy.spatial.transform import Rotation

        angle = 2.0 * math.pi * time_s / _PERIOD_S
        cosine, sine = math.cos(angle), math.sin(angle)
        (cx, cy, cz), (rx, ry, rz) = self.centre_m, _RADII_M
        position = (cx + rx * cosine, cy + ry * sine, cz + rz * math.sin(2.0 * angle))
        heading = math.atan2(ry * cosine, -rx * sine)
        roll, pitch = _SWAY_RAD * math.sin(3.0 * angle), _SWAY_RAD * math.cos(2.0 * angle)
        turned = Rotation.from_euler("ZYX", (heading, pitch, roll))
        return Pose.from_rotation(position, turned)


@dataclass(frozen=True, slots=True, kw_only=True)
class SyntheticConfig:
    """Quality of the capture system. Times between occlusions and their durations are random."""

    rate_hz: float = 100.0  #: Captures per second, above 0.
    occlusions_hz: float = 0.0  #: Mean number of occlusions per object and second, 1/s.
    occlusion_s: float = 0.2  #: Mean duration of an occlusion, s, above 0.
    dropped: float = 0.0  #: Share of captures that are lost, below 1.


def synthetic_captures(
    objects: Mapping[str, SyntheticMotion],
    config: SyntheticConfig,
    rng: np.random.Generator,
    *,
    start_ns: int = 0,
    duration_s: float = math.inf,
) -> Iterator[Capture]:
    """Yield captures in order. Lost ones leave gaps in the frame numbers.

    Args:
        objects: Paths of the objects by id.
        config: Quality of the capture system.
        rng: Generator of noise, occlusions, losses and latencies.
        start_ns: Time of the first capture, which is time 0 of the paths, ns.
        duration_s: Duration, s.
    """
    hidden: set[str] = set()
    for number in range(math.ceil(min(duration_s * config.rate_hz, 2**62))):
        time_s = number / config.rate_hz
        sights: dict[str, Sight] = {}
        for id_, motion in objects.items():
            if config.occlusions_hz and rng.random() < _chance(config, hidden=id_ in hidden):
                hidden ^= {id_}
            sights[id_] = Lapse.OCCLUDED if id_ in hidden else _noisy(motion.pose_at(time_s), rng)
        latency_s = _LATENCY_S + rng.exponential(_JITTER_S)
        if rng.random() >= config.dropped:
            capture_ns = start_ns + round(time_s * NS_PER_S)
            receipt_ns = capture_ns + round(latency_s * NS_PER_S)
            yield Capture(
                number=number, capture_ns=capture_ns, receipt_ns=receipt_ns, sights=sights
            )


def _chance(config: SyntheticConfig, *, hidden: bool) -> float:
    """Return the probability that an occlusion ends, or begins, before the next capture."""
    mean_s = config.occlusion_s if hidden else 1.0 / config.occlusions_hz
    return -math.expm1(-1.0 / (config.rate_hz * mean_s))


def _noisy(pose: Pose, rng: np.random.Generator) -> Pose:
    x, y, z = rng.normal(0.0, _NOISE_M, 3).tolist()
    a, b, c = rng.normal(0.0, _NOISE_RAD / 2, 3).tolist()
    return pose @ Pose.at((x, y, z), (a, b, c, 1.0))


class SyntheticSource:
    """Captures that are yielded at their receipt by the clock of a node.

    Args:
        captures: The captures, as of `synthetic_captures`.
        clock: Clock of the node.
    """

    def __init__(self, captures: Iterable[Capture], clock: Clock) -> None:
        self._captures, self._clock = captures, clock

    async def captures(self) -> AsyncGenerator[Capture, None]:
        """Yield each capture at its time of receipt."""
        for capture in self._captures:
            # A loop may wake up a little early, when the capture has not arrived yet.
            while (wait_ns := capture.receipt_ns - self._clock.now_ns()) > 0:
                await self._clock.sleep_for(wait_ns / NS_PER_S)
            yield replace(capture, receipt_ns=self._clock.now_ns())
