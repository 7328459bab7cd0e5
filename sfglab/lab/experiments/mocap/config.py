"""What the mocap experiment runs, at three lengths."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.bus.address import BusAddress
from sfglab.lab.experiments.profiles import of_profile
from sfglab.spatial.mocap import SyntheticConfig

FAULTY = SyntheticConfig(occlusions_hz=0.5, occlusion_s=0.15, flips_hz=0.5, flip_s=0.1, dropped=0.02)
"""Cameras with noise and every fault."""
IDEAL = SyntheticConfig(noise_m=0.0, noise_rad=0.0)
"""Cameras that see without noise and fault, and as late: what is left is the bridge's and the tree's."""
WAYS = ("proxy", "direct", "renamed")
"""How motion capture joins a robot's tree."""
TAIL_S = 0.6
"""How long robot and cameras go on behind a round, so that its last looks are answered."""
ROUNDS = {"faulty": FAULTY, "ideal": IDEAL}


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The whole run."""

    profile: str  #: Name of the profile it came from.
    trees: int  #: Random robots whose trees motion capture joins, beside the paper's example.
    rounds: tuple[str, ...]  #: The live rounds: names in `ROUNDS`.
    live_s: float  #: How long a live round lasts, seconds.
    fault_s: float  #: How long every recording with faults lasts, seconds.
    fault_recordings: int  #: How many of those there are.
    lengths_s: tuple[float, ...]  #: Lengths of the motions from which the offset is estimated, seconds.
    recordings: int  #: How many motions there are of each length.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class MocapWorkerConfig:
    """What a part does."""

    role: str  #: ``robot``, ``bridge`` or ``listener``.
    ways: dict[str, BusAddress]  #: Where each of `WAYS` leads along.
    seed: int  #: Of the cameras' noise and faults, and of the listener's times.


_PROFILES = {
    "smoke": Config(
        profile="smoke",
        trees=20,
        rounds=("faulty",),
        live_s=1.2,
        fault_s=20.0,
        fault_recordings=2,
        lengths_s=(5.0,),
        recordings=3,
    ),
    "quick": Config(
        profile="quick",
        trees=200,
        rounds=("faulty", "ideal"),
        live_s=8.0,
        fault_s=60.0,
        fault_recordings=4,
        lengths_s=(2.0, 5.0, 10.0, 20.0),
        recordings=8,
    ),
    "paper": Config(
        profile="paper",
        trees=2000,
        rounds=("faulty", "ideal"),
        live_s=30.0,
        fault_s=60.0,
        fault_recordings=30,
        lengths_s=(2.0, 5.0, 10.0, 20.0, 40.0),
        recordings=60,
    ),
}
