"""What the mocap experiment runs, at three lengths."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from sfglab.lab.experiments.profiles import ConfigError, of_profile
from sfglab.spatial.mocap import SyntheticConfig

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["FAULTY", "IDEAL", "ROUNDS", "TAIL_S", "WAYS", "Config", "ConfigError", "MocapWorkerConfig"]

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
    """The whole run.

    Attributes:
        profile: Name of the profile it came from.
        trees: Random robots whose trees motion capture joins, beside the paper's example.
        rounds: The live rounds: names in `ROUNDS`.
        live_s: How long a live round lasts, seconds.
        fault_s: How long every recording with faults lasts, seconds.
        fault_recordings: How many of those there are.
        lengths_s: Lengths of the motions from which the offset is estimated, seconds.
        recordings: How many motions there are of each length.
        seed: Seed of everything that is drawn.
    """

    profile: str
    trees: int
    rounds: tuple[str, ...]
    live_s: float
    fault_s: float
    fault_recordings: int
    lengths_s: tuple[float, ...]
    recordings: int
    seed: int = 0

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
    """What a part does.

    Attributes:
        role: ``robot``, ``bridge`` or ``listener``.
        domains: The domain of each of `WAYS`.
        interface: Towards the others.
        seed: Of the cameras' noise and faults, and of the listener's times.
    """

    role: str
    domains: Mapping[str, int]
    interface: str
    seed: int

    def to_json(self) -> str:
        """Return it as a command line argument."""
        return json.dumps(asdict(self))


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
