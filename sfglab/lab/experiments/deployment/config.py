"""What the deployment experiment does."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.lab.experiments.profiles import of_profile


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The whole run."""

    profile: str  #: Name of the profile it came from.
    agents: tuple[str, ...] = ()  #: Whose files are rendered, checked and applied; none: all.
    fleet_file: str = "fleets/esslingen.yaml"  #: The fleet, in the data folder.
    #: Agents whose containers' commands are run over DDS between namespaces; none: not at all.
    containers: tuple[str, ...] = ("go2", "pi1", "workstation")
    build: bool = True  #: Whether images are built, where the tools are.
    seed: int = 0  #: Of nothing that is random; for the record.

    @classmethod
    def of_profile(cls, profile: str, *, seed: int = 0) -> Config:
        """Return the configuration of a profile.

        Args:
            profile: ``smoke`` (two agents, nothing live, no image), ``quick`` or ``paper``.
            seed: For the record.

        Raises:
            ConfigError: There is no such profile.
        """
        return of_profile(_PROFILES, profile, seed=seed)


_PROFILES = {
    "smoke": Config(profile="smoke", agents=("go2", "steamdeck"), containers=(), build=False),
    "quick": Config(profile="quick"),
    "paper": Config(
        profile="paper",
        containers=("go2", "pi1", "pi2", "pi3", "pi4", "pi5", "pi6", "steamdeck", "workstation"),
    ),
}
