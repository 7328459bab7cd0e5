"""The rows that the experiment on caches and balanced QoS writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["BalanceRow", "CacheRow", "FrontRow", "ShownRow", "StaleRow", "TableOneRow"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TableOneRow:
    """One sensor of Table 1 beside the message that every run sends for it.

    Attributes:
        sensor: Its name.
        type: ROS type of its message.
        table_bytes: Size in the paper.
        object_bytes: Size of the value as a Python object.
        cdr_bytes: Size of the message on the wire.
        change_s: Mean time between changes of its value, seconds.
    """

    sensor: str
    type: str
    table_bytes: int
    object_bytes: int
    cdr_bytes: int
    change_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CacheRow:
    """What local cache and cache control did with one sensor's readings.

    Attributes:
        sensor: The sensor.
        rate_hz: At which it was read.
        silence_s: Longest silence of the local cache, seconds; 0: none.
        offered: Readings.
        sent: Readings that the local cache let pass.
        refreshed: Those among them that passed because of the silence.
        held_bytes: Bytes on the wire that were not sent.
        planned: Of all readings, sent without a local cache, those that cache control let through to planning.
        planned_after: The same with a local cache before it.
        join_wait_s: Mean time that somebody who joins at any time waits for the first value, seconds.
    """

    sensor: str
    rate_hz: int
    silence_s: float
    offered: int
    sent: int
    refreshed: int
    held_bytes: int
    planned: int
    planned_after: int
    join_wait_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StaleRow:
    """How long the station worked with a value that was no longer true, over a link with losses, simulated.

    Attributes:
        qos: ``best effort`` or ``reliable``.
        silence_s: Longest silence of the local cache, seconds; 0: none.
        seed: The seed.
        messages_hz: Messages a second.
        stale_share: Share of the time that the station's value was not the sensor's.
        longest_s: The longest such time, seconds.
    """

    qos: str
    silence_s: float
    seed: int
    messages_hz: float
    stale_share: float
    longest_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ShownRow:
    """A change of the sensor's value, or of the value that the station works with, in one example.

    Attributes:
        qos: As in `StaleRow`.
        silence_s: As in `StaleRow`.
        where: ``sensor`` or ``station``.
        t_s: When, seconds.
        value: Number of the value from then on.
    """

    qos: str
    silence_s: float
    where: str
    t_s: float
    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class BalanceRow:
    """Eq. 6 solved twice.

    Attributes:
        topics: Topics of each agent, as text.
        rate_max_hz: Rmax.
        rate_min_hz: Rmin.
        weight: Share of R in the objective.
        solvable: Whether CVXPY found an optimum.
        solvable_closed: Whether the closed form did.
        rate_hz: R by CVXPY; NaN without an optimum.
        depth: D by CVXPY.
        rate_closed_hz: R by the closed form.
        depth_closed: D by the closed form.
        why: Which constraint fails, and by how much.
    """

    topics: str
    rate_max_hz: int
    rate_min_hz: float
    weight: float
    solvable: bool
    solvable_closed: bool
    rate_hz: float
    depth: float
    rate_closed_hz: float
    depth_closed: float
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class FrontRow:
    """A point of our own problem's Pareto front, or the printed optimum judged alike.

    Attributes:
        method: ``ours`` or ``printed``.
        rate_max_hz: Rmax.
        latency_price_hz: Price of latency; NaN for the printed optimum.
        rate_low_hz: Rate of the slowest topic.
        rate_high_hz: Rate of the fastest topic.
        depth_high: Deepest history.
        utilisation: Share of the air that is taken; above 1, more than there is.
        freshness: Share of time in which the value sent last is still true, mean over topics.
        latency_ms: Mean expected latency; infinite where the air is overloaded.
        up_to_date: Share of time in which the station has the sensor's value, expected, mean over topics.
        airtime_price: Shadow price of the air; NaN for the printed optimum.
        chosen: Whether it is the point that is used.
    """

    method: str
    rate_max_hz: int
    latency_price_hz: float
    rate_low_hz: float
    rate_high_hz: float
    depth_high: int
    utilisation: float
    freshness: float
    latency_ms: float
    up_to_date: float
    airtime_price: float
    chosen: bool
