"""What a run of the visualisation experiment says: its checks, what the bridge adds, and the claim."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.checks import share_of_checks
from sfglab.lab.claims import How, Measured
from sfglab.lab.experiments.visualisation.config import ADDED_MS
from sfglab.lab.experiments.visualisation.timing import PICTURE_BYTES
from sfglab.lab.stats import Estimate, bootstrap
from sfglab.record import LogReader
from sfglab.view.rerunning import WINDOW_BYTES

if TYPE_CHECKING:
    from pathlib import Path


BOUND_BYTES = WINDOW_BYTES + 2 * PICTURE_BYTES
"""What may wait at most: a window of drawn pictures, the one that fills it, and one that waits for its turn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """The tables of one run."""

    checks: pd.DataFrame  #: What was compared while it ran, one line a property.
    clouds: pd.DataFrame  #: Points of depth images, one line an image.
    times: pd.DataFrame  #: Pictures of both arms.
    memory: pd.DataFrame  #: Moments with a sink that stands still for a while.
    config: dict[str, Any]  #: The run's configuration.


def load_results(log: Path) -> Results:
    """Read a run's tables.

    Args:
        log: The log.
    """
    with LogReader(log) as reader:
        tables = {name: reader.table(name).drop(columns="log_time_ns") for name in reader.tables}
        return Results(
            checks=tables["check"],
            clouds=tables["cloud"],
            times=tables["time"],
            memory=tables["memory"],
            config=reader.metadata("config"),
        )


def checks(results: Results) -> pd.DataFrame:
    """Return every check: those made while it ran, and those of what was measured."""
    return pd.concat([results.checks, pd.DataFrame([_memory_check(results.memory)])], ignore_index=True)


def _memory_check(memory: pd.DataFrame) -> dict[str, Any]:
    """Return whether what waits is bounded, nothing is unaccounted for, and pictures flow again afterwards."""
    end, stopped = memory.iloc[-1], memory[memory["stopped"]]
    waiting = end["received"] - end["shown"] - end["dropped"]
    facts = {
        f"at most {_mib(memory['queued_bytes'].max()):.1f} of {_mib(BOUND_BYTES):.1f} MiB wait": bool(
            memory["queued_bytes"].max() <= BOUND_BYTES
        ),
        f"{waiting} pictures are neither shown nor counted as dropped nor wait": bool(0 <= waiting <= 1),
        "pictures flow again": bool(end["shown"] > stopped["shown"].max() + 1),
    }
    wrong = [fact for fact, held in facts.items() if not held]
    return {
        "group": "memory",
        "check": "a sink that stands still costs pictures, and bounded memory",
        "checked": len(facts),
        "held": len(facts) - len(wrong),
        "example": ", ".join(wrong or list(facts)),
    }


def _mib(size_bytes: float) -> float:
    return size_bytes / 2**20


def latency_table(results: Results) -> pd.DataFrame:
    """Return how long pictures took, by arm: median and percentiles, in milliseconds."""
    by_arm = results.times.groupby("arm")["taken_ms"]
    table = by_arm.describe(percentiles=[0.05, 0.5, 0.95, 0.99])
    names = {"count": "pictures", "5%": "5 %", "50%": "median", "95%": "95 %", "99%": "99 %"}
    return table[[*names]].rename(columns=names).astype({"pictures": int})


def added_ms(results: Results) -> Estimate:
    """Estimate what the bridge adds: its median beyond that of Rerun's own call, in the same run."""
    arms = [
        results.times.loc[results.times["arm"] == arm, "taken_ms"].to_numpy(float) for arm in ("bridge", "bare")
    ]
    return bootstrap(arms, lambda groups: float(np.median(groups[0]) - np.median(groups[1])), unit="ms")


def measure_claims(log: Path) -> dict[str, Measured]:
    """Return our figure for A-VIZ: the share of checks that hold, in the group where it is lowest.

    What the bridge adds is told beside it: the paper states no latency of its bridge.
    """
    results = load_results(log)
    table, added = checks(results), added_ms(results)
    share = share_of_checks(table, "group")
    memory = results.memory
    details = {
        **share.groups,
        "added by the bridge": f"{added}; asked is below {ADDED_MS:g} ms",
        "waiting at most, with a sink that stands still": f"{_mib(memory['queued_bytes'].max()):.1f} MiB",
        "dropped meanwhile": f"{int(memory['dropped'].max())} of {int(memory['received'].max())} pictures",
    }
    return {"A-VIZ": Measured(estimate=share.estimate, how=How.LIVE, details=details, reason=share.reason)}
