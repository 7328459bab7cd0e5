"""The rows that the experiment on caches and balanced QoS writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class TableOneRow:
    """One sensor of Table 1 beside the message that every run sends for it."""

    sensor: str  #: Its name.
    type: str  #: ROS type of its message.
    table_bytes: int  #: Size in the paper.
    object_bytes: int  #: Size of the value as a Python object.
    cdr_bytes: int  #: Size of the message on the wire.
    change_s: float  #: Mean time between changes of its value, seconds.


@dataclass(frozen=True, slots=True, kw_only=True)
class CacheRow:
    """What local cache and cache control did with one sensor's readings."""

    sensor: str  #: The sensor.
    rate_hz: int  #: At which it was read.
    silence_s: float  #: Longest silence of the local cache, seconds; 0: none.
    offered: int  #: Readings.
    sent: int  #: Readings that the local cache let pass.
    refreshed: int  #: Those among them that passed because of the silence.
    held_bytes: int  #: Bytes on the wire that were not sent.
    #: Of all readings, sent without a local cache, those that cache control let through to planning.
    planned: int
    planned_after: int  #: The same with a local cache before it.
    join_wait_s: float  #: Mean time that somebody who joins at any time waits for the first value, seconds.


@dataclass(frozen=True, slots=True, kw_only=True)
class StaleRow:
    """How long the station worked with a value that was no longer true, over a link with losses, simulated."""

    qos: str  #: ``best effort`` or ``reliable``.
    silence_s: float  #: Longest silence of the local cache, seconds; 0: none.
    seed: int  #: The seed.
    messages_hz: float  #: Messages a second.
    stale_share: float  #: Share of the time that the station's value was not the sensor's.
    longest_s: float  #: The longest such time, seconds.


@dataclass(frozen=True, slots=True, kw_only=True)
class ShownRow:
    """A change of the sensor's value, or of the value that the station works with, in one example."""

    qos: str  #: As in `StaleRow`.
    silence_s: float  #: As in `StaleRow`.
    where: str  #: ``sensor`` or ``station``.
    t_s: float  #: When, seconds.
    value: int  #: Number of the value from then on.


@dataclass(frozen=True, slots=True, kw_only=True)
class BalanceRow:
    """Eq. 6 solved twice."""

    topics: str  #: Topics of each agent, as text.
    rate_max_hz: int  #: Rmax.
    rate_min_hz: float  #: Rmin.
    weight: float  #: Share of R in the objective.
    solvable: bool  #: Whether CVXPY found an optimum.
    solvable_closed: bool  #: Whether the closed form did.
    rate_hz: float  #: R by CVXPY; NaN without an optimum.
    depth: float  #: D by CVXPY.
    rate_closed_hz: float  #: R by the closed form.
    depth_closed: float  #: D by the closed form.
    why: str  #: Which constraint fails, and by how much.


@dataclass(frozen=True, slots=True, kw_only=True)
class FrontRow:
    """A point of our own problem's Pareto front, or the printed optimum judged alike."""

    method: str  #: ``ours`` or ``printed``.
    rate_max_hz: int  #: Rmax.
    latency_price_hz: float  #: Price of latency; NaN for the printed optimum.
    rate_low_hz: float  #: Rate of the slowest topic.
    rate_high_hz: float  #: Rate of the fastest topic.
    depth_high: int  #: Deepest history.
    utilisation: float  #: Share of the air that is taken; above 1, more than there is.
    freshness: float  #: Share of time in which the value sent last is still true, mean over topics.
    latency_ms: float  #: Mean expected latency; infinite where the air is overloaded.
    up_to_date: float  #: Share of time in which the station has the sensor's value, expected, mean over topics.
    airtime_price: float  #: Shadow price of the air; NaN for the printed optimum.
    chosen: bool  #: Whether it is the point that is used.
