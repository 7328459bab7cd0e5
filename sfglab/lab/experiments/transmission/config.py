"""What the transmission experiment runs: the grid of paper B, Table 2, at three lengths."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.arp.robots import DEPTHS, METHODS, RATES_HZ
from sfglab.lab.experiments.profiles import ConfigError, of_profile
from sfglab.rtps import Medium

OPT_DEPTH = "opt"
"""The depth that Eq. 6 gives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """One cell of the grid."""

    rate_max_hz: int  #: Rmax.
    depth: str  #: A number as text, or ``opt``.
    method: str  #: One of `METHODS`.
    duration_s: float  #: How long is published, simulated seconds.
    loss: float = Medium().loss  #: Share of frames that the air loses.

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ConfigError(f"method: given {self.method!r}, allowed are {', '.join(METHODS)}")
        if self.depth != OPT_DEPTH and not (self.depth.isdecimal() and int(self.depth) > 0):
            raise ConfigError(
                f"depth: given {self.depth!r}, allowed are whole numbers from 1 and {OPT_DEPTH!r}"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The whole run."""

    profile: str  #: Name of the profile it came from.
    seeds: int  #: How many seeds each cell is run with.
    duration_s: float  #: Simulated seconds of a cell.
    rates_hz: tuple[int, ...] = RATES_HZ  #: Values of Rmax.
    depths: tuple[int, ...] = DEPTHS  #: Values of DEPTH beside the optimum.
    methods: tuple[str, ...] = tuple(METHODS)  #: Names of methods.
    live_s: float = 8.0  #: How long each live cell is, seconds; 0: none is run.
    live_rates_hz: tuple[int, ...] = (100, 200)  #: Rmax of the live cells.
    #: DEPTH of the live cells; optimised methods run with ``opt`` as well.
    live_depths: tuple[str, ...] = ("1", "10", "1000")
    live_methods: tuple[str, ...] = ("none", "OPT+LC")  #: Methods of the live cells.
    seed: int = 0  #: The first seed.

    @classmethod
    def of_profile(cls, profile: str, *, seed: int = 0) -> Config:
        """Return the configuration of a profile.

        Args:
            profile: ``smoke`` (seconds), ``quick`` (minutes) or ``paper`` (30 seeds).
            seed: Seed of everything that is drawn.

        Raises:
            ConfigError: There is no such profile.
        """
        return of_profile(_PROFILES, profile, seed=seed)


_PROFILES = {
    "smoke": Config(
        profile="smoke",
        seeds=1,
        duration_s=2.0,
        live_s=2.0,
        live_rates_hz=(100,),
        live_depths=("10",),
        live_methods=("none",),
    ),
    "quick": Config(profile="quick", seeds=6, duration_s=60.0),
    "paper": Config(profile="paper", seeds=30, duration_s=60.0, live_s=20.0),
}


def grid(config: Config, *, loss: float = Medium().loss) -> list[Point]:
    """Return every cell: Rmax by DEPTH by method.

    Args:
        config: The run.
        loss: Share of frames that the air loses.
    """
    return [
        Point(rate_max_hz=rate, depth=depth, method=method, duration_s=config.duration_s, loss=loss)
        for rate in config.rates_hz
        for depth in (*map(str, config.depths), OPT_DEPTH)
        for method in config.methods
    ]


def live_cells(config: Config) -> list[Point]:
    """Return the cells that are run live as well; an optimised method has the depth ``opt`` in addition."""
    if not config.live_s:
        return []
    return [
        Point(rate_max_hz=rate, depth=depth, method=method, duration_s=config.live_s)
        for rate in config.live_rates_hz
        for method in config.live_methods
        for depth in (*config.live_depths, *((OPT_DEPTH,) if METHODS[method].optimised else ()))
    ]
