"""The rows that the transmission experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class TransmissionRow:
    """One cell of the grid with one seed, simulated.

    "Hello" goes up to the station and down to the robot; what is lost is counted where it was lost.
    """

    rate_max_hz: int  #: Rmax.
    depth: str  #: DEPTH as the grid has it.
    method: str  #: The method.
    seed: int  #: The seed.
    rate_hz: float  #: At which each topic was published.
    history_depth: int  #: Samples of each history.
    published: int  #: "Hello"s that were published.
    arrived: int  #: Those that reached the actuation node.
    latency_p50_ms: float  #: Median time from publication to actuation of those; NaN when none arrived.
    latency_mean_ms: float  #: Mean of it.
    latency_p95_ms: float  #: 95th percentile of it.
    lost_medium: int  #: Lost on air, and overwritten in the writer's history before it was repaired.
    lost_queue: int  #: Dropped by a sender's full queue, and overwritten before it was repaired.
    lost_late: int  #: Arrived, and pushed out of the reader's history before the node took it.
    lost_underway: int  #: Neither there nor given up when time was over.
    deadlines_missed: int  #: How often the station waited beyond the deadline for the next "Hello".
    sensor_values: int  #: Values that the sensing nodes read.
    sensor_held: int  #: Those that local caches held back.
    sensor_published: int  #: Those that were published.
    sensor_delivered: int  #: Those that planning nodes had.
    planned: int  #: Messages that cost the station its full time.
    compared: int  #: Messages that cache control discarded.
    data: int  #: DATA frames, repairs included.
    heartbeats: int  #: HEARTBEAT frames.
    acknacks: int  #: ACKNACK frames.
    repeated: int  #: DATA frames that repair.
    queue_full: int  #: Frames that found their sender's queue full.
    air_share: float  #: Share of the time that the air was in use while messages were published.


@dataclass(frozen=True, slots=True, kw_only=True)
class BeyondRow:
    """One way to choose rates and depths, the printed problem's or our own, with one seed, simulated."""

    rate_max_hz: int  #: Rmax.
    way: str  #: One of `beyond.WAYS`.
    seed: int  #: The seed.
    rate_low_hz: float  #: Rate of the slowest topic.
    rate_high_hz: float  #: Rate of the fastest topic.
    depth_high: int  #: Deepest history.
    latency_p50_ms: float  #: Median time of "Hello" from publication to actuation; NaN when none arrived.
    latency_p95_ms: float  #: 95th percentile of it.
    loss: float  #: Share of "Hello"s lost.
    #: Share of time in which the station has the value that a sensor has now, mean over sensors.
    up_to_date: float
    air_share: float  #: Share of the time that the air was in use.
