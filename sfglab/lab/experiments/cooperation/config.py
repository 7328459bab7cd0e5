"""What the cooperation experiment runs: paper B, section 3.2, at three lengths."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.arp.balancing import BalanceInput, balance
from sfglab.arp.hallway import AREAS, BEAMS_DEG
from sfglab.arp.robots import METHODS, RATES_HZ
from sfglab.lab.experiments.profiles import of_profile
from sfglab.rtps import Medium

DEPTHS = (1, 10, 1000)
"""Of Table 2, without optimisation: the paper does not say which depth Fig. 16 had, so the smallest, ROS 2's
default and a large one count a third each."""

OPTIMUM = 0
"""Stands for the depth that Eq. 6 gives."""

_TOPICS = (len(BEAMS_DEG) + 1,) * len(AREAS)  # eight beams and one result each


_MEDIUM = Medium()


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """One cell: a method at a rate and a depth, over one medium."""

    method: str  #: One of `METHODS`.
    rate_max_hz: int  #: Rmax.
    depth: int  #: Of Table 2; `OPTIMUM`: D of Eq. 6, only with OPT.
    vendor: str = "fast_dds"  #: A name in `PRESETS`.
    medium: Medium = _MEDIUM  #: What carries the frames.


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """What a point comes to."""

    rate_hz: float  #: Rate of each topic.
    depth: int  #: Depth of each writer's and reader's history.


def setting_of(point: Point) -> Setting:
    """Return the rate and the depth of a point: those of Table 2, or with OPT those of Eq. 6."""
    if not METHODS[point.method].optimised:
        return Setting(rate_hz=float(point.rate_max_hz), depth=point.depth)
    best = balance(BalanceInput(topics=_TOPICS, rate_max_hz=float(point.rate_max_hz)))
    # The solver's digits end somewhere; beyond the sixth they are noise.
    depth = int(round(best.depth, 6)) if point.depth == OPTIMUM else point.depth
    return Setting(rate_hz=round(best.rate_hz, 6), depth=depth)


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The whole run."""

    profile: str  #: Name of the profile it came from.
    rates_hz: tuple[int, ...] = RATES_HZ  #: The values of Rmax.
    seeds: int = 6  #: How many runs of each point.
    #: How many of each point of the contrasts: no loss, another vendor's timing, and the rate of Eq. 6 without
    #: its depth.
    contrast_seeds: int = 2
    live_s: float = 0.0  #: How long the live robots drive, seconds; 0: none is run.
    seed: int = 0  #: The first seed.

    @classmethod
    def of_profile(cls, profile: str, *, seed: int = 0) -> Config:
        """Return the configuration of a profile.

        Args:
            profile: ``smoke`` (seconds), ``quick`` (minutes) or ``paper`` (120 runs of each point).
            seed: The first seed.

        Raises:
            ConfigError: There is no such profile.
        """
        return of_profile(_PROFILES, profile, seed=seed)


def points_of(config: Config) -> list[Point]:
    """Return the points of Fig. 16, method by method."""
    return [
        Point(method=name, rate_max_hz=rate, depth=depth)
        for name, method in METHODS.items()
        for rate in config.rates_hz
        for depth in ((OPTIMUM,) if method.optimised else DEPTHS)
    ]


_PROFILES = {
    "smoke": Config(profile="smoke", rates_hz=(100,), seeds=1, contrast_seeds=0),
    "quick": Config(profile="quick", live_s=90.0),
    "paper": Config(profile="paper", seeds=120, contrast_seeds=30, live_s=90.0),
}
