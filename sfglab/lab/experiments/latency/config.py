"""What the latency experiment runs: paper A, section 5.4, at three lengths."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.lab.experiments.profiles import of_profile

PATHS = ("standard", "decoder", "agent", "on_demand")
"""The ways from camera to viewer; see `stage`."""

GLASS_PATHS = ("standard", "decoder", "agent")
"""Those whose steady state is measured as well; the fourth differs from the third in its beginning only."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The whole run."""

    profile: str  #: Name of the profile it came from.
    repeats: int  #: How often every path is subscribed to.
    look_s: float  #: How long the viewer looks on after its first picture, seconds.
    skipped: int = 3  #: Pictures at the beginning of a look that do not count for glass-to-glass.
    idle_s: float = 3.0  #: How long the idle load is measured, seconds.
    source: str = "photos"  #: Where frames come from, as `open_source` takes it.
    encoder: str = "auto"  #: H.264 encoder by FFmpeg's name, or ``auto``.
    #: How far DDS uses multicast between hosts: ``spdp`` (discovery only, as Cyclone DDS does on Wi-Fi, the
    #: paper's network) or ``default`` (data too, on a wired link).
    multicast: str = "spdp"
    seed: int = 0  #: Seed of the frames' path, the phases and the order of paths.

    @classmethod
    def of_profile(cls, profile: str, *, source: str = "photos", seed: int = 0) -> Config:
        """Return the configuration of a profile.

        Args:
            profile: ``smoke`` (seconds), ``quick`` (minutes) or ``paper`` (120 samples).
            source: Source of the colour stream.
            seed: Seed of everything that is drawn.

        Raises:
            ConfigError: There is no such profile.
        """
        return of_profile(_PROFILES, profile, source=source, seed=seed)


_PROFILES = {
    "smoke": Config(profile="smoke", repeats=2, look_s=0.4, idle_s=1.0),
    "quick": Config(profile="quick", repeats=20, look_s=0.5),
    "paper": Config(profile="paper", repeats=120, look_s=1.0, idle_s=30.0),
}
