"""The judge of a run: sees what is true in the town, tells nobody who drives.

A run passes when the car comes round within the time, never leaves its lane, runs no red light and has
stopped at enough of them. Refuses to know images and nodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.soc.driving.town import LANE_M

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.soc.driving.town import Place, Town


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """What the judge asks for."""

    #: Farther from the lane's middle a wheel leaves the lane (half a lane less half a car of 18 cm).
    lateral_m: float = LANE_M / 2 - 0.09
    red_lights: int = 3  #: Fewest that the car must have stopped at.
    #: A line crossed so soon after the light turned red is not held against the car: at 0.9 m/s it brakes for
    #: 0.6 s, and a look takes it some frames.
    grace_s: float = 1.0
    stop_m: float = 2.0  #: How near before its line a car stops for a light.
    timeout_s: float = 150.0  #: A lap that takes longer has failed.


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What the judge saw."""

    completed: bool  #: Whether the car came round.
    red_lights_obeyed: int  #: Red lights that it stopped at and did not run.
    red_lights_run: int  #: Lines that it crossed at red.
    largest_lateral_m: float  #: Largest distance of the rear axle from the lane's middle.
    lap_s: float  #: Time of the run, in the town.
    passed: bool  #: Whether the rules are met.


class Judge:
    """Watches a run from its first frame at place 0; a car is where its camera is, over the rear axle.

    Args:
        town: Whose lights and lane.
        rules: What is asked for.
    """

    def __init__(self, town: Town, rules: Rules | None = None) -> None:
        self._town = town
        self.rules = rules or Rules()
        self.driven_m = 0.0
        self._largest_m = 0.0
        self._stopped: set[int] = set()
        self._run: set[int] = set()
        self._before: Place | None = None
        self._now_s = 0.0

    def watch(self, now_s: float, car: Place, speed_mps: float, red_since_s: Sequence[float | None]) -> None:
        """Take a frame: the car's true place on its lane and speed, and since when each light is red."""
        self._now_s = now_s
        self._largest_m = max(self._largest_m, abs(car.left_m))
        length = self._town.lane.length_m
        if self._before is not None:
            step = (car.along_m - self._before.along_m + length / 2) % length - length / 2
            self._watch_lines(self.driven_m, self.driven_m + step, red_since_s)
            self.driven_m += step
        self._before = car
        for i, (light, since) in enumerate(zip(self._town.lights, red_since_s, strict=True)):
            if since is not None and speed_mps < 0.02 and 0 <= light.stop_m - car.along_m <= self.rules.stop_m:
                self._stopped.add(i)

    def _watch_lines(self, before_m: float, now_m: float, red_since_s: Sequence[float | None]) -> None:
        for i, (light, since) in enumerate(zip(self._town.lights, red_since_s, strict=True)):
            late = since is not None and self._now_s - since > self.rules.grace_s
            if late and before_m < light.stop_m <= now_m:
                self._run.add(i)

    @property
    def over(self) -> bool:
        """Whether there is nothing left to see: a lap driven, the lane left, or the time up."""
        left = self._largest_m > self.rules.lateral_m
        return self.driven_m >= self._town.lane.length_m or left or self._now_s >= self.rules.timeout_s

    def verdict(self) -> Verdict:
        """Return what was seen so far."""
        completed = self.driven_m >= self._town.lane.length_m
        obeyed = len(self._stopped - self._run)
        in_lane = self._largest_m <= self.rules.lateral_m
        return Verdict(
            completed=completed,
            red_lights_obeyed=obeyed,
            red_lights_run=len(self._run),
            largest_lateral_m=self._largest_m,
            lap_s=self._now_s,
            passed=completed and in_lane and not self._run and obeyed >= self.rules.red_lights,
        )
