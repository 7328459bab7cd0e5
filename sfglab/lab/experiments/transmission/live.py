"""The module `transmission.live` runs cells of the grid live, and validates the model's presets on real DDS.

In the cells of the grid each robot and the station is a host with a process on Cyclone DDS; the radio has the model's
channel. The validation shows how well the presets of `sfglab.rtps` agree with Fast DDS, in nodes of rclpy, and with
Cyclone DDS. Most cells of the validation are one topic between two hosts. The project committed the cells of the
validation (``data/qos/validation.csv``) before the first live run. A third of the cells offers more than the channel
carries, and a third loses 3 % of the frames or more. Cells of kind ``grid`` are cells of Table 2 on Fast DDS. Python
cannot publish faster than `KEPT_HZ` in cells of kind ``grid``. Therefore the experiment divides rates and channel by a
factor, and multiplies the times of nodes and of changes by the factor, but not the 3 s between heartbeats.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.arp.hello import (
    HELLO_DOWN,
    HELLO_UP,
    OPT_DEPTH,
    GridCell,
    hello_latency_ms,
    rate_and_depth,
    scenario_of,
)
from sfglab.arp.robots import METHODS, RATES_HZ
from sfglab.lab.bench import TableRow
from sfglab.lab.cells import run_cells
from sfglab.lab.experiment import seeded
from sfglab.lab.experiments.transmission.experiment import Config, cell_of, exp
from sfglab.lab.live_flows import MODES, LiveHosts, Played, hosts_of, live_hosts, slowed
from sfglab.lab.paths import find_project
from sfglab.qos import QoSProfile
from sfglab.rtps import CYCLONE_DDS, PRESETS, Flow, Medium, Outcome, Scenario, run

if TYPE_CHECKING:
    from contextlib import AbstractAsyncContextManager

    from sfglab.lab.bench import Bench

SENSORS, HELLO_TO_STATION, HELLO = GROUPS = ("sensors", "hello_up", "hello")
"""Groups of flows: sensors' topics; "Hello" to the station; "Hello" from publication to actuation."""
GRID = "grid"  #: Kind of the cells of the validation that are cells of Table 2.
KEPT_HZ = 50  #: Highest Rmax that Python nodes reach.
MODEL_SEEDS = 24  #: Number of the model's runs per cell of the validation.
#: Depth of each reader, so that a Python node that reads late loses no sample.
READER_DEPTH = 5000
DRAIN_S = 7.0  #: Time after the last publication: two heartbeat periods of Fast DDS.
_AT_ONCE = 2  #: Number of live cells at the same time, because nodes mostly wait.
_MEDIUM = ("loss", "queue_frames", "queue_rule", "burst_frames", "access_point")


def measure(outcome: Outcome, group: str) -> tuple[float, float]:
    """Return the loss of one of `GROUPS` and its median latency, ms; NaN without samples."""
    names = [HELLO_UP]
    if group == SENSORS:
        names = [name for name in outcome.flows if name not in (HELLO_UP, HELLO_DOWN)]
    flows = [outcome.flows[name] for name in names]
    latencies = [flow.latency_ns / 1e6 for flow in flows]
    latency_ms = hello_latency_ms(outcome) if group == HELLO else np.concatenate(latencies)
    published = sum(len(flow.fate) for flow in flows)
    loss = 1 - len(latency_ms) / published if published else np.nan
    return loss, float(np.median(latency_ms)) if len(latency_ms) else np.nan


def compare(played: Played, models: list[Outcome], group: str) -> dict[str, Any]:
    """Return the measured columns of a row from a live cell and from the model's runs of the cell."""
    loss, p50_ms = measure(played.outcome, group)
    modelled = [measure(model, group) for model in models]
    model_loss, model_p50_ms = np.median(modelled, axis=0)
    return {
        "loss_live": loss,
        "loss_model": float(model_loss),
        "p50_live_ms": p50_ms,
        "p50_model_ms": float(model_p50_ms),
        "kept_up": played.kept_up,
    }


# --- The grid over the radio ------------------------------------------------------------------


@exp.table("live")
class LiveRow(TableRow):
    """A `LiveRow` is one group of flows of one cell, live and simulated."""

    rate_max_hz: int  #: Rmax, the highest rate of a topic, Hz.
    depth: str  #: DEPTH as in the grid.
    method: str  #: Name of the method.
    group: str  #: One of `GROUPS`.
    duration_s: float  #: Duration of the cell, seconds.
    loss_live: float  #: Share of the samples that never arrived.
    loss_model: float  #: Share of the samples that never arrived in the model, median over seeds.
    p50_live_ms: float  #: Median latency of the samples that arrived, ms.
    #: Median latency of the samples that arrived in the model, median over seeds, ms.
    p50_model_ms: float
    kept_up: bool  #: Whether relay and processes kept their schedules.


def live_cells(config: Config) -> list[GridCell]:
    """Return the grid's cells that also run live between hosts; empty if `live_s` is 0."""
    if not config.live_s:
        return []
    cells = []
    for rate, method in product(config.live_rates_hz, config.live_methods):
        optimum = [OPT_DEPTH] if METHODS[method].optimised else []
        depths = (*config.live_depths, *optimum)
        cells += [cell_of(config, rate, depth, method, config.live_s) for depth in depths]
    return cells


@exp.part(
    "live",
    total=lambda config: len(live_cells(config)),
    timed=False,
)
async def play_grid(bench: Bench[Config]) -> None:
    """Run cells live on Cyclone DDS; the model has the timing of Cyclone DDS here, for every vendor of the run."""
    config = bench.config

    async def play(hosts: LiveHosts, cell: GridCell, _: int) -> dict[str, list[Any]]:
        scenario = scenario_of(cell, seed=config.seed, vendor=CYCLONE_DDS)
        played = await hosts.play(scenario, seed=config.seed)
        models = [run(played.scenario, seed=seed) for seed in seeded(config, config.seeds)]
        of_cell = {name: getattr(cell, name) for name in ("rate_max_hz", "depth", "method")}
        of_cell["duration_s"] = cell.duration_s
        rows = [{**of_cell, "group": g, **compare(played, models, g)} for g in GROUPS]
        return {"live": rows}

    cells = live_cells(config)
    hosts = hosts_of(scenario_of(cells[0])) if cells else ()
    await run_cells(
        bench,
        "live",
        dict.fromkeys(cells, 1),
        stage_of=lambda cell: cells.index(cell) % _AT_ONCE,
        start=lambda _half: live_hosts(*hosts),
        play=play,
        at_once=_AT_ONCE,
    )


# --- Validation of the presets ----------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A `Cell` of the validation is one topic over one channel, or a cell of the grid."""

    preset: str  #: Name of the preset, one of `MODES`.
    kind: str  #: ``saturated``, ``lossy`` or ``calm``; or `GRID`.
    rate_hz: float  #: Publishing rate, Hz; Rmax for a cell of the grid.
    depth: int  #: Depth of the writer's history, samples.
    size_bytes: int = 0  #: Size of a sample in CDR, bytes.
    loss: float = Medium().loss  #: Share of frames that the channel loses.
    overhead_us: int = 0  #: Airtime of a frame in addition to its bits, microseconds.
    queue_frames: int = 0  #: Number of frames that a host's queue holds.
    queue_rule: str = ""  #: Rule of a full queue.
    burst_frames: int = 0  #: Mean length of a burst of losses, frames; 0: independent losses.
    #: Whether frames pass an access point, so that each frame is on air twice.
    access_point: bool = False
    method: str = ""  #: Method of a cell of the grid.
    slowed: float = 1.0  #: Factor by which a cell of the grid runs slower than in the paper.

    def scenario(self, duration_s: float, seed: int = 0) -> Scenario:
        """Return the scenario of the cell, live and simulated."""
        vendor = PRESETS[self.preset]
        if self.kind == GRID:
            cell = GridCell(
                rate_max_hz=int(self.rate_hz),
                depth=str(self.depth),
                method=self.method,
                duration_s=duration_s,
                loss=self.loss,
            )
            scenario = slowed(scenario_of(cell, seed=seed, vendor=vendor), self.slowed)
            return replace(scenario, drain_s=DRAIN_S)
        flow = Flow(
            name="topic",
            source="robot",
            target="station",
            rate_hz=self.rate_hz,
            size_bytes=self.size_bytes,
            qos=QoSProfile(depth=self.depth),
            reader_depth=READER_DEPTH,
        )
        given = {name: getattr(self, name) for name in _MEDIUM}
        medium = Medium(overhead_s=self.overhead_us / 1e6, **given)
        return Scenario(
            flows=(flow,), medium=medium, vendor=vendor, duration_s=duration_s, drain_s=DRAIN_S
        )


@exp.table("validation")
class ValidationRow(Cell):
    """A `ValidationRow` is one cell of the validation, run live once, with the model's results."""

    repeat: int  #: Number of the repetition.
    loss_live: float  #: Share of the samples that never arrived.
    loss_model: float  #: Share of the samples that never arrived in the model, median over seeds.
    p50_live_ms: float  #: Median latency of the samples that arrived, ms.
    #: Median latency of the samples that arrived in the model, median over seeds, ms.
    p50_model_ms: float
    kept_up: bool  #: Whether relay and processes kept their schedules.


def topic_cells() -> list[Cell]:
    """Return the committed cells with one topic each."""
    table = pd.read_csv(find_project().data / "qos" / "validation.csv")
    rows: list[Any] = table.to_dict("records")
    return [Cell(**row) for row in rows]


def grid_cells(config: Config) -> list[Cell]:
    """Return the grid's cells on Fast DDS: optimised methods at the depth of Eq. 6, other methods at several depths."""
    presets = [preset for preset, mode in MODES.items() if mode]
    cells = []
    for preset, rate, method in product(presets, RATES_HZ, config.live_methods):
        depths = (OPT_DEPTH,) if METHODS[method].optimised else config.live_depths
        for depth in depths:
            cell = cell_of(config, rate, depth, method, config.validation_s)
            _, samples = rate_and_depth(cell)
            pace = max(1.0, rate / KEPT_HZ)
            cells.append(
                Cell(
                    preset=preset,
                    kind=GRID,
                    rate_hz=rate,
                    depth=samples,
                    loss=config.loss,
                    method=method,
                    slowed=pace,
                )
            )
    return cells


def validation_cells(config: Config) -> dict[Cell, int]:
    """Return the cells that validate the model, with the number of repetitions of each cell."""
    if not config.validation_repeats:
        return {}
    return dict.fromkeys([*topic_cells(), *grid_cells(config)], config.validation_repeats)


@exp.part(
    "validation",
    total=lambda config: sum(validation_cells(config).values()),
    timed=False,
)
async def validate(bench: Bench[Config]) -> None:
    """Run every cell live, and simulate the cell; presets run at the same time, each on its own hosts."""
    config = bench.config

    async def play(hosts: LiveHosts, cell: Cell, repeat: int) -> dict[str, list[Any]]:
        scenario = cell.scenario(config.validation_s, config.seed)
        played = await hosts.play(scenario, seed=config.seed + repeat)
        models = [run(played.scenario, seed=seed) for seed in seeded(config, MODEL_SEEDS)]
        group = HELLO if cell.kind == GRID else SENSORS
        row = {**asdict(cell), "repeat": repeat, **compare(played, models, group)}
        return {"validation": [row]}

    def stage_of(cell: Cell) -> tuple[str, tuple[str, ...]]:
        return cell.preset, hosts_of(cell.scenario(config.validation_s))

    def start(stage: tuple[str, tuple[str, ...]]) -> AbstractAsyncContextManager[LiveHosts]:
        preset, hosts = stage
        return live_hosts(*hosts, ros=MODES[preset])

    await run_cells(
        bench,
        "validation",
        validation_cells(config),
        stage_of=stage_of,
        start=start,
        play=play,
        at_once=len(MODES),
    )
