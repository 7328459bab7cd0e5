"""Times until each agent of each fleet knew its peers, what was received until then, and the claims.

An agent that was given up counts with the time that was waited for it, which makes the standard's figures lower
bounds; the claims' details say how many there were.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.discovery.experiment import ROUTED, STANDARD, Config, exp
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, bootstrap

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


PAPERS_LARGEST = 6
"""Agents of the fleet that the claims are about; a run with smaller ones only does not answer them."""

KEYS = ["mode", "agents", "talkers", "listeners"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fleets:
    """Fleets of a run, live or simulated."""

    cells: pd.DataFrame  #: One line a fleet.
    #: One line an agent: its fleet's columns (``mode``, ``agents``, ``repeat`` ...) with its own
    #: ``resolved_s``, ``own_bytes``, ``fleet_bytes`` and ``censored``.
    hosts: pd.DataFrame

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

    def of_main_nodes(self, table: pd.DataFrame, mode: str) -> pd.DataFrame:
        """Return the rows of one mode whose agents have the nodes that both modes were measured with."""
        talkers, listeners = self.main_nodes()
        kind = (table["mode"] == mode) & (table["talkers"] == talkers) & (table["listeners"] == listeners)
        return table[kind]

    def sizes(self, mode: str) -> set[int]:
        """Return the sizes of one mode's main fleets."""
        return {int(agents) for agents in self.of_main_nodes(self.cells, mode)["agents"]}

    def samples(self, mode: str, agents: int, column: str) -> Floats:
        """Return one figure of every agent of the main fleets of one size, shape (fleets, agents)."""
        hosts = self.of_main_nodes(self.hosts, mode)
        chosen = hosts[hosts["agents"] == agents]
        if chosen.empty:
            return np.empty((0, agents))
        return chosen.pivot_table(index="cell", columns="host", values=column).to_numpy(dtype=np.float64)


@derived
def live(run: Run[Config]) -> Fleets:
    """Return the live fleets; of a log that was cut off, the finished ones."""
    cells, hosts = run["cell"], run["host"]
    fleet = cells.drop(columns=["resolved_s", "censored"])
    return Fleets(cells=cells, hosts=hosts.merge(fleet, on="cell") if len(cells) else hosts)


@derived
def simulated(run: Run[Config]) -> Fleets:
    """Return the simulated fleets in the form of live ones."""
    rows = run["simulated"]
    cell = rows.groupby([*KEYS, "seed"], sort=False).ngroup()
    hosts = rows.assign(cell=cell, own_bytes=rows["rx_bytes"], fleet_bytes=rows["rx_bytes"])
    cells = hosts.drop_duplicates("cell")[["cell", *KEYS]].assign(
        resolved_s=hosts.groupby("cell")["resolved_s"].max().to_numpy(),
        censored=hosts.groupby("cell")["censored"].any().to_numpy(),
    )
    return Fleets(cells=cells, hosts=hosts)


def _how(run: Run[Config]) -> How:
    return How.SIMULATED if run["cell"].empty else How.LIVE


def _measured(run: Run[Config]) -> Fleets | None:
    """Return what the claims are about: the live fleets, else the simulated ones, else nothing."""
    fleets = live(run) if _how(run) is How.LIVE else simulated(run)
    return None if fleets.cells.empty else fleets


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


@derived
def summary(run: Run[Config]) -> pd.DataFrame:
    """Return medians over agents and fleets, and how busy the machine was, by kind and size of fleet."""
    if run["cell"].empty:
        return pd.DataFrame()
    hosts, cells = live(run).hosts.groupby(KEYS), live(run).cells.groupby(KEYS)
    busy_s = cells["nodes_cpu_s"].sum() + cells["components_cpu_s"].sum()
    table = pd.DataFrame(
        {
            "fleets": cells.size(),
            "given_up": cells["censored"].sum(),
            "agent_s": hosts["resolved_s"].median(),
            "fleet_s": cells["resolved_s"].median(),
            "own_bytes": hosts["own_bytes"].median(),
            "fleet_bytes": hosts["fleet_bytes"].median(),
            "cpu_s": cells["nodes_cpu_s"].median() + cells["components_cpu_s"].median(),
            "cores_busy": busy_s / cells["window_s"].sum(),
        }
    )
    return table.reset_index()


@exp.claim("A-DISC-TIME", how=_how)
def discovery_time(run: Run[Config]) -> Finding | None:
    """Return how long an agent of the largest routed fleet takes; None of a run with smaller fleets only."""
    fleets = _measured(run)
    agents = max(fleets.sizes(ROUTED), default=0) if fleets else 0
    if fleets is None or agents < PAPERS_LARGEST:
        return None
    times_s = fleets.samples(ROUTED, agents, "resolved_s")
    details = {
        "agents": str(agents),
        "fleets": str(len(times_s)),
        "slowest agent": f"{times_s.max():.2f} s",
        **_by_size(fleets, ROUTED),
        **_by_size(fleets, STANDARD),
    }
    reasons = _too_many(agents)
    if _how(run) is How.LIVE:
        busy, share = _cores_busy(fleets, agents)
        details |= {"cores busy, routed": f"{busy:.2f}", **_fewer_nodes(fleets, agents)}
        reasons.append(
            f"all agents share one machine, where they kept {busy:.1f} cores busy until then, "
            f"{100 * share:.0f} % of that with finding the nodes inside each agent"
        )
    estimate = _median(times_s, f"s at {agents} agents, routed")
    return Finding(estimate=estimate, details=details, reason="; ".join(reasons))


def _too_many(agents: int) -> list[str]:
    return [] if agents == PAPERS_LARGEST else [f"the run has {agents} agents at most"]


def _cores_busy(fleets: Fleets, agents: int) -> tuple[float, float]:
    """Return how many cores routed fleets of one size kept busy, and the share of the agents' own nodes."""
    cells = fleets.of_main_nodes(fleets.cells, ROUTED)
    sums = cells[cells["agents"] == agents][["nodes_cpu_s", "components_cpu_s", "window_s"]].sum()
    busy_s = sums["nodes_cpu_s"] + sums["components_cpu_s"]
    return float(busy_s / sums["window_s"]), float(sums["nodes_cpu_s"] / busy_s)


def _fewer_nodes(fleets: Fleets, agents: int) -> dict[str, str]:
    """Return the times of routed fleets of the same size whose agents have other nodes, by their nodes."""
    hosts = fleets.hosts[(fleets.hosts["mode"] == ROUTED) & (fleets.hosts["agents"] == agents)]
    return {
        f"with {talkers} + {listeners} nodes an agent": f"{rows['resolved_s'].median():.2f} s"
        for (talkers, listeners), rows in hosts.groupby(["talkers", "listeners"])
        if (talkers, listeners) != fleets.main_nodes()
    }


def _by_size(fleets: Fleets, mode: str) -> dict[str, str]:
    texts = {}
    for agents in sorted(fleets.sizes(mode)):
        times_s = fleets.samples(mode, agents, "resolved_s")
        given_up = int(fleets.samples(mode, agents, "censored").sum())
        text = f"{np.median(times_s):.2f} s ({times_s.min():.2f} to {times_s.max():.2f})"
        texts[f"{mode}, {agents} agents"] = text + (f", {given_up} agents given up" if given_up else "")
    return texts


@exp.claim("A-DISC-BYTES", how=_how)
def discovery_bytes(run: Run[Config]) -> Finding | None:
    """Return how much less a routed agent receives; None of a run without two fleets of the paper's size."""
    fleets = _measured(run)
    agents = max(fleets.sizes(ROUTED) & fleets.sizes(STANDARD), default=0) if fleets else 0
    if fleets is None or agents < PAPERS_LARGEST:
        return None
    own, fleet = (
        [fleets.samples(mode, agents, column) for mode in (STANDARD, ROUTED)]
        for column in ("own_bytes", "fleet_bytes")
    )
    details = {
        "agents": str(agents),
        "standard": f"{_median(own[0] / 1e6, 'MB')}",
        "routed": f"{_median(own[1] / 1e3, 'kB')}",
        "until the whole fleet is complete": str(_orders_of_magnitude(*fleet)),
        "fleets": f"{len(own[0])} standard, {len(own[1])} routed",
    }
    estimate = _orders_of_magnitude(*own)
    return Finding(estimate=estimate, details=details, reason="; ".join(_too_many(agents)))
