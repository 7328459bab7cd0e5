"""The book has the tables of the log on ROS 2, and the log has the results of the tests."""

import sys
from pathlib import Path

import pandas as pd
import pytest

from sfglab.lab.experiments import ros2
from sfglab.lab.experiments.ros2.experiment import FeatureRow
from sfglab.lab.experiments.ros2.results import (
    CANNOT,
    ELSEWHERE,
    FAILS,
    UNTESTED,
    WORKS,
    compatibility,
)

ROOT = Path(__file__).parents[1]
sys.path += [str(ROOT / "tests" / "ros2"), str(ROOT / "book")]
import features  # noqa: E402
import pages  # noqa: E402


def test_the_book_has_the_tables_of_the_logs():
    page, tables = (ROOT / "book" / "ros2.md").read_text(encoding="utf-8"), pages.ros2_tables()
    assert [mark for mark in tables if f"<!-- {mark} -->" not in page] == []
    rows = [line.split(" | ") for table in tables.values() for line in table.splitlines()]
    for feature, *verdicts in ros2.feature_table().map(pages.plain).itertuples(index=False):
        assert [f"| {feature}", *verdicts[:-1], f"{verdicts[-1]} |"] in rows
    for name in ros2.BASELINES:
        assert any(row[0] == f"| {name}" for row in rows), name


def test_the_log_has_every_feature_that_the_tests_show_and_no_other():
    """With the verdicts that follow if all tests pass, in the order of the tests."""
    shown = pd.DataFrame([row for test in features.tests() for row in features.rows_of(test)])
    table = ros2.feature_table()
    assert table.iloc[: -len(ELSEWHERE)].equals(compatibility(shown))


def test_every_test_beside_ros_2_says_what_it_shows():
    assert [test.__name__ for test in features.tests() if not list(features.rows_of(test))] == []


@pytest.mark.parametrize(
    ("outcomes", "said"),
    [
        (["passed", "passed"], WORKS),
        (["passed", "failed"], FAILS),
        (["skipped"], UNTESTED),
        ([], UNTESTED),
    ],
)
def test_outcomes_decide(outcomes, said):
    of = {"feature": "f", "distribution": "jazzy", "test": "t"}
    rows = [FeatureRow(**of | {"distribution": "kilted"}, outcome="passed", cannot="no name")]
    rows += [FeatureRow(**of, outcome=outcome) for outcome in outcomes]
    (line,) = compatibility(pd.DataFrame(rows)).to_dict(orient="records")
    assert line == {"feature": "f", "jazzy": said, "kilted": f"{CANNOT}: no name"}
