"""What the gateways experiment explores, at three lengths."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.lab.experiments.profiles import of_profile
from sfglab.soc.gateway import Bound


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """How much is explored."""

    profile: str  #: Name of the profile it came from.
    bounds: tuple[Bound, ...]  #: What is explored with the core's table, and with the one that does not claim.
    bent: bool = True  #: Whether the same is asked of every table with one arrow bent.
    graph_file: str = "graphs/figure_8.yaml"  #: The example, in the data folder.
    seed: int = 0  #: For the other experiments' sake; nothing is drawn here.

    @classmethod
    def of_profile(cls, profile: str, *, seed: int = 0) -> Config:
        """Return the configuration of a profile.

        Args:
            profile: ``smoke``, ``quick`` or ``paper``.
            seed: Not used.

        Raises:
            ConfigError: There is no such profile.
        """
        return of_profile(_PROFILES, profile, seed=seed)


_SMALL = (Bound(), Bound(subscribers=2), Bound(calls=2), Bound(port_messages=1), Bound(echoes=False))
_LARGER = (
    Bound(software=(3,), hardware=(3,)),
    Bound(software=(2, 1), hardware=(1, 1)),
    Bound(software=(4,), hardware=(4,), subscribers=2, calls=2),
)
_LARGEST = (
    Bound(software=(2, 1), hardware=(2, 1), subscribers=2),
    Bound(software=(2, 1), hardware=(2, 1), port_messages=2),
)
_PROFILES = {
    "smoke": Config(profile="smoke", bounds=_SMALL, bent=False),
    "quick": Config(profile="quick", bounds=(*_SMALL, *_LARGER)),
    "paper": Config(profile="paper", bounds=(*_SMALL, *_LARGER, *_LARGEST)),
}
