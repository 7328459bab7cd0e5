"""The printed problem against our own: which choice of rates and depths serves the station better. Simulated.

What serves is the share of time in which the station has the value that a sensor has now, beside latency and
loss of "Hello": a slow topic is late with news, a crowded air is late with everything. The same air, seeds and
sensors for all ways.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from sfglab.arp.programme import plan
from sfglab.arp.topics import Topic
from sfglab.lab.experiments.transmission.cell import hello_latency_ms
from sfglab.lab.experiments.transmission.config import OPT_DEPTH, Point
from sfglab.lab.experiments.transmission.rows import BeyondRow
from sfglab.lab.experiments.transmission.scenario import HELLO_DOWN, HELLO_UP, scenario_of
from sfglab.rtps import run

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.arp.plan import Plan
    from sfglab.lab.experiments.transmission.config import Config
    from sfglab.rtps import Flow, FlowOutcome, Scenario


WAYS = {
    "none": ("none", "10"),
    "LC": ("LC", "10"),
    "OPT": ("OPT", OPT_DEPTH),
    "OPT+LC": ("OPT+LC", OPT_DEPTH),
    "own": ("none", "10"),
    "own+LC": ("LC", "10"),
}
"""Method and depth that each way begins with; ``own`` then has the rates and depths of our programme."""

HELLO_CHANGE_S = 0.1
"""How often there is something new to say hello with, for the plan: ten times a second, as the LIDAR turns."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """A cell of the comparison: a task's point."""

    rate_max_hz: int  #: Rmax.
    name: str  #: One of `WAYS`.
    duration_s: float  #: Simulated seconds.


def ways(config: Config) -> list[Way]:
    """Return every way at every Rmax."""
    return [
        Way(rate_max_hz=rate, name=name, duration_s=config.duration_s)
        for rate in config.rates_hz
        for name in WAYS
    ]


def simulate_way(way: Way, seed: int) -> BeyondRow:
    """Run one way with one seed: the task of a sweep."""
    method, depth = WAYS[way.name]
    point = Point(rate_max_hz=way.rate_max_hz, depth=depth, method=method, duration_s=way.duration_s)
    scenario = scenario_of(point, seed=seed)
    if way.name.startswith("own"):
        scenario = _planned(scenario, own_plan(way.rate_max_hz, cached=way.name == "own+LC"))
    outcome = run(scenario, seed=seed)
    latency = hello_latency_ms(outcome)
    sensors = [f for f in scenario.flows if f.change_s]
    rates = [f.rate_hz for f in scenario.flows if f.rate_hz]
    nan = float("nan")
    return BeyondRow(
        rate_max_hz=way.rate_max_hz,
        way=way.name,
        seed=seed,
        rate_low_hz=min(rates),
        rate_high_hz=max(rates),
        depth_high=max(f.qos.depth for f in scenario.flows),
        latency_p50_ms=float(np.median(latency)) if len(latency) else nan,
        latency_p95_ms=float(np.percentile(latency, 95)) if len(latency) else nan,
        loss=1 - len(latency) / len(outcome.flows[HELLO_UP].fate),
        up_to_date=float(
            np.mean([up_to_date(f, outcome.flows[f.name], duration_s=scenario.duration_s) for f in sensors])
        ),
        air_share=outcome.counts["airtime_ns"] / ((scenario.duration_s + scenario.drain_s) * 1e9),
    )


@lru_cache
def own_plan(rate_max_hz: int, *, cached: bool = False) -> Plan:
    """Return our programme's rates and depths for this experiment's topics.

    Args:
        rate_max_hz: No topic is faster.
        cached: Whether local caches send only changes; rates then are those of reading.
    """
    method = "LC" if cached else "none"
    point = Point(rate_max_hz=rate_max_hz, depth="1", method=method, duration_s=1.0)
    scenario = scenario_of(point)
    topics = [
        Topic(
            name=flow.name,
            source=flow.source,
            target=flow.target,
            size_bytes=flow.size_bytes,
            rate_max_hz=float(rate_max_hz),
            change_s=flow.change_s or HELLO_CHANGE_S,
            cached=flow.cached,
        )
        for flow in scenario.flows
    ]
    return plan(topics, scenario.medium, scenario.vendor)


def _planned(scenario: Scenario, chosen: Plan) -> Scenario:
    return replace(scenario, flows=tuple(_planned_flow(flow, chosen) for flow in scenario.flows))


def _planned_flow(flow: Flow, chosen: Plan) -> Flow:
    """Give a flow its planned rate; its phase keeps its share of the period. The answer follows "Hello"."""
    qos = chosen.qos(flow.name)
    if flow.name == HELLO_DOWN:
        return replace(flow, qos=qos)
    rate_hz = chosen[flow.name].rate_hz
    return replace(flow, qos=qos, rate_hz=rate_hz, phase_s=flow.phase_s * flow.rate_hz / rate_hz)


def up_to_date(flow: Flow, outcome: FlowOutcome, *, duration_s: float) -> float:
    """Return the share of time in which the reader has the value that the sensor has now.

    At a reading the sensor's value is known: that of the last sample published, held back or not. Until the
    next reading it stays with probability exp(-t / change_s), as changes come at random; that is integrated.

    Args:
        flow: The flow, with its schedule of readings.
        outcome: What became of its samples.
        duration_s: Over which time, seconds.
    """
    # In whole nanoseconds, as the model schedules: rounding adds up, and a reading must not precede its sample.
    first_ns, period_ns = round(flow.phase_s * 1e9), round(1e9 / flow.rate_hz)
    readings = np.arange(first_ns, round(duration_s * 1e9), period_ns) / 1e9
    received = outcome.received_ns[outcome.delivered] / 1e9
    times = np.unique(np.concatenate([readings, received[received < duration_s], [duration_s]]))
    starts, ends = times[:-1], times[1:]
    read_at = readings[np.maximum(np.searchsorted(readings, starts, side="right") - 1, 0)]
    # Nanoseconds are rounded where the model schedules; half of one is far below any period.
    published = outcome.published_ns / 1e9 - 1e-9
    true = _last(outcome.value, published, read_at)
    known = _last(outcome.value[outcome.delivered], received, starts)
    since, until = starts - read_at, ends - read_at
    stays = flow.change_s * (np.exp(-since / flow.change_s) - np.exp(-until / flow.change_s))
    return float(stays[(true == known) & (known >= 0)].sum() / duration_s)


def _last(values: NDArray[np.int32], since: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the value at each time; -1 before the first."""
    place = np.searchsorted(since, at, side="right") - 1
    if not len(values):
        return np.full(len(at), -1)
    return np.where(place >= 0, values[place], -1)
