"""What the discovery experiment runs: paper A, section 5.3, at three lengths."""

from __future__ import annotations

from dataclasses import dataclass, field

from sfglab.lab.experiments.profiles import ConfigError, of_profile

STANDARD, ROUTED = "standard", "routed"


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """Live fleets of one kind.

    Raises:
        ConfigError: There is no such mode, or an agent would have no peer or no node.
    """

    mode: str  #: ``standard`` or ``routed``.
    agents: tuple[int, ...]  #: Sizes of the fleet.
    talkers: int = 10  #: Publishing nodes of each agent.
    listeners: int = 10  #: Subscribing nodes of each agent.
    repeats: int = 1  #: How often each fleet is started.

    def __post_init__(self) -> None:
        if self.mode not in (STANDARD, ROUTED):
            raise ConfigError(f"mode: given {self.mode!r}, allowed are {STANDARD} and {ROUTED}")
        if min(self.agents) < 2 or self.talkers + self.listeners < 1:
            raise ConfigError(
                f"stage: given {min(self.agents)} agents with {self.talkers} + {self.listeners} nodes, "
                "allowed are fleets from 2 agents with at least one node each"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """Simulated fleets, see `simulated`."""

    agents: tuple[int, ...] = ()  #: Sizes of the fleet.
    talkers: int = 10  #: Publishing nodes of each agent.
    listeners: int = 10  #: Subscribing nodes of each agent.
    repeats: int = 1  #: How many seeds each.


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The whole run."""

    profile: str  #: Name of the profile it came from.
    stages: tuple[Stage, ...]  #: Live fleets; cells of one size and kind of agents are run side by side.
    simulated: Scale = field(default_factory=Scale)  #: Simulated fleets.
    timeout_s: float = 120.0  #: When a fleet that is not complete is given up, seconds after its start.
    multicast: str = "default"  #: How far DDS uses multicast between agents: ``default`` is ROS 2's.
    seed: int = 0  #: Seed of the order of cells, and of what is simulated.

    @classmethod
    def of_profile(cls, profile: str, *, seed: int = 0) -> Config:
        """Return the configuration of a profile.

        Args:
            profile: ``smoke`` (seconds), ``quick`` (minutes) or ``paper`` (120 fleets of each size).
            seed: Seed of everything that is drawn.

        Raises:
            ConfigError: There is no such profile.
        """
        return of_profile(PROFILES, profile, seed=seed)


_FLEETS = (2, 3, 4, 5, 6)
PROFILES = {
    "smoke": Config(
        profile="smoke",
        stages=(
            Stage(mode=STANDARD, agents=(2,), talkers=2, listeners=1),
            Stage(mode=ROUTED, agents=(2,), talkers=2, listeners=1),
        ),
        simulated=Scale(agents=(2, 10), talkers=2, listeners=1),
        timeout_s=20.0,
    ),
    "quick": Config(
        profile="quick",
        stages=(
            Stage(mode=STANDARD, agents=(2, 3, 4, 6)),
            Stage(mode=ROUTED, agents=(2, 3, 4, 5), repeats=2),
            Stage(mode=ROUTED, agents=(6,), repeats=3),
            Stage(mode=ROUTED, agents=(2, 6, 12), talkers=1, listeners=1),
        ),
        simulated=Scale(agents=(2, 4, 6, 12, 25, 50, 100)),
    ),
    "paper": Config(
        profile="paper",
        stages=(
            Stage(mode=STANDARD, agents=_FLEETS, repeats=120),
            Stage(mode=ROUTED, agents=_FLEETS, repeats=120),
            Stage(mode=ROUTED, agents=(2, 4, 6, 8, 12, 16), talkers=1, listeners=1, repeats=10),
        ),
        simulated=Scale(agents=(2, 3, 4, 5, 6, 10, 20, 50, 100, 200, 500, 1000), repeats=5),
        timeout_s=300.0,
    ),
}
"""The profiles by name."""
