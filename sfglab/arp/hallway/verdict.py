"""What a run came to: one round without contact and without a stop for an obstacle, or how it failed. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from sfglab.arp.hallway.world import RADIUS_M

if TYPE_CHECKING:
    from collections.abc import Sequence


LIMIT_S = 120.0
"""When a run is given up: the round takes 77 s at the constant velocity."""

_HOME_RAD = 0.1  # around the ring; 0.3 m at home


class End(Enum):
    """How a run ended."""

    SUCCESS = "success"
    CONTACT = "contact"
    STOP = "stop for an obstacle"
    TIMEOUT = "timeout"


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The end of a run."""

    end: End  #: How.
    robot: int = -1  #: Index of who failed; -1: nobody, or nobody alone.


def judge(
    clearance_m: Sequence[float],
    wound_rad: Sequence[float],
    *,
    stopped_by: int | None,
    now_s: float,
    limit_s: float = LIMIT_S,
) -> Verdict | None:
    """Return how a run has ended, or None while it goes on.

    Args:
        clearance_m: From each robot's middle to the nearest wall.
        wound_rad: How far around each robot has come.
        stopped_by: Who stopped all for an obstacle.
        now_s: Since the start.
        limit_s: When it is given up.
    """
    for robot, clearance in enumerate(clearance_m):
        if clearance <= RADIUS_M:
            return Verdict(end=End.CONTACT, robot=robot)
    if stopped_by is not None:
        return Verdict(end=End.STOP, robot=stopped_by)
    if min(wound_rad) >= math.tau - _HOME_RAD:
        return Verdict(end=End.SUCCESS)
    return Verdict(end=End.TIMEOUT) if now_s >= limit_s else None
