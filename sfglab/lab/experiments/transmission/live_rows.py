"""Live against simulated, as rows: the same scenario, the same air, the same vendor's timing. Pure.

Asked is a loss within three percentage points and a median latency within 30 %. Where a run did not keep to its
schedules the row says so, and the comparison with it says nothing about the model.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.lab.experiments.transmission.cell import hello_latency_ms
from sfglab.lab.experiments.transmission.scenario import HELLO_DOWN, HELLO_UP

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from sfglab.lab.experiments.transmission.config import Point
    from sfglab.lab.experiments.transmission.live import Played
    from sfglab.rtps import FlowOutcome, Outcome

__all__ = ["GROUPS", "LATENCY_WITHIN", "LOSS_WITHIN", "LiveRow", "Measured", "compare", "measure"]

LOSS_WITHIN = 0.03
LATENCY_WITHIN = 0.30

GROUPS = ("sensors", "hello_up", "hello")
"""All sensors' topics; "Hello" to the station; "Hello" from publication to actuation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """What one group of flows came to.

    Attributes:
        published: Samples.
        loss: Share of them that never arrived; NaN without samples.
        p50_ms: Median latency of those that did; NaN when none did.
    """

    published: int
    loss: float
    p50_ms: float


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveRow:
    """One group of flows of one cell, live and simulated.

    Attributes:
        rate_max_hz: Rmax.
        depth: DEPTH as the grid has it.
        method: The method.
        group: One of `GROUPS`.
        duration_s: How long was published, seconds.
        published: Samples, live.
        loss_live: Share of them that never arrived.
        loss_model: The same in the model, all seeds together.
        p50_live_ms: Median latency.
        p50_model_ms: The same in the model.
        frames: Frames on air, live.
        frames_lost: Those that the radio lost.
        queue_full: Frames that found their sender's queue full.
        air_share: Share of the time that the air was in use.
        kept_up: Whether relay and processes kept to their schedules.
        late_mean_ms: How much later than due the relay delivered, on average.
        delay_ms: What the hosts need themselves, by `Played.delay_s`; the model has it too.
        loss_agrees: Whether the losses differ by no more than `LOSS_WITHIN`.
        latency_agrees: Whether the medians differ by no more than `LATENCY_WITHIN` of the live one.
    """

    rate_max_hz: int
    depth: str
    method: str
    group: str
    duration_s: float
    published: int
    loss_live: float
    loss_model: float
    p50_live_ms: float
    p50_model_ms: float
    frames: int
    frames_lost: int
    queue_full: int
    air_share: float
    kept_up: bool
    late_mean_ms: float
    delay_ms: float
    loss_agrees: bool
    latency_agrees: bool


def measure(outcomes: Sequence[Outcome], group: str) -> Measured:
    """Return what a group came to, in several runs together.

    Args:
        outcomes: Of the model, or of live runs.
        group: One of `GROUPS`.
    """
    if group == "hello":
        published = sum(len(outcome.flows[HELLO_UP].fate) for outcome in outcomes)
        return _measured(published, np.concatenate([hello_latency_ms(outcome) for outcome in outcomes]))
    flows = [flow for outcome in outcomes for flow in _flows(outcome, group)]
    latency_ms = np.concatenate([flow.latency_ns for flow in flows]) / 1e6
    return _measured(sum(len(flow.fate) for flow in flows), latency_ms)


def _flows(outcome: Outcome, group: str) -> list[FlowOutcome]:
    if group == "hello_up":
        return [outcome.flows[HELLO_UP]]
    return [flow for name, flow in outcome.flows.items() if name not in (HELLO_UP, HELLO_DOWN)]


def _measured(published: int, latency_ms: NDArray[np.float64]) -> Measured:
    return Measured(
        published=published,
        loss=1 - len(latency_ms) / published if published else float("nan"),
        p50_ms=float(np.median(latency_ms)) if len(latency_ms) else float("nan"),
    )


def compare(point: Point, played: Played, models: Sequence[Outcome]) -> list[LiveRow]:
    """Return a live cell beside the model's runs of `played.scenario`, a row for each group.

    Args:
        point: The cell.
        played: Live.
        models: The model's runs, with as many seeds as you like.
    """
    return [_row(point, played, group, measure(models, group)) for group in GROUPS]


def _row(point: Point, played: Played, group: str, model: Measured) -> LiveRow:
    live, radio = measure([played.outcome], group), played.radio
    hosts = radio.hosts.values()
    return LiveRow(
        rate_max_hz=point.rate_max_hz,
        depth=point.depth,
        method=point.method,
        group=group,
        duration_s=played.scenario.duration_s,
        published=live.published,
        loss_live=live.loss,
        loss_model=model.loss,
        p50_live_ms=live.p50_ms,
        p50_model_ms=model.p50_ms,
        frames=sum(host.frames for host in hosts),
        frames_lost=radio.lost,
        queue_full=radio.queue_full,
        air_share=sum(host.airtime_s for host in hosts) / radio.elapsed_s if radio.elapsed_s else 0.0,
        kept_up=played.kept_up,
        late_mean_ms=radio.late_mean_s * 1e3,
        delay_ms=played.delay_s * 1e3,
        loss_agrees=abs(live.loss - model.loss) <= LOSS_WITHIN,
        latency_agrees=abs(live.p50_ms - model.p50_ms) <= LATENCY_WITHIN * live.p50_ms,
    )
