"""What the planning experiment checks, and how often."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.lab.experiments.profiles import of_profile


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The whole run."""

    profile: str  #: Name of the profile it came from.
    cases: int = 100  #: Random cases of each property of trajectories and exchange.
    edit_cases: int = 40  #: Random sequences of edits of each property of editing.
    kills: int = 4  #: Writers of a file that are killed.
    #: Whether the action runs over DDS, on the loopback interface; else on the simulated bus.
    live: bool = True
    domain: int = 57  #: Which DDS domain.
    scene_file: str = "scenes/hall.yaml"  #: The scene whose agents are sent along, in the data folder.
    seed: int = 0  #: Of all cases.

    @classmethod
    def of_profile(cls, profile: str, *, seed: int = 0) -> Config:
        """Return the configuration of a profile.

        Args:
            profile: ``smoke`` (a few cases, simulated bus), ``quick`` or ``paper``.
            seed: Of all cases.

        Raises:
            ConfigError: There is no such profile.
        """
        return of_profile(_PROFILES, profile, seed=seed)


_PROFILES = {
    "smoke": Config(profile="smoke", cases=8, edit_cases=4, kills=1, live=False),
    "quick": Config(profile="quick"),
    "paper": Config(profile="paper", cases=2000, edit_cases=500, kills=30),
}
