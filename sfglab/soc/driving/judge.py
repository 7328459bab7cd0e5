"""The module `judge` judges whether a car stayed in its lane, stopped at red lights and completed a lap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.soc.driving.town import LANE_M, Place, Town

if TYPE_CHECKING:
    from collections.abc import Sequence

_STANDING_MPS = 0.02
#: Largest distance of the rear axle from the lane's middle: half a lane minus half a car of 18 cm width.
_LATERAL_M = LANE_M / 2 - 0.09
#: Time after a light turned red in which the car may cross the light's line. The car needs 0.6 s to brake from
#: 0.9 m/s, and some frames to detect the light.
_GRACE_S = 1.0
#: Largest distance to the stop line at which a standing car counts as stopped for the light.
_STOP_M = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """A `Verdict` is the result of a lap."""

    red_lights_obeyed: int  #: Number of red lights that the car stopped at and did not run.
    red_lights_run: int  #: Number of stop lines that the car crossed at red.
    largest_lateral_m: float  #: Largest distance of the rear axle from the lane's middle, m.
    lap_s: float  #: Duration of the lap on the town's clock, s.
    passed: bool  #: Whether the car met all rules.


class Judge:
    """A `Judge` observes a drive that begins at place 0 of the lane.

    Args:
        town: Town of the drive.
        timeout_s: Time on the town's clock after which the lap has failed.
        red_lights: Smallest number of red lights that the car must stop at.
    """

    def __init__(self, town: Town, *, timeout_s: float = 150.0, red_lights: int = 3) -> None:
        self._town = town
        self._timeout_s = timeout_s
        self._red_lights = red_lights
        self._driven_m = 0.0
        self._largest_m = 0.0
        self._stopped: set[int] = set()
        self._run: set[int] = set()
        self._before: Place | None = None
        self._now_s = 0.0

    def observe(
        self, now_s: float, car: Place, speed_mps: float, red_since_s: Sequence[float | None]
    ) -> None:
        """Observe one frame of the drive.

        Args:
            now_s: Time on the town's clock.
            car: True place of the rear axle on the lane.
            speed_mps: True speed.
            red_since_s: Time at which each light turned red, s; None for a green light.
        """
        self._now_s = now_s
        self._largest_m = max(self._largest_m, abs(car.left_m))
        driven_m = self._driven_m + self._step_m(car)
        for i, (light, since_s) in enumerate(zip(self._town.lights, red_since_s, strict=True)):
            if since_s is None:
                continue
            crossed = self._driven_m < light.stop_m <= driven_m
            if crossed and now_s - since_s > _GRACE_S:
                self._run.add(i)
            near = 0 <= light.stop_m - car.along_m <= _STOP_M
            if near and speed_mps < _STANDING_MPS:
                self._stopped.add(i)
        self._driven_m = driven_m
        self._before = car

    def _step_m(self, car: Place) -> float:
        """Return the distance that the car has driven along the closed lane since the last frame."""
        if self._before is None:
            return 0.0
        length_m = self._town.lane.length_m
        return (car.along_m - self._before.along_m + length_m / 2) % length_m - length_m / 2

    @property
    def over(self) -> bool:
        """Return whether the lap is over: the car completed the lap, left its lane, or ran out of time."""
        timed_out = self._now_s >= self._timeout_s
        return self._completed or not self._in_lane or timed_out

    @property
    def _completed(self) -> bool:
        return self._driven_m >= self._town.lane.length_m

    @property
    def _in_lane(self) -> bool:
        return self._largest_m <= _LATERAL_M

    def verdict(self) -> Verdict:
        """Return the result of the frames that the judge has observed."""
        obeyed = len(self._stopped - self._run)
        lawful = not self._run and obeyed >= self._red_lights
        return Verdict(
            red_lights_obeyed=obeyed,
            red_lights_run=len(self._run),
            largest_lateral_m=self._largest_m,
            lap_s=self._now_s,
            passed=self._completed and self._in_lane and lawful,
        )
