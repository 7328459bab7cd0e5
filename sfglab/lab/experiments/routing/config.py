"""What the routing experiment runs, at three lengths."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.lab.experiments.profiles import of_profile


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The whole run."""

    profile: str  #: Name of the profile it came from.
    agents: int  #: Agents behind a router each; two parties in the global domain come in addition.
    seconds: float  #: How long everybody talks at least, seconds.
    rate_hz: float  #: Messages a second of every party on every topic.
    busy: int  #: Further local topics of every agent.
    random_names: int  #: Random DDS names that the policy is asked about.
    call_s: float = 1.0  #: How long a caller waits for a server that it must not reach, seconds.
    seed: int = 0  #: Seed of the random names.

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
    "smoke": Config(profile="smoke", agents=2, seconds=2.5, rate_hz=10.0, busy=3, random_names=500, call_s=0.5),
    "quick": Config(profile="quick", agents=3, seconds=6.0, rate_hz=10.0, busy=20, random_names=20_000),
    "paper": Config(profile="paper", agents=6, seconds=20.0, rate_hz=10.0, busy=50, random_names=200_000),
}
