"""The grid's live cells beside the model: "Hello" and the sensors' topics on real DDS over the model's air.

Asked is a loss within three percentage points and a median latency within 30 %. Where a run did not keep to its
schedules the row says so, and the comparison says nothing about the model.
"""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.hello import (
    HELLO_DOWN,
    HELLO_UP,
    OPT_DEPTH,
    GridCell,
    hello_latency_ms,
    scenario_of,
)
from sfglab.arp.robots import METHODS
from sfglab.component import beside
from sfglab.lab.bench import Bench, as_row
from sfglab.lab.experiment import SkippedPartError, seeded
from sfglab.lab.experiments.transmission.experiment import (
    Config,
    cells_of,
    exp,
)
from sfglab.lab.hosts import HostsUnavailableError
from sfglab.lab.live_flows import Played, hosts_of, live_hosts
from sfglab.rtps import CYCLONE_DDS, Outcome, run

if TYPE_CHECKING:
    from collections.abc import Sequence

LOSS_WITHIN = 0.03
LATENCY_WITHIN = 0.30
_AT_ONCE = 2  #: Cells that are played beside each other: their nodes mostly wait.

GROUPS = ("sensors", "hello_up", "hello")
"""All sensors' topics; "Hello" to the station; "Hello" from publication to actuation."""


@exp.table("live")
class LiveRow:
    """One group of flows of one cell, live and simulated."""

    rate_max_hz: int  #: Rmax.
    depth: str  #: DEPTH as the grid has it.
    method: str  #: The method.
    group: str  #: One of `GROUPS`.
    duration_s: float  #: How long was published, seconds.
    published: int  #: Samples, live.
    loss_live: float  #: Share of them that never arrived.
    loss_model: float  #: The same in the model, median of its seeds.
    p50_live_ms: float  #: Median latency.
    p50_model_ms: float  #: The same in the model, median of its seeds.
    frames: int  #: Frames on air, live.
    frames_lost: int  #: Those that the radio lost.
    queue_full: int  #: Frames that found their sender's queue full.
    air_share: float  #: Share of the time that the air was in use.
    kept_up: bool  #: Whether relay and processes kept to their schedules.
    late_mean_ms: float  #: How much later than due the relay delivered, on average.
    delay_ms: float  #: What the hosts need themselves, by `Played.delay_s`; the model has it too.
    loss_agrees: bool  #: Whether the losses differ by no more than `LOSS_WITHIN`.
    #: Whether the medians differ by no more than `LATENCY_WITHIN` of the live one.
    latency_agrees: bool


def live_cells(config: Config) -> list[GridCell]:
    """Return the cells that are run live as well; an optimised method has the depth ``opt`` in addition.

    Live endpoints are those of Cyclone DDS, whose timing the model then has, whatever the run's vendor.
    """
    if not config.live_s:
        return []
    cell = cells_of(config)
    return [
        cell(rate_max_hz=rate, depth=depth, method=method, duration_s=config.live_s)
        for rate in config.live_rates_hz
        for method in config.live_methods
        for depth in (*config.live_depths, *((OPT_DEPTH,) if METHODS[method].optimised else ()))
    ]


@exp.part(
    "live",
    total=lambda config: len(live_cells(config)),
    skips=(HostsUnavailableError,),
    timed=False,
)
async def play_cells(bench: Bench[Config]) -> None:
    """Play cells live, two at once on hosts and air of their own, each beside the model with all seeds."""
    config = bench.config
    scenarios = {
        cell: scenario_of(cell, seed=config.seed, vendor=CYCLONE_DDS) for cell in live_cells(config)
    }
    if not scenarios:
        raise SkippedPartError("not asked for")
    waiting, rows = deque(scenarios), dict[GridCell, list[LiveRow]]()

    async def play() -> None:
        async with live_hosts(*hosts_of(scenarios[waiting[0]])) as hosts:
            while waiting:
                cell = waiting.popleft()
                played = await hosts.play(scenarios[cell], seed=config.seed)
                models = [run(played.scenario, seed=seed) for seed in seeded(config, config.seeds)]
                rows[cell] = compare(cell, played, models)
                bench.advance(f"{cell.method}, {cell.rate_max_hz} Hz, depth {cell.depth}")

    async with beside(*(play() for _ in range(min(_AT_ONCE, len(scenarios))))) as players:
        await asyncio.gather(*players)
    for cell in scenarios:
        bench.write_all("live", rows[cell])
    bench.metadata("live", {"hindrance": ""})


def measure(outcome: Outcome, group: str) -> dict[str, Any]:
    """Return what one of `GROUPS` came to.

    Returns:
        ``published`` samples, the ``loss`` among them, and the median latency ``p50_ms`` of those that arrived;
        NaN where there is nothing to say it of.
    """
    names = [HELLO_UP]
    if group == "sensors":
        names = [name for name in outcome.flows if name not in (HELLO_UP, HELLO_DOWN)]
    flows = [outcome.flows[name] for name in names]
    if group == "hello":
        latency_ms = hello_latency_ms(outcome)
    else:
        latency_ms = np.concatenate([flow.latency_ns for flow in flows]) / 1e6
    published = sum(len(flow.fate) for flow in flows)
    return {
        "published": published,
        "loss": 1 - len(latency_ms) / published if published else float("nan"),
        "p50_ms": float(np.median(latency_ms)) if len(latency_ms) else float("nan"),
    }


def compare(point: GridCell, played: Played, models: Sequence[Outcome]) -> list[LiveRow]:
    """Return a live cell beside the model's runs of `played.scenario`, a row for each of `GROUPS`."""
    radio, hosts = played.radio, played.radio.hosts.values()
    shared = {
        "duration_s": played.scenario.duration_s,
        "frames": sum(host.frames for host in hosts),
        "frames_lost": radio.lost,
        "queue_full": radio.queue_full,
        "air_share": sum(host.airtime_s for host in hosts) / radio.elapsed_s
        if radio.elapsed_s
        else 0.0,
        "kept_up": played.kept_up,
        "late_mean_ms": radio.late_mean_s * 1e3,
        "delay_ms": played.delay_s * 1e3,
    }
    groups = ({**shared, "group": group, **compared(played, models, group)} for group in GROUPS)
    return [as_row(LiveRow, row, point) for row in groups]


def compared(played: Played, models: Sequence[Outcome], group: str) -> dict[str, Any]:
    """Return what one of `GROUPS` came to, live and in the model's median run, and whether that agrees."""
    live, runs = measure(played.outcome, group), [measure(model, group) for model in models]
    loss, p50_ms = (float(np.median([run[name] for run in runs])) for name in ("loss", "p50_ms"))
    return {
        "published": live["published"],
        "loss_live": live["loss"],
        "loss_model": loss,
        "p50_live_ms": live["p50_ms"],
        "p50_model_ms": p50_ms,
        "loss_agrees": abs(live["loss"] - loss) <= LOSS_WITHIN,
        "latency_agrees": abs(live["p50_ms"] - p50_ms) <= LATENCY_WITHIN * live["p50_ms"],
    }
