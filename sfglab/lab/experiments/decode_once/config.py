"""What the decode-once experiment runs: paper A, section 5.2, at three lengths."""

from __future__ import annotations

from dataclasses import dataclass, replace

from sfglab.lab.experiments.profiles import of_profile


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """One camera stream and how often it is measured with how many subscribers."""

    codec: str  #: ``h264`` (colour) or ``rvl`` (depth).
    source: str  #: Where frames come from, as `open_source` takes it.
    counts: tuple[int, ...]  #: Numbers of local subscribers.
    #: Numbers of subscribers that receive without decoding, to tell network from decoding.
    network_counts: tuple[int, ...] = ()
    repeats: int = 1  #: How often every pair of cells is measured.


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The whole run."""

    profile: str  #: Name of the profile it came from.
    stages: tuple[Stage, ...]  #: Streams, one after the other.
    samples: int  #: Meter readings in a cell.
    period_s: float  #: Time between readings, seconds.
    #: Wait in a cell between the last subscriber's first frame and the first reading, seconds.
    settle_s: float = 0.5
    raw_s: float = 3.0  #: How long the camera's raw messages are recorded into the log, seconds.
    raw_bytes: int = 1_200_000  #: The most that is recorded of one stream.
    encoder: str = "auto"  #: H.264 encoder by FFmpeg's name, or ``auto``.
    #: How far DDS uses multicast between hosts: ``spdp`` (discovery only, as Cyclone DDS does on Wi-Fi, the
    #: paper's network) or ``default`` (data too, on a wired link).
    multicast: str = "spdp"
    seed: int = 0  #: Seed of the frames' path and of the order of cells.

    @classmethod
    def of_profile(cls, profile: str, *, source: str = "photos", seed: int = 0) -> Config:
        """Return the configuration of a profile.

        Args:
            profile: ``smoke`` (seconds), ``quick`` (minutes) or ``paper`` (120 readings of one second).
            source: Source of the colour stream; depth always comes from the stereo pair.
            seed: Seed of everything that is drawn.

        Raises:
            ConfigError: There is no such profile.
        """
        config = of_profile(_PROFILES, profile, seed=seed)
        stages = tuple(replace(s, source=source) if s.codec == "h264" else s for s in config.stages)
        return replace(config, stages=stages)


_ALL = tuple(range(1, 11))
_PROFILES = {
    "smoke": Config(
        profile="smoke",
        stages=(Stage(codec="h264", source="photos", counts=(1, 3), network_counts=(3,)),),
        samples=2,
        period_s=0.5,
        settle_s=0.3,
        raw_s=2.2,
    ),
    "quick": Config(
        profile="quick",
        stages=(
            Stage(codec="h264", source="photos", counts=_ALL, network_counts=(1, 4, 7, 10), repeats=2),
            Stage(codec="rvl", source="stereo", counts=(1, 4, 7), network_counts=(4,)),
        ),
        samples=3,
        period_s=0.7,
    ),
    "paper": Config(
        profile="paper",
        stages=(
            Stage(codec="h264", source="photos", counts=_ALL, network_counts=_ALL),
            Stage(codec="rvl", source="stereo", counts=_ALL, network_counts=_ALL),
        ),
        samples=120,
        period_s=1.0,
        settle_s=2.0,
        raw_s=10.0,
        raw_bytes=20_000_000,
    ),
}
