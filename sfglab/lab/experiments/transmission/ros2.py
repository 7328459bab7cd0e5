"""Grid of paper B on real Fast DDS: the cells that decide its questions, with rclpy nodes in both modes.

Python on two cores cannot publish seventeen topics at 1000 Hz. What is faster than `KEPT_HZ` runs slowed: rates
and the air's rate are divided by one factor, the cost of a frame, times of nodes and of changes multiplied by
it. Only the 3 s between heartbeats stay as they are, in the model beside it too.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from sfglab.arp.robots import METHODS
from sfglab.lab.baselines import PART
from sfglab.lab.experiment import seeded
from sfglab.lab.experiments.transmission.experiment import (
    OPT_DEPTH,
    Config,
    Point,
    cells_of,
    exp,
    scenario_of,
)
from sfglab.lab.experiments.transmission.stage import LiveRow, compare
from sfglab.lab.experiments.transmission.validation import MODEL_SEEDS, MODES, play_missing, played
from sfglab.lab.hosts import HostsUnavailableError
from sfglab.lab.ros2 import RosMissingError
from sfglab.lab.runs import Run, derived
from sfglab.rtps import PRESETS, Scenario, run

if TYPE_CHECKING:
    import pandas as pd

    from sfglab.lab.bench import Bench
    from sfglab.lab.experiments.transmission.stage import LiveHosts

KEPT_HZ = 100  #: Rmax that nodes of Python keep.
DRAIN_S = 7.0  #: Two heartbeats of Fast DDS.
_KEYS = ["preset", "rate_max_hz", "method", "depth", "group", "slowed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class RosCell:
    """One cell of the grid, in a mode of publication."""

    preset: str  #: One of `MODES`.
    slowed: float  #: By which factor.
    point: Point  #: Which cell.

    def scenario(self, seed: int) -> Scenario:
        """Return what is played."""
        given = scenario_of(self.point, seed=seed, vendor=PRESETS[self.preset])
        return replace(slowed(given, self.slowed), drain_s=DRAIN_S)


def slowed(scenario: Scenario, factor: float) -> Scenario:
    """Return a scenario of which flows and air are slower by a factor; how long it takes stays."""
    flows = (
        replace(
            flow,
            rate_hz=flow.rate_hz / factor,
            **{name: factor * getattr(flow, name) for name in ("phase_s", "service_s", "change_s")},
        )
        for flow in scenario.flows
    )
    medium = scenario.medium
    slow = replace(medium, rate_bps=medium.rate_bps / factor, overhead_s=medium.overhead_s * factor)
    return replace(scenario, flows=tuple(flows), medium=slow)


@exp.table(PART)
class RosRow(LiveRow):
    """One group of flows of one cell on real Fast DDS; times are as measured, `slowed` times the paper's."""

    preset: str  #: One of `MODES`.
    slowed: float  #: By which factor the cell ran slower than the paper's; some run at two.
    repeat: int  #: Which repetition.


def ros_cells(config: Config) -> list[RosCell]:
    """Return the cells: methods that optimise at Eq. 6's depth, others at every depth that is run live.

    What nodes keep runs half as fast as well, to show whether that says the same.
    """
    cell = cells_of(config)
    return [
        RosCell(
            preset=preset,
            slowed=slowed,
            point=cell(rate_max_hz=rate, depth=depth, method=method, duration_s=config.ros2_s),
        )
        for preset in (name for name, mode in MODES.items() if mode)
        for rate in config.ros2_rates_hz
        for slowed in ((1.0, 2.0) if rate <= KEPT_HZ else (rate / KEPT_HZ,))
        for method in config.live_methods
        for depth in ((OPT_DEPTH,) if METHODS[method].optimised else config.live_depths)
    ]


@exp.part(
    PART,
    total=lambda config: len(ros_cells(config)) * config.ros2_repeats,
    skips=(HostsUnavailableError, RosMissingError),
    timed=False,
)
async def play_on_ros2(bench: Bench[Config]) -> None:
    """Play the cells on real Fast DDS, each beside the model."""
    config = bench.config

    async def rows(hosts: LiveHosts, cell: RosCell, repeat: int) -> tuple[dict[str, Any], ...]:
        played = await hosts.play(cells[cell], seed=config.seed + repeat)
        models = [run(played.scenario, seed=seed) for seed in seeded(config, MODEL_SEEDS)]
        own = {"preset": cell.preset, "slowed": cell.slowed, "repeat": repeat}
        compared: list[Any] = compare(cell.point, played, models)
        return tuple(asdict(row) | own for row in compared)

    cells = {cell: cell.scenario(config.seed) for cell in ros_cells(config)}
    await play_missing(bench, PART, cells, config.ros2_repeats, rows)


@derived
def on_ros2(run: Run[Config]) -> pd.DataFrame:
    """Return loss and median latency of "Hello" live and in the model, medians over repetitions, a line a cell.

    ``kept`` says how many of the ``played`` repetitions kept their schedule; the others are left out. Latencies
    are divided by ``slowed``.
    """
    rows = played(run, PART)
    rows = rows[rows["group"] == "hello"]
    counts = rows.groupby(_KEYS, sort=False)["kept_up"].agg(played="size", kept="sum")
    fair = rows[rows["kept_up"].astype(bool)]
    middle = fair.groupby(_KEYS, sort=False)[
        ["loss_live", "loss_model", "p50_live_ms", "p50_model_ms"]
    ].median()
    table: pd.DataFrame = counts.join(middle).reset_index()
    for column in ("p50_live_ms", "p50_model_ms"):
        table[column] /= table["slowed"]
    return table
