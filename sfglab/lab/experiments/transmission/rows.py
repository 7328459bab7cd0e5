"""The rows that the transmission experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["BeyondRow", "TransmissionRow"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TransmissionRow:
    """One cell of the grid with one seed, simulated.

    "Hello" goes up to the station and down to the robot; what is lost is counted where it was lost.

    Attributes:
        rate_max_hz: Rmax.
        depth: DEPTH as the grid has it.
        method: The method.
        seed: The seed.
        rate_hz: At which each topic was published.
        history_depth: Samples of each history.
        published: "Hello"s that were published.
        arrived: Those that reached the actuation node.
        latency_p50_ms: Median time from publication to actuation of those; NaN when none arrived.
        latency_mean_ms: Mean of it.
        latency_p95_ms: 95th percentile of it.
        lost_medium: Lost on air, and overwritten in the writer's history before it was repaired.
        lost_queue: Dropped by a sender's full queue, and overwritten before it was repaired.
        lost_late: Arrived, and pushed out of the reader's history before the node took it.
        lost_underway: Neither there nor given up when time was over.
        deadlines_missed: How often the station waited beyond the deadline for the next "Hello".
        sensor_values: Values that the sensing nodes read.
        sensor_held: Those that local caches held back.
        sensor_published: Those that were published.
        sensor_delivered: Those that planning nodes had.
        planned: Messages that cost the station its full time.
        compared: Messages that cache control discarded.
        data: DATA frames, repairs included.
        heartbeats: HEARTBEAT frames.
        acknacks: ACKNACK frames.
        repeated: DATA frames that repair.
        queue_full: Frames that found their sender's queue full.
        air_share: Share of the time that the air was in use while messages were published.
    """

    rate_max_hz: int
    depth: str
    method: str
    seed: int
    rate_hz: float
    history_depth: int
    published: int
    arrived: int
    latency_p50_ms: float
    latency_mean_ms: float
    latency_p95_ms: float
    lost_medium: int
    lost_queue: int
    lost_late: int
    lost_underway: int
    deadlines_missed: int
    sensor_values: int
    sensor_held: int
    sensor_published: int
    sensor_delivered: int
    planned: int
    compared: int
    data: int
    heartbeats: int
    acknacks: int
    repeated: int
    queue_full: int
    air_share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class BeyondRow:
    """One way to choose rates and depths, the printed problem's or our own, with one seed, simulated.

    Attributes:
        rate_max_hz: Rmax.
        way: One of `beyond.WAYS`.
        seed: The seed.
        rate_low_hz: Rate of the slowest topic.
        rate_high_hz: Rate of the fastest topic.
        depth_high: Deepest history.
        latency_p50_ms: Median time of "Hello" from publication to actuation; NaN when none arrived.
        latency_p95_ms: 95th percentile of it.
        loss: Share of "Hello"s lost.
        up_to_date: Share of time in which the station has the value that a sensor has now, mean over sensors.
        air_share: Share of the time that the air was in use.
    """

    rate_max_hz: int
    way: str
    seed: int
    rate_low_hz: float
    rate_high_hz: float
    depth_high: int
    latency_p50_ms: float
    latency_p95_ms: float
    loss: float
    up_to_date: float
    air_share: float
