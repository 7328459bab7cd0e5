"""What the transmission experiment runs: the grid of paper B, Table 2, at three lengths."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.arp.methods import DEPTHS, METHODS, RATES_HZ
from sfglab.lab.experiments.profiles import ConfigError, of_profile
from sfglab.rtps import Medium

__all__ = ["OPT_DEPTH", "Config", "ConfigError", "Point", "grid", "live_cells"]

OPT_DEPTH = "opt"
"""The depth that Eq. 6 gives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """One cell of the grid.

    Attributes:
        rate_max_hz: Rmax.
        depth: A number as text, or ``opt``.
        method: One of `METHODS`.
        duration_s: How long is published, simulated seconds.
        loss: Share of frames that the air loses.
    """

    rate_max_hz: int
    depth: str
    method: str
    duration_s: float
    loss: float = Medium().loss

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ConfigError(f"method: given {self.method!r}, allowed are {', '.join(METHODS)}")
        if self.depth != OPT_DEPTH and not (self.depth.isdecimal() and int(self.depth) > 0):
            raise ConfigError(
                f"depth: given {self.depth!r}, allowed are whole numbers from 1 and {OPT_DEPTH!r}"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The whole run.

    Attributes:
        profile: Name of the profile it came from.
        seeds: How many seeds each cell is run with.
        duration_s: Simulated seconds of a cell.
        rates_hz: Values of Rmax.
        depths: Values of DEPTH beside the optimum.
        methods: Names of methods.
        live_s: How long each live cell is, seconds; 0: none is run.
        live_rates_hz: Rmax of the live cells.
        live_depths: DEPTH of the live cells; optimised methods run with ``opt`` as well.
        live_methods: Methods of the live cells.
        seed: The first seed.
    """

    profile: str
    seeds: int
    duration_s: float
    rates_hz: tuple[int, ...] = RATES_HZ
    depths: tuple[int, ...] = DEPTHS
    methods: tuple[str, ...] = tuple(METHODS)
    live_s: float = 8.0
    live_rates_hz: tuple[int, ...] = (100, 200)
    live_depths: tuple[str, ...] = ("1", "10", "1000")
    live_methods: tuple[str, ...] = ("none", "OPT+LC")
    seed: int = 0

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
