"""Run the discovery experiment into one log: fleets started one after the other, standard beside routed."""

from __future__ import annotations

import asyncio
import math
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.discovery.ingress import Ingress
from sfglab.lab.experiments.discovery.rows import FleetRow, HostRow
from sfglab.lab.experiments.discovery.stage import Cell, Fleet, host_names
from sfglab.lab.meters import Window
from sfglab.lab.progress import progress_bar
from sfglab.lab.testbed import Testbed
from sfglab.record import LogWriter, run_context

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from sfglab.lab.experiments.discovery.config import Config
    from sfglab.lab.meters import MeterRow


_SIMULATED = "sfglab.lab.experiments.discovery.simulated"


def cells_of(config: Config, *, rng: np.random.Generator) -> list[Cell]:
    """Return the cells in the order they are run.

    Fleets of one size with the same nodes follow each other in random order, standard among routed, so that a
    machine that slows down slows both; sizes are shuffled too.
    """
    groups: dict[tuple[int, int, int], list[Cell]] = {}
    for stage in config.stages:
        for agents in stage.agents:
            group = groups.setdefault((agents, stage.talkers, stage.listeners), [])
            group += [
                Cell(
                    mode=stage.mode,
                    agents=agents,
                    talkers=stage.talkers,
                    listeners=stage.listeners,
                    repeat=repeat,
                )
                for repeat in range(stage.repeats)
            ]
    order = rng.permutation(len(groups))
    shuffled = [list(groups.values())[i] for i in order]
    return [group[i] for group in shuffled for i in rng.permutation(len(group))]


async def run(config: Config, path: Path, *, separate: bool | None = None) -> Path:
    """Run the experiment.

    Fleets are live only on separate hosts; where the machine has none, only what is simulated is run, and the
    log says so.

    Args:
        config: What to run.
        path: The log; it is readable up to the last finished chunk, whatever ends the run.
        separate: False simulates only; None takes separate hosts where the machine can.

    Returns:
        The log's path.

    Raises:
        ProcessFailedError: A process of the experiment failed; finished cells are in the log.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    cells = cells_of(config, rng=np.random.default_rng(config.seed))
    names = host_names(max(cell.agents for cell in cells))
    with Testbed(*names, separate=separate) as testbed, LogWriter(path) as log:
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": "discovery", **asdict(config)})
        log.write_metadata("hosts", {"description": testbed.description, "separate": testbed.separate})
        live = cells if testbed.separate else []
        with progress_bar(len(live), "discovery") as advance:
            for number, cell in enumerate(live):
                await _run_cell(number, cell, _Bench(config, testbed, log))
                advance(f"{cell.mode} {cell.agents}")
        _simulate(config, log)
    return path


@dataclass(frozen=True, slots=True)
class _Bench:
    """What every cell needs."""

    config: Config
    testbed: Testbed
    log: LogWriter


@dataclass(frozen=True, slots=True)
class _Outcome:
    """What came of one start; times are Unix time in nanoseconds."""

    begin_ns: int
    signalled_ns: int
    resolved_ns: list[int | None]
    given_up_ns: int
    ingress: Ingress
    meters: dict[str, MeterRow]

    @property
    def censored(self) -> bool:
        """Whether some agent was given up."""
        return None in self.resolved_ns

    @property
    def ends_ns(self) -> list[int]:
        """When each agent was complete or given up."""
        return [self.given_up_ns if at_ns is None else at_ns for at_ns in self.resolved_ns]

    def seconds(self, at_ns: int) -> float:
        """Return an instant as seconds since the signal."""
        return (at_ns - self.begin_ns) / 1e9


async def _run_cell(number: int, cell: Cell, bench: _Bench) -> None:
    async with Fleet(cell, bench.config, bench.testbed) as fleet:
        outcome = await _start(fleet, bench)
    for host in range(len(fleet.hosts)):
        bench.log.write_row("host", _host_row(number, host, outcome), log_time_ns=outcome.ends_ns[host])
    # Last, so that a cell that is in the log is complete.
    bench.log.write_row("cell", _cell_row(number, cell, outcome), log_time_ns=max(outcome.ends_ns))


async def _start(fleet: Fleet, bench: _Bench) -> _Outcome:
    ingress = Ingress([bench.testbed.meter(host) for host in fleet.hosts])
    window = Window(cpu={"nodes": fleet.node_pids, "components": fleet.component_pids}, interfaces={})
    ingress.read()
    window.sample(time.time_ns())
    begin_ns, signalled_ns = fleet.signal()
    reading = asyncio.create_task(ingress.run())
    try:
        resolved_ns = await fleet.resolved(bench.config.timeout_s)
    finally:
        reading.cancel()
        with suppress(asyncio.CancelledError):
            await reading
    ingress.read()
    end_ns = time.time_ns()
    meters = {row.label: row for row in window.sample(end_ns)}
    return _Outcome(begin_ns, signalled_ns, resolved_ns, end_ns, ingress, meters)


def _host_row(number: int, host: int, outcome: _Outcome) -> HostRow:
    end_ns = outcome.ends_ns[host]
    own_bytes, own_packets = outcome.ingress.between(host, outcome.begin_ns, end_ns)
    fleet_bytes, _ = outcome.ingress.between(host, outcome.begin_ns, max(outcome.ends_ns))
    return HostRow(
        cell=number,
        host=host,
        resolved_s=outcome.seconds(end_ns),
        censored=outcome.resolved_ns[host] is None,
        own_bytes=own_bytes,
        fleet_bytes=fleet_bytes,
        own_packets=own_packets,
    )


def _cell_row(number: int, cell: Cell, outcome: _Outcome) -> FleetRow:
    meter = outcome.meters["nodes"]
    return FleetRow(
        cell=number,
        **asdict(cell),
        resolved_s=outcome.seconds(max(outcome.ends_ns)),
        censored=outcome.censored,
        signal_s=outcome.seconds(outcome.signalled_ns),
        window_s=meter.window_s,
        nodes_cpu_s=_cpu_s(meter),
        components_cpu_s=_cpu_s(outcome.meters["components"]),
        machine_percent=meter.machine_cpu_percent,
        steal_percent=meter.steal_percent,
    )


def _cpu_s(meter: MeterRow) -> float:
    return math.nan if meter.cpu_percent is None else meter.cpu_percent / 100 * meter.window_s


def _simulate(config: Config, log: LogWriter) -> None:
    """Run the simulated fleets, in this version of the package if it has them."""
    if find_spec(_SIMULATED) is None:
        return
    rows: Callable[[Config], Any] = import_module(_SIMULATED).simulated_rows
    for row in rows(config):
        log.write_row("simulated", row, log_time_ns=time.time_ns())
