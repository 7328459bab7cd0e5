"""A claim takes its share from a table of checks, and each check can fail."""

from dataclasses import asdict
from itertools import product

import pandas as pd
import pytest

from sfglab.fleet.discovery.lifecycle import Input, Lifecycle, State
from sfglab.lab.checks import CheckRow, Checks, lifecycle, lowest_share, naming, routing
from sfglab.machine import IllegalInputError


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


@pytest.mark.parametrize("group", [naming, routing])
def test_every_property_holds_on_a_few_cases(group):
    rows = [*group.checks.rows(20, 1)]
    assert len(rows) == len(group.checks)
    assert all(row.checked for row in rows)
    assert [row for row in rows if row.held < row.checked] == []


def test_the_discoverer_follows_the_rules_from_each_state_with_each_input():
    for state, given in product(State, Input):
        life = Lifecycle("go2")
        life.state = state
        try:
            done = life.feed(given)
        except IllegalInputError:
            assert (life.state, lifecycle.ruled(state, given)) == (state, None)
        else:
            assert (life.state, done) == lifecycle.ruled(state, given)


def test_what_fails_is_counted_and_shown():
    checks = Checks()
    checks.each("even", lambda count, seed: range(seed, count))(lambda number: number % 2 == 0)
    checks.cases("odd")(lambda: [("0", False), ("1", True)])
    even, odd = checks.rows(10, 0)
    assert (even.checked, even.held, even.example) == (10, 5, "1")
    assert (odd.checked, odd.held, odd.example) == (2, 1, "0")


@pytest.mark.parametrize(
    ("group", "place", "check", "most"),
    [
        (naming, "parse", "parses back to the tuple", 0),
        (routing, "Policy.crosses", "a name crosses exactly", 0.9),
    ],
)
def test_a_broken_library_fails_its_check(monkeypatch, group, place, check, most):
    monkeypatch.setattr(f"{group.__name__}.{place}", lambda *_: True)
    row = next(row for row in group.checks.rows(10, 1) if row.check.startswith(check))
    assert row.held <= most * row.checked
