"""What is said to work beside ROS 2: the README's table is what the tests show, and their outcomes decide."""

import sys
from pathlib import Path

import pandas as pd
import pytest
from test_readme import README, readme

from sfglab.lab.experiments.ros2 import CANNOT, FAILS, UNTESTED, WORKS, FeatureRow, compatibility

sys.path.append(str(Path(__file__).parent / "ros2"))  # where these tests find each other
import features


def test_the_readme_has_the_table_that_the_tests_show():
    """`python tests/ros2/features.py` writes it anew."""
    assert README.read_text(encoding="utf-8") == readme(
        features.BEGIN, features.table(), features.END
    )


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
