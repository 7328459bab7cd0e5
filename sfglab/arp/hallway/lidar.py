"""The LIDAR of paper B's robots, as its data sheet has it: eight beams, ten times a second, in steps.

SLAMTEC RPLIDAR A2M8 (section 3.1): range 0.15 to 12 m, 10 turns a second, resolution 0.5 mm, and 1 % of the
distance beyond 1.5 m. The steps are why a beam along a straight wall repeats its value. A range travels as
float metres; its number here is the step's, which is what the reliability model compares. Pure.
"""

from __future__ import annotations

import math

BEAMS_DEG = (0, 45, 90, 135, 180, 225, 270, 315)
"""Directions, counter-clockwise from ahead: paper B, section 3.2."""

SCAN_HZ = 10
"""Turns a second, and new values of one beam."""

NO_ECHO = 0
"""Step of a range that the sensor does not see."""

_NEAREST_M, _FARTHEST_M = 0.15, 12.0
_FINE_M, _FINE_UNTIL_M = 0.0005, 1.5
_COARSE = math.log1p(0.01)
_FINE_STEPS = round(_FINE_UNTIL_M / _FINE_M)


def step_from_range(range_m: float) -> int:
    """Return the number of the step that a range is measured as; `NO_ECHO` out of the sensor's reach."""
    if not _NEAREST_M <= range_m <= _FARTHEST_M:
        return NO_ECHO
    if range_m <= _FINE_UNTIL_M:
        return round(range_m / _FINE_M)
    return _FINE_STEPS + round(math.log(range_m / _FINE_UNTIL_M) / _COARSE)


def range_from_step(step: int) -> float:
    """Return the range that a step stands for, metres; infinity for `NO_ECHO`."""
    if step == NO_ECHO:
        return math.inf
    if step <= _FINE_STEPS:
        return step * _FINE_M
    return _FINE_UNTIL_M * math.exp((step - _FINE_STEPS) * _COARSE)
