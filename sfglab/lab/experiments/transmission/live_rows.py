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


LOSS_WITHIN = 0.03
LATENCY_WITHIN = 0.30

GROUPS = ("sensors", "hello_up", "hello")
"""All sensors' topics; "Hello" to the station; "Hello" from publication to actuation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """What one group of flows came to."""

    published: int  #: Samples.
    loss: float  #: Share of them that never arrived; NaN without samples.
    p50_ms: float  #: Median latency of those that did; NaN when none did.


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveRow:
    """One group of flows of one cell, live and simulated."""

    rate_max_hz: int  #: Rmax.
    depth: str  #: DEPTH as the grid has it.
    method: str  #: The method.
    group: str  #: One of `GROUPS`.
    duration_s: float  #: How long was published, seconds.
    published: int  #: Samples, live.
    loss_live: float  #: Share of them that never arrived.
    loss_model: float  #: The same in the model, all seeds together.
    p50_live_ms: float  #: Median latency.
    p50_model_ms: float  #: The same in the model.
    frames: int  #: Frames on air, live.
    frames_lost: int  #: Those that the radio lost.
    queue_full: int  #: Frames that found their sender's queue full.
    air_share: float  #: Share of the time that the air was in use.
    kept_up: bool  #: Whether relay and processes kept to their schedules.
    late_mean_ms: float  #: How much later than due the relay delivered, on average.
    delay_ms: float  #: What the hosts need themselves, by `Played.delay_s`; the model has it too.
    loss_agrees: bool  #: Whether the losses differ by no more than `LOSS_WITHIN`.
    latency_agrees: bool  #: Whether the medians differ by no more than `LATENCY_WITHIN` of the live one.


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
