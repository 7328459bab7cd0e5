"""From the log to checks and the claim A-DEPLOY: the share of checks that hold.

What could not be checked on the machine of the run does not count; it is told beside the share.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pandas as pd

from sfglab.lab.checks import share_of_checks
from sfglab.lab.claims import How, Measured
from sfglab.record import LogReader

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """The tables of one run."""

    checks: pd.DataFrame  #: What was checked, with its group.
    unchecked: pd.DataFrame  #: What could not be, and why.
    detected: pd.DataFrame  #: What detection says of this machine and of made-up ones.
    files: pd.DataFrame  #: What each machine is given.
    layers: pd.DataFrame  #: The layers of each agent's image.
    refused: pd.DataFrame  #: Broken fleets and what was said of them.
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
            unchecked=tables.get("unchecked", pd.DataFrame(columns=["group", "check", "why"])),
            detected=tables["detected"],
            files=tables["file"],
            layers=tables["layer"],
            refused=tables["refused"],
            config=reader.metadata("config"),
        )


def text_of(log: Path, name: str) -> str:
    """Return a file of a machine as it was rendered.

    Args:
        log: The log.
        name: Agent and path, as in ``go2/compose.yaml``.

    Raises:
        KeyError: The log does not hold it.
    """
    with LogReader(log) as reader:
        return reader.attachment(name).decode()


def measure_claims(log: Path) -> dict[str, Measured]:
    """Return the share of checks that hold.

    Args:
        log: The log.
    """
    results = load_results(log)
    share = share_of_checks(results.checks, "group")
    live = bool(results.config["containers"])
    details = {
        **share.groups,
        "agents": ", ".join(dict.fromkeys(results.files["agent"])),
        "files of all machines": str(len(results.files)),
        "broken fleets refused": f"{int(results.refused['refused'].sum())} of {len(results.refused)}",
        **{f"not checked here: {row.check}": str(row.why) for row in results.unchecked.itertuples()},
    }
    how = How.LIVE if live else How.EXACT
    return {"A-DEPLOY": Measured(estimate=share.estimate, how=how, details=details, reason=share.reason)}
