"""What follows from a table of checks for a claim."""

from __future__ import annotations

from dataclasses import asdict

import pandas as pd

from sfglab.lab.checks import CheckRow, share_of_checks


def table(*rows):
    return pd.DataFrame(
        [
            {"group": group, **asdict(CheckRow(check=check, checked=checked, held=held, example="x"))}
            for group, check, checked, held in rows
        ]
    )


def test_many_checks_of_one_group_hide_none_of_another():
    share = share_of_checks(
        table(("exact", "a", 1000, 1000), ("live", "b", 3, 3), ("live", "c", 1, 0)), "group"
    )
    assert (share.estimate.low, share.estimate.value, share.estimate.high) == (0.75, 0.75, 0.75)
    assert share.groups == {"exact": "1000 of 1000", "live": "3 of 4"}
    assert share.reason == "c: 0 of 1: x"


def test_nothing_is_said_where_all_hold():
    share = share_of_checks(table(("exact", "a", 2, 2)), "group")
    assert (share.estimate.value, share.reason) == (1.0, "")
