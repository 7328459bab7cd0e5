"""How an experiment writes down what it checked, one row a property, and what follows for its claim."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.lab.stats import Estimate

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckRow:
    """How often one property was checked and how often it held."""

    check: str  #: The property.
    checked: int  #: Cases it was checked on.
    held: int  #: Cases in which it held.
    example: str  #: A case in which it did not; else one in which it did.


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """How much of a table of checks holds."""

    #: The share in the group where it is lowest: many checks of one kind hide none of another.
    estimate: Estimate
    groups: dict[str, str]  #: ``held of checked`` by group.
    reason: str  #: The properties that did not always hold, each with an example; empty: none.


def share_of_checks(table: pd.DataFrame, group: str) -> Share:
    """Return the share of checks that hold.

    Args:
        table: The columns of `CheckRow`, and one that groups them.
        group: That column.
    """
    sums = table.groupby(group, sort=False)[["held", "checked"]].sum()
    lowest = float((sums["held"] / sums["checked"]).min())
    wrong = table[table["held"] < table["checked"]]
    return Share(
        estimate=Estimate(value=lowest, low=lowest, high=lowest, unit="share of checks that hold"),
        groups={str(row.Index): f"{row.held} of {row.checked}" for row in sums.itertuples()},
        reason="; ".join(f"{r.check}: {r.held} of {r.checked}: {r.example}" for r in wrong.itertuples()),
    )
