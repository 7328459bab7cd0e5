"""One cell, simulated: a point and a seed in, a row out; the task of the sweep. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.transmission.rows import TransmissionRow
from sfglab.lab.experiments.transmission.scenario import HELLO_DOWN, HELLO_UP, rate_and_depth, scenario_of
from sfglab.rtps import Drop, Fate, run

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from sfglab.lab.experiments.transmission.config import Point
    from sfglab.rtps import FlowOutcome, Outcome, Scenario


def simulate_cell(point: Point, seed: int) -> TransmissionRow:
    """Run one cell with one seed."""
    scenario = scenario_of(point, seed=seed)
    return row_of(point, seed, scenario, run(scenario, seed=seed))


def hello_latency_ms(outcome: Outcome) -> NDArray[np.float64]:
    """Return the time of each "Hello" from publication to actuation, shape (arrived,)."""
    up, down = outcome.flows[HELLO_UP], outcome.flows[HELLO_DOWN]
    arrived = down.value[down.delivered]
    place = np.searchsorted(up.value, arrived)
    return (down.received_ns[down.delivered] - up.published_ns[place]) / 1e6


def hello_losses(outcome: Outcome) -> dict[str, int]:
    """Return where "Hello"s were lost, up and down together, by `TransmissionRow`'s names."""
    totals = dict.fromkeys(("lost_medium", "lost_queue", "lost_late", "lost_underway"), 0)
    for flow in (outcome.flows[HELLO_UP], outcome.flows[HELLO_DOWN]):
        for name, lost in _losses(flow).items():
            totals[name] += int(lost.sum())
    return totals


def _losses(flow: FlowOutcome) -> dict[str, NDArray[np.bool_]]:
    overwritten = np.equal(flow.fate, Fate.OVERWRITTEN)
    return {
        "lost_medium": overwritten & np.equal(flow.dropped, Drop.MEDIUM),
        "lost_queue": overwritten & np.equal(flow.dropped, Drop.QUEUE),
        "lost_late": np.equal(flow.fate, Fate.LATE),
        "lost_underway": np.equal(flow.fate, Fate.UNDERWAY),
    }


def row_of(point: Point, seed: int, scenario: Scenario, outcome: Outcome) -> TransmissionRow:
    """Return what a finished run came to.

    Args:
        point: The cell.
        seed: The seed.
        scenario: What was run.
        outcome: What it came to.
    """
    rate_hz, depth = rate_and_depth(point)
    latency = hello_latency_ms(outcome)
    up = outcome.flows[HELLO_UP]
    sensors = [f for name, f in outcome.flows.items() if name not in (HELLO_UP, HELLO_DOWN)]
    published = sum(len(f.fate) for f in sensors)
    counts = outcome.counts
    return TransmissionRow(
        rate_max_hz=point.rate_max_hz,
        depth=point.depth,
        method=point.method,
        seed=seed,
        rate_hz=rate_hz,
        history_depth=depth,
        published=len(up.fate),
        arrived=len(latency),
        latency_p50_ms=_over(np.median, latency),
        latency_mean_ms=_over(np.mean, latency),
        latency_p95_ms=_over(lambda a: np.percentile(a, 95), latency),
        **hello_losses(outcome),
        deadlines_missed=up.deadlines_missed(),
        sensor_values=published + counts["held"],
        sensor_held=counts["held"],
        sensor_published=published,
        sensor_delivered=sum(int(f.delivered.sum()) for f in sensors),
        planned=counts["processed"],
        compared=counts["compared"],
        data=counts["data"],
        heartbeats=counts["heartbeat"],
        acknacks=counts["acknack"],
        repeated=counts["repeated"],
        queue_full=counts["queue_full"],
        air_share=counts["airtime_ns"] / ((scenario.duration_s + scenario.drain_s) * 1e9),
    )


def _over(statistic: Callable[[NDArray[np.float64]], Any], values: NDArray[np.float64]) -> float:
    return float(statistic(values)) if len(values) else float("nan")
