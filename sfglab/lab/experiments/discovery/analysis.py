"""From the log to figures: what each agent of each fleet took to know its peers, and the claims.

Everything here is computed from the log alone. An agent that was given up counts with the time that was waited
for it, which makes the standard's figures lower bounds; the claims' details say how many there were.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.claims import How, Measured
from sfglab.lab.experiments.discovery.config import ROUTED, STANDARD
from sfglab.lab.stats import Estimate, bootstrap
from sfglab.record import LogReader

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


PAPERS_LARGEST = 6
"""Agents of the fleet that the claims are about; a run with smaller ones only does not answer them."""

_KEYS = ["mode", "agents", "talkers", "listeners"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """The tables of one run."""

    #: One line an agent of a live fleet: its fleet's columns (``mode``, ``agents``, ``repeat`` ...) with its
    #: own ``resolved_s``, ``own_bytes``, ``fleet_bytes`` and ``censored``.
    hosts: pd.DataFrame
    cells: pd.DataFrame  #: One line a live fleet.
    simulated: pd.DataFrame  #: One line an agent of a simulated fleet.
    config: dict[str, Any]  #: The run's configuration.
    setting: dict[str, Any]  #: What the hosts were.

    def main_nodes(self) -> tuple[int, int]:
        """Return the numbers of talkers and listeners of the agents that both modes were measured with.

        Where there are several, the largest; of a run that holds no such pair, the largest of all.
        """
        kinds = {
            mode: set(
                self.cells.loc[self.cells["mode"] == mode, ["talkers", "listeners"]].itertuples(index=False)
            )
            for mode in (STANDARD, ROUTED)
        }
        found = (kinds[STANDARD] & kinds[ROUTED]) or (kinds[STANDARD] | kinds[ROUTED])
        talkers, listeners = max(found)
        return int(talkers), int(listeners)


def load_results(log: Path) -> Results:
    """Read a run's tables.

    Args:
        log: The log; one that was cut off gives its finished cells.
    """
    with LogReader(log) as reader:
        tables = {name: _table(reader, name) for name in ("cell", "host", "simulated")}
        fleet = tables["cell"].drop(columns=["resolved_s", "censored"], errors="ignore")
        return Results(
            hosts=tables["host"].merge(fleet, on="cell") if len(fleet) else tables["host"],
            cells=tables["cell"],
            simulated=tables["simulated"],
            config=reader.metadata("config"),
            setting=reader.metadata("hosts"),
        )


def _table(reader: LogReader, name: str) -> pd.DataFrame:
    if name not in reader.tables:
        return pd.DataFrame()
    return reader.table(name).drop(columns="log_time_ns")


def samples(results: Results, mode: str, agents: int, column: str) -> Floats:
    """Return one figure of every agent of the main fleets of one size, shape (fleets, agents)."""
    hosts = _of_main_nodes(results, results.hosts, mode)
    chosen = hosts[hosts["agents"] == agents]
    if chosen.empty:
        return np.empty((0, agents))
    return chosen.pivot_table(index="cell", columns="host", values=column).to_numpy(dtype=np.float64)


def _of_main_nodes(results: Results, table: pd.DataFrame, mode: str) -> pd.DataFrame:
    """Return the rows of one mode whose agents have the nodes that both modes were measured with."""
    talkers, listeners = results.main_nodes()
    kind = (table["mode"] == mode) & (table["talkers"] == talkers) & (table["listeners"] == listeners)
    return table[kind]


def _sizes(results: Results, mode: str) -> set[int]:
    return {int(agents) for agents in _of_main_nodes(results, results.cells, mode)["agents"]}


def _draws(table: Floats) -> Floats:
    """Return what is resampled: whole fleets, or the agents of the only one, as rows.

    Agents of one fleet are not independent of each other. Of a single fleet nothing but its agents is known, so
    its interval says how they differ, and not how fleets do.
    """
    return table if len(table) > 1 else table.reshape(-1, 1)


def _median(table: Floats, unit: str) -> Estimate:
    return bootstrap([_draws(table)], lambda groups: float(np.median(groups[0])), unit=unit)


def _orders_of_magnitude(standard: Floats, routed: Floats) -> Estimate:
    def ratio(groups: Sequence[Floats]) -> float:
        return float(np.log10(np.median(groups[0]) / np.median(groups[1])))

    return bootstrap([_draws(standard), _draws(routed)], ratio, unit="orders of magnitude fewer bytes")


def summary(results: Results) -> pd.DataFrame:
    """Return medians over agents and fleets, and how busy the machine was, by kind and size of fleet."""
    hosts = results.hosts.groupby(_KEYS)
    cells = results.cells.groupby(_KEYS)
    cpu_s = cells["nodes_cpu_s"].median() + cells["components_cpu_s"].median()
    table = pd.DataFrame(
        {
            "fleets": cells.size(),
            "given_up": cells["censored"].sum(),
            "agent_s": hosts["resolved_s"].median(),
            "fleet_s": cells["resolved_s"].median(),
            "own_bytes": hosts["own_bytes"].median(),
            "fleet_bytes": hosts["fleet_bytes"].median(),
            "cpu_s": cpu_s,
            "cores_busy": (cells["nodes_cpu_s"].sum() + cells["components_cpu_s"].sum())
            / cells["window_s"].sum(),
        }
    )
    return table.reset_index()


def measure_claims(log: Path) -> dict[str, Measured]:
    """Compute our figures of the discovery claims.

    Args:
        log: The run's log. One without live fleets gives what is simulated, and says so.

    Returns:
        Figures by the claims' ids; those that the run cannot give are left out.
    """
    results = load_results(log)
    how = How.LIVE
    if results.cells.empty:
        results, how = _as_live(results), How.SIMULATED
    if results.cells.empty:
        return {}
    found = {}
    if (routed := _sizes(results, ROUTED)) and max(routed) >= PAPERS_LARGEST:
        found["A-DISC-TIME"] = _time_claim(results, max(routed), how)
    common = _sizes(results, ROUTED) & _sizes(results, STANDARD)
    if common and max(common) >= PAPERS_LARGEST:
        found["A-DISC-BYTES"] = _bytes_claim(results, max(common), how)
    return found


def _as_live(results: Results) -> Results:
    """Return simulated fleets in the form of live ones."""
    simulated = results.simulated
    if simulated.empty:
        return results
    cell = simulated.groupby([*_KEYS, "seed"], sort=False).ngroup()
    hosts = simulated.assign(cell=cell, own_bytes=simulated["rx_bytes"], fleet_bytes=simulated["rx_bytes"])
    cells = hosts.drop_duplicates("cell")[["cell", *_KEYS]].assign(
        resolved_s=hosts.groupby("cell")["resolved_s"].max().to_numpy(),
        censored=hosts.groupby("cell")["censored"].any().to_numpy(),
    )
    return Results(
        hosts=hosts,
        cells=cells,
        simulated=simulated,
        config=results.config,
        setting=results.setting,
    )


def _time_claim(results: Results, agents: int, how: How) -> Measured:
    times_s = samples(results, ROUTED, agents, "resolved_s")
    estimate = _median(times_s, f"s at {agents} agents, routed")
    details = {
        "agents": str(agents),
        "fleets": str(len(times_s)),
        "slowest agent": f"{times_s.max():.2f} s",
        **_by_size(results, ROUTED, "routed"),
        **_by_size(results, STANDARD, "standard"),
    }
    reasons = [] if agents == 6 else [f"the run has {agents} agents at most"]
    if how is How.LIVE:
        busy, share = _cores_busy(results, agents)
        details |= {"cores busy, routed": f"{busy:.2f}", **_fewer_nodes(results, agents)}
        reasons.append(
            f"all agents share one machine, where they kept {busy:.1f} cores busy until then, "
            f"{100 * share:.0f} % of that with finding the nodes inside each agent"
        )
    return Measured(estimate=estimate, how=how, details=details, reason="; ".join(reasons))


def _cores_busy(results: Results, agents: int) -> tuple[float, float]:
    """Return how many cores routed fleets of one size kept busy, and the share of the agents' own nodes."""
    cells = _of_main_nodes(results, results.cells, ROUTED)
    sums = cells[cells["agents"] == agents][["nodes_cpu_s", "components_cpu_s", "window_s"]].sum()
    busy_s = sums["nodes_cpu_s"] + sums["components_cpu_s"]
    return float(busy_s / sums["window_s"]), float(sums["nodes_cpu_s"] / busy_s)


def _fewer_nodes(results: Results, agents: int) -> dict[str, str]:
    """Return the times of routed fleets of the same size whose agents have other nodes, by their nodes."""
    hosts = results.hosts[(results.hosts["mode"] == ROUTED) & (results.hosts["agents"] == agents)]
    texts = {}
    for kind in sorted(set(hosts[["talkers", "listeners"]].itertuples(index=False, name=None))):
        if kind != results.main_nodes():
            chosen = hosts[(hosts["talkers"] == kind[0]) & (hosts["listeners"] == kind[1])]
            texts[f"with {kind[0]} + {kind[1]} nodes an agent"] = f"{chosen['resolved_s'].median():.2f} s"
    return texts


def _by_size(results: Results, mode: str, label: str) -> dict[str, str]:
    texts = {}
    for agents in sorted(_sizes(results, mode)):
        times_s = samples(results, mode, agents, "resolved_s")
        given_up = int(samples(results, mode, agents, "censored").sum())
        text = f"{np.median(times_s):.2f} s ({times_s.min():.2f} to {times_s.max():.2f})"
        texts[f"{label}, {agents} agents"] = text + (f", {given_up} agents given up" if given_up else "")
    return texts


def _bytes_claim(results: Results, agents: int, how: How) -> Measured:
    own = [samples(results, mode, agents, "own_bytes") for mode in (STANDARD, ROUTED)]
    fleet = [samples(results, mode, agents, "fleet_bytes") for mode in (STANDARD, ROUTED)]
    details = {
        "agents": str(agents),
        "standard": f"{_median(own[0] / 1e6, 'MB')}",
        "routed": f"{_median(own[1] / 1e3, 'kB')}",
        "until the whole fleet is complete": str(_orders_of_magnitude(*fleet)),
        "fleets": f"{len(own[0])} standard, {len(own[1])} routed",
    }
    reason = "" if agents == 6 else f"the run has {agents} agents at most"
    return Measured(estimate=_orders_of_magnitude(*own), how=how, details=details, reason=reason)
