"""What the driving experiment runs: paper C, section 6, at three lengths, and what the paper says of it."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.lab.experiments.profiles import of_profile

MAPPINGS = ("software", "gateway")
"""What topic A is mapped to, in the paper's two versions."""

PAPER_MS = {"software": (28.264, 3.21), "gateway": (20.270, 0.239)}
"""Mean and standard deviation of the chain's time, as stated."""

READINGS = {
    "hardware": "node times in hardware, assumed",
    "software": "node times in software, measured",
}
"""What the chain's nodes take. The first answers the claim: the paper's nodes run in hardware, and what it
compares is how topic A travels between them. That was decided before either was computed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LapPoint:
    """What every seed drives."""

    limit_s: float  #: Time in the town after which a lap has failed.


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainPoint:
    """What the chain is timed by."""

    limit_s: float  #: Time in the town after which it ends, at the latest.
    width: int = 640  #: Of the camera's images, whose size is that of topic A's messages in the graph.
    height: int = 480  #: The same.
    graph_file: str = "graphs/driving.yaml"  #: The graph, in the data folder.


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The whole run."""

    profile: str  #: Name of the profile it came from.
    laps: int = 20  #: How many towns are driven round.
    lap: LapPoint = LapPoint(limit_s=150.0)  #: What is driven in each.
    chain: ChainPoint = ChainPoint(limit_s=150.0)  #: What the chain is timed by.
    seed: int = 0  #: The first town's.

    @classmethod
    def of_profile(cls, profile: str, *, seed: int = 0) -> Config:
        """Return the configuration of a profile.

        Args:
            profile: ``smoke`` (a few metres), ``quick`` (20 laps) or ``paper`` (100).
            seed: The first town's.

        Raises:
            ConfigError: There is no such profile.
        """
        return of_profile(_PROFILES, profile, seed=seed)


_PROFILES = {
    "smoke": Config(profile="smoke", laps=1, lap=LapPoint(limit_s=8.0), chain=ChainPoint(limit_s=2.0)),
    "quick": Config(profile="quick"),
    "paper": Config(profile="paper", laps=100),
}
