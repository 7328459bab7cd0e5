"""A capture system that needs no hardware: objects on known ways, seen with every fault of a real one.

`synthetic_captures` is pure, and each comes with the truth; `SyntheticSource` plays them in a node's time.
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
    from collections.abc import AsyncGenerator, Iterator, Mapping

    import numpy as np

    from sfglab.bus import Clock


_HALF_TURN = Pose(quat_xyzw=(0.0, 0.0, 1.0, 0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class SyntheticMotion:
    """A closed way in space: an ellipse that heads where it goes, rises and falls, and rolls and pitches."""

    centre_m: tuple[float, float, float] = (0.0, 0.0, 0.5)  #: The middle.
    radii_m: tuple[float, float, float] = (2.0, 1.0, 0.1)  #: Half axes along x, y and z.
    period_s: float = 10.0  #: Time for one round.
    sway_rad: float = 0.15  #: Amplitude of roll and pitch.

    def pose_at(self, time_s: float) -> Pose:
        """Return where the object is."""
        angle = 2.0 * math.pi * time_s / self.period_s
        cosine, sine = math.cos(angle), math.sin(angle)
        (cx, cy, cz), (rx, ry, rz) = self.centre_m, self.radii_m
        position = (cx + rx * cosine, cy + ry * sine, cz + rz * math.sin(2.0 * angle))
        heading = math.atan2(ry * cosine, -rx * sine)
        roll, pitch = self.sway_rad * math.sin(3.0 * angle), self.sway_rad * math.cos(2.0 * angle)
        tilt = Pose.at((0, 0, 0), (math.sin(roll / 2), 0, 0, math.cos(roll / 2)))
        lift = Pose.at((0, 0, 0), (0, math.sin(pitch / 2), 0, math.cos(pitch / 2)))
        return Pose.from_yaw(position, heading) @ lift @ tilt


@dataclass(frozen=True, slots=True, kw_only=True)
class SyntheticConfig:
    """How well a capture system sees; rates are per object and second, durations means of exponential ones."""

    rate_hz: float = between(100.0, without=(0,))  #: Captures a second.
    noise_m: float = between(0.0005)  #: Standard deviation of every coordinate.
    noise_rad: float = between(0.002)  #: Standard deviation of the turn about every axis.
    occlusions_hz: float = between(0.0)  #: How often an object gets hidden.
    occlusion_s: float = between(0.2, without=(0,))  #: For how long.
    #: How often an object's pattern is taken for itself turned by half a turn.
    flips_hz: float = between(0.0)
    flip_s: float = between(0.05, without=(0,))  #: For how long.
    dropped: float = between(0.0, 0, 1, without=(1,))  #: Share of captures that never arrive.
    latency_s: float = between(0.006)  #: From capture to receipt, at least.
    jitter_s: float = between(0.0005)  #: Mean of the exponential part of the latency.

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueCapture:
    """A capture and what was really there."""

    capture: Capture  #: What the system says.
    truth: Mapping[str, Pose]  #: Where the objects were.
    flipped: frozenset[str]  #: Objects that it says were turned by half a turn, and were not.


def synthetic_captures(
    objects: Mapping[str, SyntheticMotion],
    config: SyntheticConfig,
    rng: np.random.Generator,
    *,
    start_ns: int = 0,
    duration_s: float = math.inf,
) -> Iterator[TrueCapture]:
    """Yield captures in order, the first at `start_ns`, time 0 of the ways; drops leave gaps in the numbers."""
    hidden = _Spells(config.occlusions_hz, config.occlusion_s, objects)
    flipped = _Spells(config.flips_hz, config.flip_s, objects)
    for number in range(math.ceil(min(duration_s * config.rate_hz, 2**62))):
        time_s = number / config.rate_hz
        truth = {id_: motion.pose_at(time_s) for id_, motion in objects.items()}
        now_hidden = hidden.at(time_s, rng)
        now_flipped = flipped.at(time_s, rng) - now_hidden
        sights: dict[str, Sight] = {
            id_: Lapse.OCCLUDED
            if id_ in now_hidden
            else _seen(pose, id_ in now_flipped, config, rng)
            for id_, pose in truth.items()
        }
        latency_s = config.latency_s + rng.exponential(config.jitter_s)
        if rng.random() >= config.dropped:
            capture_ns = start_ns + round(time_s * NS_PER_S)
            capture = Capture(
                number=number,
                capture_ns=capture_ns,
                receipt_ns=capture_ns + round(latency_s * NS_PER_S),
                sights=sights,
            )
            yield TrueCapture(capture=capture, truth=truth, flipped=frozenset(now_flipped))


def _seen(pose: Pose, flipped: bool, config: SyntheticConfig, rng: np.random.Generator) -> Pose:  # noqa: FBT001
    x, y, z, a, b, c = rng.normal(size=6).tolist()
    sway, shift = config.noise_rad / 2, config.noise_m
    seen = pose @ Pose.at((x * shift, y * shift, z * shift), (a * sway, b * sway, c * sway, 1.0))
    return seen @ _HALF_TURN if flipped else seen


class _Spells:
    """Times at which something is wrong with an object: Poisson beginnings, exponential durations."""

    def __init__(self, rate_hz: float, mean_s: float, objects: Mapping[str, object]) -> None:
        self._rate_hz, self._mean_s = rate_hz, mean_s
        self._spells = dict.fromkeys(objects, (math.inf, -math.inf))

    def at(self, time_s: float, rng: np.random.Generator) -> set[str]:
        """Return the objects with which it is wrong at a time; times ascend."""
        if not self._rate_hz:
            return set()
        for id_, (_, end_s) in self._spells.items():
            if time_s >= end_s:
                begin_s = max(time_s, end_s) + rng.exponential(1.0 / self._rate_hz)
                self._spells[id_] = (begin_s, begin_s + rng.exponential(self._mean_s))
        return {id_ for id_, (begin_s, end_s) in self._spells.items() if begin_s <= time_s < end_s}


class SyntheticSource:
    """Synthetic captures at their receipt by the node's clock; the ways begin at `start_ns`, or when opened."""

    def __init__(  # noqa: PLR0913 - `synthetic_captures`' and the clock
        self,
        objects: Mapping[str, SyntheticMotion],
        config: SyntheticConfig,
        rng: np.random.Generator,
        *,
        clock: Clock,
        duration_s: float = math.inf,
        start_ns: int | None = None,
    ) -> None:
        self._objects, self._config, self._rng = objects, config, rng
        self._clock, self._duration_s, self._start_ns = clock, duration_s, start_ns

    async def captures(self) -> AsyncGenerator[Capture, None]:
        """Begin at time 0 of the ways."""
        start_ns = self._clock.now_ns() if self._start_ns is None else self._start_ns
        for made in synthetic_captures(
            self._objects, self._config, self._rng, start_ns=start_ns, duration_s=self._duration_s
        ):
            # A loop may wake up a little early; what has not arrived yet is not handed out.
            while (wait_ns := made.capture.receipt_ns - self._clock.now_ns()) > 0:
                await self._clock.sleep_for(wait_ns / NS_PER_S)
            yield replace(made.capture, receipt_ns=self._clock.now_ns())
