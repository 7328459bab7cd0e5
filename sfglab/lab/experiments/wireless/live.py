"""Live parts: ways run at the same time, cell by cell, with equal seeds; a robot and a station with a process each.

Each way has a radio for all channels, and one for each outage. All samples are sent at once. Of the streams, which
need more CPU time, two are sent at once.
"""

from __future__ import annotations

import asyncio
import time
from contextlib import asynccontextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.fleet.fleet_file import AgentSpec, Fleet
from sfglab.lab.bench import as_row
from sfglab.lab.cells import run_cells
from sfglab.lab.experiments.wireless.experiment import (
    AWAY,
    BEFORE_S,
    FROZEN_S,
    Cell,
    Config,
    RadioRow,
    TraceRow,
    exp,
    sample_cells,
    video_cells,
)
from sfglab.lab.hosts import Network
from sfglab.lab.live_flows import QUIET
from sfglab.lab.workers.radio_end import FRESH_S, HUB, RadioEndConfig, Way
from sfglab.processes import Member, ProcessGroup
from sfglab.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from sfglab.component import Report
    from sfglab.lab.bench import Bench

RadioLink = tuple[Network, ProcessGroup]  #: A radio, and the processes of robot and station.
START_S = 120.0  #: Time limit for processes to start, and for a link to settle, s.
STEP_NS = 5_000_000  #: Distance of the times at which the age is taken, ns.
TRACE_EVERY = 20  #: Distance of the rows of `TraceRow`, in steps.


@dataclass(frozen=True, slots=True, kw_only=True)
class Span:
    """Samples and events that arrived at the station in a span of time."""

    marks_ns: tuple[int, ...]  #: Times at which each medium was set, and the end.
    kept_up: bool  #: Whether the radio's relay was fast enough.
    report: Report  #: Report of the station.

    def pairs(self, name: str) -> NDArray[np.int64]:
        """Return times of sending and arrival until the end, in order of arrival, shape (n, 2)."""
        pairs = np.array(self.report[name], np.int64).reshape(-1, 2)
        pairs = pairs[pairs[:, 1] < self.marks_ns[-1]]
        return pairs[np.argsort(pairs[:, 1], kind="stable")]

    def ages_ns(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return times, and the age of the newest sample at each of them, ns."""
        pairs = self.pairs("samples")
        at_ns = np.arange(max(self.marks_ns[0], pairs[0, 1]), self.marks_ns[-1], STEP_NS)
        newest = np.maximum.accumulate(pairs[:, 0])
        return at_ns, at_ns - newest[np.searchsorted(pairs[:, 1], at_ns, side="right") - 1]

    def columns(self) -> dict[str, Any]:
        """Return the measured columns of `RadioRow`."""
        start_ns, back_ns, end_ns = self.marks_ns[0], self.marks_ns[-2], self.marks_ns[-1]
        samples = self.pairs("samples")
        samples = samples[samples[:, 1] >= start_ns]
        latency_ns = samples[:, 1] - samples[:, 0]
        fresh = latency_ns < FRESH_S * NS_PER_S
        events = [event for event in self.report["events"] if event[2] >= start_ns]
        lost = {agent for kind, agent, _ in events if kind == "LOST"}
        present_ns = max((at_ns for _, _, at_ns in events), default=0)
        pictures_ns = self.pairs("pictures")[:, 1]
        pictures_ns = pictures_ns[pictures_ns >= start_ns]
        gaps_s = np.diff(pictures_ns, prepend=start_ns, append=end_ns) / NS_PER_S
        frozen_s = np.maximum(gaps_s - FROZEN_S, 0).sum()
        return {
            "age_p95_ms": float(np.percentile(self.ages_ns()[1], 95)) / NS_PER_MS,
            "latency_p99_ms": float(np.percentile(latency_ns, 99)) / NS_PER_MS,
            "flows_s": _first_s(samples[fresh, 1], back_ns),
            "latched_s": _first_s(self.report["latched_ns"], back_ns),
            "whole_s": max(0, present_ns - back_ns) / NS_PER_S if self.report["whole"] else np.nan,
            "false_losses": len(lost),
            "frozen": float(frozen_s / gaps_s.sum()) if self.report["pictures"] else np.nan,
            "kept_up": self.kept_up,
        }

    def trace(self) -> list[dict[str, float]]:
        """Return the measured columns of `TraceRow`, by time."""
        at_ns, ages_ns = self.ages_ns()
        columns = (at_ns - self.marks_ns[0]) / NS_PER_S - BEFORE_S, ages_ns / NS_PER_S
        rows = np.stack(columns, axis=1)[::TRACE_EVERY]
        return [{"t_s": float(t_s), "age_s": float(age_s)} for t_s, age_s in rows]


def _first_s(times_ns: Sequence[int] | NDArray[np.int64], since_ns: int) -> float:
    """Return the time from one event to the first of others, s; NaN if there is none."""
    later_s = [float(time_ns - since_ns) / NS_PER_S for time_ns in times_ns if time_ns >= since_ns]
    return min(later_s, default=np.nan)


@asynccontextmanager
async def radio_link(
    certificates: Path, table: str, stage: tuple[Way, float]
) -> AsyncIterator[RadioLink]:
    """Provide a robot and a station whose processes serve, on a radio of their own; a stage begins with the way."""
    config = RadioEndConfig(
        is_robot=False, way=stage[0], certificates=str(certificates), films=table == "video"
    )
    with Network() as network:
        members = []
        for name in ("station", "robot"):
            network.add_host(name)
            own = replace(config, is_robot=name == "robot")
            module = "sfglab.lab.workers.radio_end"
            members.append(Member(name=name, host=name, module=module, config=own))
        network.set_radio(QUIET)
        async with ProcessGroup(members, wrap_command=network.argv, start_s=START_S) as group:
            yield network, group


async def play_cell(link: RadioLink, cell: Cell, config: Config, seed: int) -> Span:
    """Set the media of a cell and return what arrives; before, wait on a quiet channel until all flows.

    In the middle of each time without a link the robot publishes a latched value.
    """
    network, group = link
    network.set_radio(QUIET)
    limit: dict[str, Any] = {"names": ["station"], "timeout_s": START_S}
    await group.ask("begun", **limit, do="begin", requests=cell.requests)
    marks_ns = []
    kept_up = True
    for medium, duration_s in cell.steps(config):
        marks_ns.append(time.time_ns())
        network.set_radio(medium, seed=seed)
        await asyncio.sleep(duration_s / 2)
        if medium is AWAY:
            group.order(["robot"], do="latch")
        await asyncio.sleep(duration_s / 2)
        kept_up &= network.radio_counters().kept_up
    marks_ns.append(time.time_ns())
    found = await group.ask("collected", **limit, do="collect")
    return Span(marks_ns=tuple(marks_ns), kept_up=kept_up, report=found["station"])


async def _measure(
    bench: Bench[Config], table: str, cells: Mapping[Cell, int], at_once: int
) -> None:
    """Run cells, on a number of radios at once."""
    from sfglab.fleet.certificates import write_certificates

    certificates = bench.folder(f"certificates-{table}")
    fleet = Fleet(name="wireless", agents=(AgentSpec(name="robot", domain=1),))
    write_certificates(fleet, certificates, [[HUB]])
    config = bench.config

    async def play(link: RadioLink, cell: Cell, repeat: int) -> dict[str, list[Any]]:
        span = await play_cell(link, cell, config, config.seed + repeat)
        origin = {**asdict(cell), "repeat": repeat}
        trace = span.trace() if cell.outage_s else []
        row = as_row(RadioRow, span.columns(), origin)
        return {table: [row], "trace": [as_row(TraceRow, at, origin) for at in trace]}

    def stage_of(cell: Cell) -> tuple[Way, float]:
        return cell.way, cell.outage_s

    start = partial(radio_link, certificates, table)
    await run_cells(bench, table, cells, stage_of=stage_of, start=start, play=play, at_once=at_once)


@exp.part("samples", total=lambda config: sum(sample_cells(config).values()))
async def measure_samples(bench: Bench[Config]) -> None:
    """Measure the age of information and the presence of agents on every channel and around every outage."""
    cells = sample_cells(bench.config)
    await _measure(bench, "samples", cells, at_once=len(cells))


@exp.part("video", total=lambda config: sum(video_cells(config).values()))
async def measure_video(bench: Bench[Config]) -> None:
    """Measure the frozen time of a decoded stream, with and without requests for key frames."""
    await _measure(bench, "video", video_cells(bench.config), at_once=2)
