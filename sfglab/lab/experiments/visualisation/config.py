"""What the visualisation experiment runs: paper A, section 4.5, at three lengths."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.lab.experiments.profiles import of_profile

ADDED_MS = 5.0
"""Median time that the bridge may add to a picture of 640 x 360, ms; ours, the paper states none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The whole run."""

    profile: str  #: Name of the profile it came from.
    moments: int = 10  #: How often every topic of the scene speaks.
    clouds: int = 10  #: Depth images of 640 x 360 whose points are compared.
    streams: int = 200  #: Random streams that are synchronised.
    rounds: int = 4  #: How often both arms of the latency are timed, in turn.
    pictures: int = 60  #: Pictures of an arm in one round.
    stopped_s: float = 4.0  #: How long the slow sink stands still.
    observed_s: float = 1.5  #: How long pictures are counted under a rate budget.
    seed: int = 0  #: Seed of the pictures and of the streams.

    @classmethod
    def of_profile(cls, profile: str, *, seed: int = 0) -> Config:
        """Return the configuration of a profile.

        Args:
            profile: ``smoke``, ``quick`` or ``paper``.
            seed: Seed of the pictures and of the streams.

        Raises:
            ConfigError: There is no such profile.
        """
        return of_profile(_PROFILES, profile, seed=seed)


_PROFILES = {
    "smoke": Config(
        profile="smoke", clouds=1, streams=20, rounds=1, pictures=15, stopped_s=1.2, observed_s=0.8
    ),
    "quick": Config(profile="quick"),
    "paper": Config(profile="paper", clouds=60, streams=2000, rounds=10, pictures=150, stopped_s=8.0),
}
