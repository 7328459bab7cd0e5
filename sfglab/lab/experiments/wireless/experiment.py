"""Configuration, channels and tables of the experiment on a radio that loses frames."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import get_args

from sfglab.fields import between
from sfglab.lab.bench import TableRow
from sfglab.lab.experiment import Experiment, Profiled
from sfglab.lab.workers.radio_end import Way
from sfglab.rtps import Medium

WAYS: tuple[Way, ...] = get_args(Way)
CALM = Medium(loss=0.0)  #: Radio with 20 Mbit/s and 0.3 ms per frame, without loss.
AWAY = replace(CALM, loss=1 - 1e-9)  #: Radio that loses all frames.
INDEPENDENT, BURSTS, FALLING, OUTAGE = "20 % loss", "bursts", "falling rate", "outage"
MEDIA: dict[str, tuple[Medium, ...]] = {
    "no loss": (CALM,),
    "1 % loss": (replace(CALM, loss=0.01),),
    "5 % loss": (replace(CALM, loss=0.05),),
    INDEPENDENT: (replace(CALM, loss=0.2),),
    FALLING: tuple(replace(CALM, rate_bps=rate) for rate in (1e6, 200e3, 50e3)),
    BURSTS: (*(CALM,) * 4, AWAY) * 3,
    OUTAGE: (CALM, AWAY, CALM),
}
"""Media of a channel, which follow each other for equal times.

In bursts all frames of a fifth of the time are lost. Bursts are counted in time, because a burst of a number of frames
would last longer for a sender that backs off.
"""
CHANNELS = ("no loss", "5 % loss", INDEPENDENT, BURSTS, FALLING)  #: Channels for samples.
VIDEO_CHANNELS = ("1 % loss", OUTAGE)  #: Channels for a camera's stream.
FROZEN_S = 0.1  #: Time after which a picture is frozen, s: three periods of the camera.
BEFORE_S = 1.0  #: Time before an outage, s.


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """Times, outages and repetitions."""

    repeats: int = between(4, 1)  #: Repetitions of each channel with samples.
    channel_s: float = between(3.0, 0.3)  #: Duration of a channel, s.
    outages_s: tuple[float, ...] = (1.0, 10.0, 15.0)  #: Durations of outages, s. The lease is 10 s.
    #: Repetitions of each outage, and of each channel with a camera's stream.
    outage_repeats: int = between(3, 1)
    after_s: float = between(8.0, 0.5)  #: Time after an outage in which recovery is observed, s.
    ways: tuple[Way, ...] = WAYS  #: Middlewares and transports.
    seed: int = 0  #: Seed of the first repetition's losses.


exp = Experiment(
    "wireless",
    Config,
    where="A 4.3",
    smoke={
        "repeats": 1,
        "channel_s": 0.6,
        "outages_s": (0.5,),
        "outage_repeats": 1,
        "after_s": 0.5,
        "ways": ("dds_reliable", "dds_best_effort", "zenoh_quic"),
    },
    paper={
        "repeats": 40,
        "outages_s": (1.0, 5.0, 10.0, 15.0, 30.0),
        "outage_repeats": 10,
        "after_s": 20.0,
    },
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A channel, or an outage, on one way."""

    way: Way  #: Middleware and transport.
    channel: str  #: One of `CHANNELS` or `VIDEO_CHANNELS`.
    #: Duration of an outage around which recovery is observed, s; 0 for none.
    outage_s: float = 0.0
    requests: bool = False  #: Whether the station requests a key frame after a loss.

    def steps(self, config: Config) -> list[tuple[Medium, float]]:
        """Return the media that follow each other, each with its time, s."""
        if self.outage_s:
            return [(CALM, BEFORE_S), (AWAY, self.outage_s), (CALM, config.after_s)]
        media = MEDIA[self.channel]
        return [(medium, config.channel_s / len(media)) for medium in media]


def sample_cells(config: Config) -> dict[Cell, int]:
    """Return the cells with samples, and their repetitions."""
    cells = {}
    for channel, way in product(CHANNELS, config.ways):
        cells[Cell(way=way, channel=channel)] = config.repeats
    for outage_s, way in product(config.outages_s, config.ways):
        cells[Cell(way=way, channel=OUTAGE, outage_s=outage_s)] = config.outage_repeats
    return cells


def video_cells(config: Config) -> dict[Cell, int]:
    """Return the cells with a camera's stream, and their repetitions."""
    cells = {}
    for channel, requests, way in product(VIDEO_CHANNELS, (False, True), config.ways):
        cells[Cell(way=way, channel=channel, requests=requests)] = config.outage_repeats
    return cells


@exp.table("samples", "video")
class RadioRow(TableRow):
    """One cell. Times of recovery are NaN if they exceed the time that is observed."""

    way: str  #: One of `WAYS`.
    channel: str  #: One of `CHANNELS` or `VIDEO_CHANNELS`.
    outage_s: float  #: Duration of an outage around which recovery is observed, s; 0 for none.
    requests: bool  #: Whether the station requests a key frame after a loss.
    repeat: int  #: Number of the repetition, which determines the seed.
    age_p95_ms: float  #: 95th percentile over time of the age of the newest sample, ms.
    latency_p99_ms: float  #: 99th percentile of the latency of the samples that arrived, ms.
    flows_s: float  #: Time from the last change of the medium until a fresh sample arrived, s.
    #: The same for the latched value that was published in the middle of an outage, s.
    latched_s: float
    whole_s: float  #: The same until both agents are present, s; 0 if none was lost.
    #: Number of agents that were announced as lost, although they sent heartbeats.
    false_losses: int
    #: Share of the time in which a picture has been shown for longer than `FROZEN_S`; NaN without a camera.
    frozen: float
    kept_up: bool  #: Whether the relay of the radio was fast enough.


@exp.table("trace")
class TraceRow(TableRow):
    """Age of the newest sample at one time around an outage."""

    way: str  #: One of `WAYS`.
    outage_s: float  #: Duration of the outage, s.
    repeat: int  #: Number of the repetition.
    t_s: float  #: Time since the beginning of the outage, s.
    age_s: float  #: Age of the newest sample, s.
