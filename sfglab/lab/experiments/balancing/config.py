"""What the experiment on caches and balanced QoS runs: paper B, sections 2.2 to 2.4, at three lengths."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.arp.robots import RATES_HZ
from sfglab.lab.experiments.profiles import of_profile


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The whole run."""

    profile: str  #: Name of the profile it came from.
    readings_s: float  #: How long each sensor is read, seconds of its own time.
    rates_hz: tuple[int, ...] = RATES_HZ  #: At which rates it is read.
    stale_s: float = 600.0  #: How long each link with losses is simulated, seconds.
    stale_seeds: int = 20  #: With how many seeds.
    #: Longest silences of the local cache, seconds; 0: none, as in the paper.
    silences_s: tuple[float, ...] = (0.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1)
    loss: float = 0.2  #: Share of frames that these links lose.
    #: Values of T_avg, as topics of one agent, for which Eq. 6 is solved.
    topics: tuple[tuple[int, ...], ...] = ((6, 5, 5), (7, 6, 6), (8, 5, 5), (8, 6, 6), (9, 9, 9), (10,))
    rates_min_hz: tuple[float, ...] = (0.5, 1.0, 10.0)  #: Values of Rmin for which it is solved.
    topic_file: str = "qos/paper_b.yaml"  #: Topics that our own problem is solved for, in the data folder.
    weights: int = 25  #: Points of the Pareto front of our own problem.
    seed: int = 0  #: Seed of everything that is drawn.

    @classmethod
    def of_profile(cls, profile: str, *, seed: int = 0) -> Config:
        """Return the configuration of a profile.

        Args:
            profile: ``smoke`` (seconds), ``quick`` or ``paper``.
            seed: Seed of everything that is drawn.

        Raises:
            ConfigError: There is no such profile.
        """
        return of_profile(_PROFILES, profile, seed=seed)


_PROFILES = {
    "smoke": Config(
        profile="smoke", readings_s=5.0, stale_s=20.0, stale_seeds=2, silences_s=(0.0, 0.5), weights=5
    ),
    "quick": Config(profile="quick", readings_s=60.0),
    "paper": Config(profile="paper", readings_s=600.0, stale_s=3600.0, stale_seeds=50),
}
