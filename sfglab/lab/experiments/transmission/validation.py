"""Validation of the model beside real DDS: of the presets of RTPS, and of the grid of paper B on real Fast DDS.

Of the presets, it is one topic between two hosts, in cells that were committed (``data/qos/validation.csv``)
before the first was played: a third offers more than the air carries, a third loses three percent of the frames
or more, each with every depth. A cell whose runs differ by more than what is asked is played several times. Its
log, ``transmission_ros2.mcap``, counts beside a reference without it.

Of the grid, it is the cells that decide its questions, with rclpy nodes in both modes. What is faster than
`KEPT_HZ`, which Python keeps, runs slowed: rates and the air's rate are divided by one factor, the cost of a
frame, times of nodes and of changes multiplied by it, but not the 3 s between heartbeats.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.arp.hello import OPT_DEPTH, GridCell, scenario_of
from sfglab.arp.robots import METHODS, RATES_HZ
from sfglab.lab.baselines import PART, beside
from sfglab.lab.experiment import seeded
from sfglab.lab.experiments.transmission.experiment import (
    Config,
    cells_of,
    exp,
)
from sfglab.lab.experiments.transmission.stage import (
    LATENCY_WITHIN,
    LOSS_WITHIN,
    LiveRow,
    compare,
    compared,
    measure,
)
from sfglab.lab.live_flows import MODES, LiveHosts, cells_part, play_missing, slowed
from sfglab.lab.paths import find_project
from sfglab.lab.runs import Run, derived
from sfglab.qos import QoSProfile
from sfglab.rtps import PRESETS, Flow, Medium, Scenario, run

if TYPE_CHECKING:
    from collections.abc import Mapping

    from sfglab.lab.bench import Bench


TABLE = "validation"
MODEL_SEEDS = 24
#: Share of draws in which the median of a cell's repetitions has to agree with that of all seeds.
SURE = 0.95
READER_DEPTH = 5000
"""Of every reader, so that a node of Python that looks late loses nothing: the writer's history is asked."""
READ = {"fast_dds_foxy": "read in its sources, not measured"}
"""Presets that cannot be validated, and what they are instead."""
_DRAWS = 400
KEPT_LEAST = 0.8  #: Share of the cells that is asked to keep its schedule.

MEDIUM = ("loss", "queue_frames", "queue_rule", "burst_frames", "access_point")
"""Columns of a cell that are `Medium`'s; others are ``preset``, ``kind``, ``overhead_us`` and the topic's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """One topic over one air, as the committed table has it."""

    preset: str  #: One of `MODES`.
    kind: str  #: ``saturated``, ``lossy`` or ``calm``.
    rate_hz: float  #: At which it is published.
    depth: int  #: Of the writer's history.
    size_bytes: int  #: Of a sample, in CDR.
    loss: float  #: Share of frames lost.
    overhead_us: int  #: Airtime of a frame beside its bits, microseconds.
    queue_frames: int  #: Frames that a host's queue holds.
    queue_rule: str  #: What a full one does.
    burst_frames: int  #: Mean length of a burst of losses; 0: each by itself.
    access_point: bool  #: Whether frames are on air twice.


@exp.table(TABLE)
class ValidationRow(Cell):
    """One cell, played once, beside the model."""

    repeat: int  #: Which time.
    published: int  #: Samples, live.
    loss_live: float  #: Share of them that never arrived.
    loss_model: float  #: The same in the model, median of its seeds.
    p50_live_ms: float  #: Median latency.
    p50_model_ms: float  #: The same in the model, median of its seeds.
    loss_agrees: bool  #: Whether the losses differ by no more than `LOSS_WITHIN`.
    #: Whether the medians differ by no more than `LATENCY_WITHIN` of the live one.
    latency_agrees: bool
    kept_up: bool  #: Whether relay and processes kept to their schedules.


def committed_cells() -> list[Cell]:
    """Return the committed cells."""
    table: Any = pd.read_csv(find_project().root / "data" / "qos" / "validation.csv").to_dict(
        "records"
    )
    return [Cell(**row) for row in table]


def scenario_of_cell(
    cell: Mapping[str, Any], *, duration_s: float, drain_s: float = 7.0
) -> Scenario:
    """Return a cell as what is played and simulated; by default two heartbeats of Fast DDS come afterwards."""
    flow = Flow(
        name="topic",
        source="robot",
        target="station",
        rate_hz=cell["rate_hz"],
        size_bytes=cell["size_bytes"],
        qos=QoSProfile(depth=cell["depth"]),
        reader_depth=READER_DEPTH,
    )
    medium = Medium(overhead_s=cell["overhead_us"] / 1e6, **{name: cell[name] for name in MEDIUM})
    vendor = PRESETS[cell["preset"]]
    return Scenario(
        flows=(flow,), medium=medium, vendor=vendor, duration_s=duration_s, drain_s=drain_s
    )


@cache
def repeats_of(cell: Cell, duration_s: float, most: int) -> int:
    """Return how often a cell is played, an odd number, at most `most`.

    It is so often that the median of as many runs of the model agrees with that of all of them, but for one
    draw in twenty; so that a cell whose outcome is chance does not judge a preset by one throw.
    """
    scenario = scenario_of_cell(asdict(cell), duration_s=duration_s)
    measured = [measure(run(scenario, seed=seed), "sensors") for seed in range(MODEL_SEEDS)]
    runs = np.array([(one["loss"], one["p50_ms"]) for one in measured])
    rng, (loss, p50_ms) = np.random.default_rng(0), np.median(runs, axis=0)
    for repeats in range(1, most, 2):
        losses, p50s_ms = np.median(rng.choice(runs, (_DRAWS, repeats)), axis=1).T
        late = np.abs(p50s_ms - p50_ms) > LATENCY_WITHIN * p50s_ms
        if np.mean(late | (np.abs(losses - loss) > LOSS_WITHIN)) <= 1 - SURE:
            return repeats
    return most


# --- Live -----------------------------------------------------------------------------------------------------


def _repeats(config: Config) -> dict[Cell, int]:
    return {
        c: repeats_of(c, config.validation_s, config.validation_repeats) for c in committed_cells()
    }


@cells_part(exp, TABLE, total=lambda config: sum(_repeats(config).values()))
async def validate(bench: Bench[Config]) -> None:
    """Play every cell, and beside it the model."""
    config = bench.config

    async def rows(hosts: LiveHosts, cell: Cell, repeat: int) -> dict[str, Any]:
        played = await hosts.play(cells[cell], seed=config.seed + repeat)
        models = [run(played.scenario, seed=seed) for seed in seeded(config, MODEL_SEEDS)]
        found = {"repeat": repeat, "kept_up": played.kept_up, **compared(played, models, "sensors")}
        return asdict(cell) | found

    cells = {
        cell: scenario_of_cell(asdict(cell), duration_s=config.validation_s)
        for cell in committed_cells()
    }
    await play_missing(bench, TABLE, cells, _repeats(config), rows)


# --- Beside the model -----------------------------------------------------------------------------------------

KEYS = [f.name for f in fields(Cell)]
_MEASURED = ("loss_live", "loss_model", "p50_live_ms", "p50_model_ms")


@derived
def played(run: Run[Config], table: str = TABLE) -> pd.DataFrame:
    """Return what was played: a run's own rows, else those that are committed."""
    rows, committed = (
        beside(exp, run, table),
        find_project().reference_logs / f"{exp.name}_{PART}.mcap",
    )
    return exp.load(committed)[table] if rows.empty and committed.is_file() else rows


@derived
def by_cell(run: Run[Config]) -> pd.DataFrame:
    """Return a line a cell that kept its schedule, over the repetitions in which it did.

    Columns are the cell's, the medians of what was measured live and in the model, each with ``_low`` and
    ``_high``, and whether these medians agree: ``loss_agrees`` and ``latency_agrees``.
    """
    rows = played(run)
    groups = rows[rows["kept_up"].astype(bool)].groupby(KEYS, sort=False)[list(_MEASURED)]
    ends = (groups.min().add_suffix("_low"), groups.max().add_suffix("_high"))
    table = pd.concat([groups.median(), *ends], axis="columns").reset_index()
    table["loss_agrees"] = (table["loss_live"] - table["loss_model"]).abs() <= LOSS_WITHIN
    late_ms = (table["p50_live_ms"] - table["p50_model_ms"]).abs()
    return table.assign(latency_agrees=late_ms <= LATENCY_WITHIN * table["p50_live_ms"])


@derived
def validated(run: Run[Config]) -> pd.DataFrame:
    """Return how far each preset is validated, a line each, those that are only read too.

    Columns are ``preset``, how many ``cells`` were played, how many ``kept`` their schedule and whether that is
    ``enough``, and of those the shares ``loss_within`` and ``latency_within`` what is asked.
    """
    rows, table = played(run), by_cell(run)
    lines: list[dict[str, Any]] = []
    for preset in MODES:
        fair = table[table["preset"] == preset]
        count = len(rows[rows["preset"] == preset].drop_duplicates(KEYS))
        line = {"preset": preset, "cells": count, "kept": len(fair)}
        line |= {"enough": len(fair) >= KEPT_LEAST * count > 0, "note": ""}
        shares = {"loss_within": fair["loss_agrees"], "latency_within": fair["latency_agrees"]}
        lines.append(line | {name: float(agrees.mean()) for name, agrees in shares.items()})
    read = (
        {"preset": name, "cells": 0, "kept": 0, "enough": False, "note": why}
        for name, why in READ.items()
    )
    return pd.DataFrame([*lines, *read])


KEPT_HZ = 50  #: Rmax that nodes of Python keep.
DRAIN_S = 7.0  #: Two heartbeats of Fast DDS.
_KEYS = ["preset", "rate_max_hz", "method", "depth", "group", "slowed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RosCell:
    """One cell of the grid, in a mode of publication."""

    preset: str  #: One of `MODES`.
    slowed: float  #: By which factor.
    point: GridCell  #: Which cell.

    def scenario(self, seed: int) -> Scenario:
        """Return what is played."""
        given = scenario_of(self.point, seed=seed, vendor=PRESETS[self.preset])
        return replace(slowed(given, self.slowed), drain_s=DRAIN_S)


@exp.table(PART)
class RosRow(LiveRow):
    """One group of flows of one cell on real Fast DDS; times are as measured, `slowed` times the paper's."""

    preset: str  #: One of `MODES`.
    slowed: float  #: By which factor the cell ran slower than the paper's; some run at two.
    repeat: int  #: Which repetition.


def ros_cells(config: Config) -> list[RosCell]:
    """Return the cells: methods that optimise at Eq. 6's depth, others at every depth that is run live.

    The lowest rate runs half as fast as well, to show whether that says the same.
    """
    cell = cells_of(config)
    return [
        RosCell(
            preset=preset,
            slowed=pace * max(1.0, rate / KEPT_HZ),
            point=cell(rate_max_hz=rate, depth=depth, method=method, duration_s=config.ros2_s),
        )
        for preset in (name for name, mode in MODES.items() if mode)
        for rate in config.ros2_rates_hz
        for pace in (1.0, 2.0)[: 1 + (rate == RATES_HZ[0])]
        for method in config.live_methods
        for depth in ((OPT_DEPTH,) if METHODS[method].optimised else config.live_depths)
    ]


@cells_part(exp, PART, total=lambda config: len(ros_cells(config)) * config.ros2_repeats)
async def play_on_ros2(bench: Bench[Config]) -> None:
    """Play the cells on real Fast DDS, each beside the model."""
    config = bench.config

    async def rows(hosts: LiveHosts, cell: RosCell, repeat: int) -> tuple[dict[str, Any], ...]:
        played = await hosts.play(cells[cell], seed=config.seed + repeat)
        models = [run(played.scenario, seed=seed) for seed in seeded(config, MODEL_SEEDS)]
        own = {"preset": cell.preset, "slowed": cell.slowed, "repeat": repeat}
        found: list[Any] = compare(cell.point, played, models)
        return tuple(asdict(row) | own for row in found)

    cells = {cell: cell.scenario(config.seed) for cell in ros_cells(config)}
    await play_missing(bench, PART, cells, dict.fromkeys(cells, config.ros2_repeats), rows)


@derived
def on_ros2(run: Run[Config]) -> pd.DataFrame:
    """Return loss and median latency of "Hello" live and in the model, medians over repetitions, a line a cell.

    ``kept`` says how many of the ``played`` repetitions kept their schedule; the others are left out. Latencies
    are divided by ``slowed``.
    """
    rows = played(run, PART)
    rows = rows[rows["group"] == "hello"]
    counts = rows.groupby(_KEYS, sort=False)["kept_up"].agg(played="size", kept="sum")
    middle = rows[rows["kept_up"].astype(bool)].groupby(_KEYS, sort=False)[list(_MEASURED)].median()
    table: pd.DataFrame = counts.join(middle).reset_index()
    for column in ("p50_live_ms", "p50_model_ms"):
        table[column] /= table["slowed"]
    return table
