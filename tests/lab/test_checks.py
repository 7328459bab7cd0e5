"""A claim takes its share from a table of checks, and each check can fail."""

from dataclasses import asdict

import pandas as pd
import pytest

from sfglab.lab.checks import (
    ALL,
    CheckRow,
    Checks,
    lifecycle,
    lowest_share,
    naming,
    routing,
)

GROUPS = {
    "naming": naming.checks,
    "routing": routing.checks,
    "lifecycle": lifecycle.checks,
}


def table(*rows):
    made = [
        (group, CheckRow(check=name, checked=n, held=held, example="x"))
        for group, name, n, held in rows
    ]
    return pd.DataFrame([{"group": group, **asdict(row)} for group, row in made])


def test_many_checks_of_one_group_hide_none_of_another_and_nothing_is_said_if_all_hold():
    rows = ("exact", "a", 1000, 1000), ("live", "b", 3, 3), ("live", "c", 1, 0)
    share = lowest_share(table(*rows), "group")
    assert (share.estimate.low, share.estimate.value, share.estimate.high) == (0.75, 0.75, 0.75)
    assert share.groups == {"exact": "1000 of 1000", "live": "3 of 4"}
    assert share.reason == "c: 0 of 1: x"
    share = lowest_share(table(("exact", "a", 2, 2)), "group")
    assert (share.estimate.value, share.reason) == (1.0, "")


@pytest.mark.parametrize(
    ("name", "check"), [(name, check) for name in GROUPS for check in GROUPS[name].names]
)
def test_every_property_holds_on_a_few_cases(name, check):
    row = GROUPS[name].row(check, count=20, seed=1)
    assert (row.held, row.example if row.held < row.checked else "") == (row.checked, "")
    assert row.checked


def test_what_fails_is_counted_and_shown():
    checks = Checks("some")
    checks.cases("even")(lambda sample: ((str(n), n % 2 == 0) for n in range(sample.count)))
    [even] = checks.rows(10, 0)
    assert (even.checked, even.held, even.example) == (10, 5, "1")


@pytest.mark.parametrize(
    ("name", "place", "check", "most"),
    [
        ("naming", "parse", "parses back to the tuple", 0),
        ("routing", "Policy.crosses", "a name crosses exactly", 0.9),
    ],
)
def test_a_broken_library_fails_its_check(monkeypatch, name, place, check, most):
    monkeypatch.setattr(f"sfglab.lab.checks.{name}.{place}", lambda *_: True)
    [found] = (one for one in GROUPS[name].names if one.startswith(check))
    row = GROUPS[name].row(found, count=10, seed=1)
    assert row.held <= most * row.checked
    assert row.example != ALL
