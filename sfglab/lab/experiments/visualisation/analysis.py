"""Every check of a run, what the bridge adds, and the claim A-VIZ: the share of checks that hold."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from sfglab.lab.checks import CheckRow, facts_row, share_of_checks
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.visualisation.experiment import Config, exp
from sfglab.lab.experiments.visualisation.stage import ADDED_MS, BOUND_BYTES
from sfglab.lab.runs import derived
from sfglab.lab.stats import Estimate, bootstrap

if TYPE_CHECKING:
    from sfglab.lab.runs import Run

MIB = 2**20


@derived
def checks(run: Run[Config]) -> pd.DataFrame:
    """Return every check: those made while it ran, and that of what was measured."""
    memory = {"group": "memory", **asdict(check_memory(run["memory"]))}
    return pd.concat([run["check"], pd.DataFrame([memory])], ignore_index=True)


def check_memory(memory: pd.DataFrame) -> CheckRow:
    """Return whether what waits is bounded, nothing is unaccounted for, and pictures flow again afterwards."""
    end, stopped = memory.iloc[-1], memory[memory["stopped"]]
    waiting, most = end["received"] - end["shown"] - end["dropped"], memory["queued_bytes"].max()
    facts = {
        f"at most {most / MIB:.1f} of {BOUND_BYTES / MIB:.1f} MiB wait": bool(most <= BOUND_BYTES),
        f"{waiting} pictures are neither shown nor counted as dropped nor wait": bool(0 <= waiting <= 1),
        "pictures flow again": bool(end["shown"] > stopped["shown"].max() + 1),
    }
    return facts_row("a sink that stands still costs pictures, and bounded memory", facts)


def latency_table(run: Run[Config]) -> pd.DataFrame:
    """Return how long pictures took, by arm: median and percentiles, in milliseconds."""
    table = run["time"].groupby("arm")["taken_ms"].describe(percentiles=[0.05, 0.5, 0.95, 0.99])
    names = {"count": "pictures", "5%": "5 %", "50%": "median", "95%": "95 %", "99%": "99 %"}
    return table[[*names]].rename(columns=names).astype({"pictures": int})


@derived
def added_ms(run: Run[Config]) -> Estimate:
    """Estimate what the bridge adds: its median beyond that of Rerun's own call, in the same run."""
    times = run["time"]
    arms = [times.loc[times["arm"] == arm, "taken_ms"].to_numpy(float) for arm in ("bridge", "bare")]
    return bootstrap(arms, lambda groups: float(np.median(groups[0]) - np.median(groups[1])), unit="ms")


@exp.claim("A-VIZ", how=How.LIVE)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of checks that hold, in the group where it is lowest.

    What the bridge adds is told beside it: the paper states no latency of its bridge.
    """
    share, memory = share_of_checks(checks(run), "group"), run["memory"]
    details = {
        **share.groups,
        "added by the bridge": f"{added_ms(run)}; asked is below {ADDED_MS:g} ms",
        "waiting at most, with a sink that stands still": f"{memory['queued_bytes'].max() / MIB:.1f} MiB",
        "dropped meanwhile": f"{int(memory['dropped'].max())} of {int(memory['received'].max())} pictures",
    }
    return Finding(estimate=share.estimate, details=details, reason=share.reason)
