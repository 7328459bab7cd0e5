"""A simulated motion capture system: objects on known paths, with noise, occlusions and lost captures.

`synthetic_captures` computes captures, and `SyntheticSource` yields them in a node's time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sfglab.fields import between, check_bounds
from sfglab.spatial.mocap.tracking import Capture, Lapse, Sight
from sfglab.spatial.poses import Pose
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Iterable, Iterator, Mapping

    import numpy as np

    from sfglab.bus import Clock


@dataclass(frozen=True, slots=True, kw_only=True)
class SyntheticMotion:
    """A closed path: an ellipse whose height, roll and pitch vary; the x axis points forward."""

    centre_m: tuple[float, float, float] = (0.0, 0.0, 0.5)  #: Centre of the ellipse.
    radii_m: tuple[float, float, float] = (2.0, 1.0, 0.1)  #: Half axes along x, y and z.
    period_s: float = 10.0  #: Time of one round.
    sway_rad: float = 0.15  #: Amplitude of roll and pitch.

    def pose_at(self, time_s: float) -> Pose:
        """Return the pose at a time."""
        from scipy.spatial.transform import Rotation

        angle = 2.0 * math.pi * time_s / self.period_s
        cosine, sine = math.cos(angle), math.sin(angle)
        (cx, cy, cz), (rx, ry, rz) = self.centre_m, self.radii_m
        position = (cx + rx * cosine, cy + ry * sine, cz + rz * math.sin(2.0 * angle))
        heading = math.atan2(ry * cosine, -rx * sine)
        roll, pitch = self.sway_rad * math.sin(3.0 * angle), self.sway_rad * math.cos(2.0 * angle)
        turned = Rotation.from_euler("ZYX", (heading, pitch, roll))
        return Pose.from_rotation(position, turned)


@dataclass(frozen=True, slots=True, kw_only=True)
class SyntheticConfig:
    """Quality of the capture system. Times between events and their durations are exponential.

    Raises:
        InvalidValueError: A value is out of its bounds.
    """

    rate_hz: float = between(100.0, without=(0,))  #: Captures per second.
    noise_m: float = between(0.0005)  #: Standard deviation of each coordinate.
    noise_rad: float = between(0.002)  #: Standard deviation of the rotation about each axis.
    occlusions_hz: float = between(0.0)  #: Occlusions per object and second.
    occlusion_s: float = between(0.2, without=(0,))  #: Mean duration of an occlusion.
    dropped: float = between(0.0, 0, 1, without=(1,))  #: Share of captures that are lost.
    latency_s: float = between(0.006)  #: Shortest time from capture to receipt.
    jitter_s: float = between(0.0005)  #: Mean of the exponential part of the latency.

    def __post_init__(self) -> None:
        check_bounds(self)


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
        duration_s: Duration.
    """
    occlusions = _Occlusions(config, objects)
    for number in range(math.ceil(min(duration_s * config.rate_hz, 2**62))):
        time_s = number / config.rate_hz
        hidden = occlusions.at(time_s, rng)
        sights: dict[str, Sight] = {}
        for id_, motion in objects.items():
            is_hidden = id_ in hidden
            sights[id_] = (
                Lapse.OCCLUDED if is_hidden else _noisy(motion.pose_at(time_s), config, rng)
            )
        latency_s = config.latency_s + rng.exponential(config.jitter_s)
        if rng.random() >= config.dropped:
            capture_ns = start_ns + round(time_s * NS_PER_S)
            receipt_ns = capture_ns + round(latency_s * NS_PER_S)
            yield Capture(
                number=number, capture_ns=capture_ns, receipt_ns=receipt_ns, sights=sights
            )


def _noisy(pose: Pose, config: SyntheticConfig, rng: np.random.Generator) -> Pose:
    x, y, z, a, b, c = rng.normal(size=6).tolist()
    half, shift = config.noise_rad / 2, config.noise_m
    return pose @ Pose.at((x * shift, y * shift, z * shift), (a * half, b * half, c * half, 1.0))


class _Occlusions:
    """Occlusions of objects: exponential times between them, and exponential durations."""

    def __init__(self, config: SyntheticConfig, objects: Mapping[str, object]) -> None:
        self._config = config
        self._spans = dict.fromkeys(objects, (math.inf, -math.inf))

    def at(self, time_s: float, rng: np.random.Generator) -> set[str]:
        """Return the objects that are hidden at a time. Times ascend."""
        if not self._config.occlusions_hz:
            return set()
        for id_, (_, end_s) in self._spans.items():
            if time_s >= end_s:
                begin_s = max(time_s, end_s) + rng.exponential(1.0 / self._config.occlusions_hz)
                self._spans[id_] = (begin_s, begin_s + rng.exponential(self._config.occlusion_s))
        return {id_ for id_, (begin_s, end_s) in self._spans.items() if begin_s <= time_s < end_s}


class SyntheticSource:
    """Captures that are yielded at their receipt by the clock of a node.

    Args:
        captures: The captures, as of `synthetic_captures`.
        clock: Clock of the node.
    """

    def __init__(self, captures: Iterable[Capture], clock: Clock) -> None:
        self._captures, self._clock = captures, clock

    async def captures(self) -> AsyncGenerator[Capture, None]:
        """Yield the captures."""
        for capture in self._captures:
            # A loop may wake up a little early, when the capture has not arrived yet.
            while (wait_ns := capture.receipt_ns - self._clock.now_ns()) > 0:
                await self._clock.sleep_for(wait_ns / NS_PER_S)
            yield replace(capture, receipt_ns=self._clock.now_ns())
