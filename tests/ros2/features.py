"""The features that tests beside ROS 2 show by their marks, and the README's table of them.

    @pytest.mark.feature("Topics", condition="on one host", cannot={"kilted": "why"})

`python tests/ros2/features.py` writes the table anew.
"""

import sys
from importlib import import_module
from pathlib import Path

import pandas as pd

from sfglab.lab.experiments.ros2 import UNTESTED, FeatureRow, compatibility
from sfglab.lab.ros2 import TESTED

HERE = Path(__file__).parent
BEGIN, END = "<!-- compatibility: tests/ros2/features.py -->\n", "<!-- end -->\n"
# Nobody has a build of these for these tests.
ELSEWHERE = (
    "rmw_cyclonedds_cpp, rmw_connextdds, rmw_zenoh_cpp",
    "Humble, Rolling",
    "ROS 2 on aarch64",
)


def rows_of(function, distributions=TESTED):
    """Yield a row for each feature that a test shows and each distribution."""
    for mark in getattr(function, "pytestmark", ()):
        if mark.name == "feature":
            (name,), cannot = mark.args, mark.kwargs.get("cannot", {})
            for distribution in distributions:
                yield FeatureRow(
                    feature=name,
                    distribution=distribution,
                    test=function.__name__,
                    outcome="passed",
                    condition=mark.kwargs.get("condition", ""),
                    cannot=cannot.get(distribution, ""),
                )


def tests():
    """Return all tests beside ROS 2."""
    modules = [import_module(path.stem) for path in sorted(HERE.glob("test_*.py"))]
    return [
        value
        for module in modules
        for name, value in vars(module).items()
        if name.startswith("test_")
    ]


def table():
    """Return the README's table, as it is while all tests pass."""
    rows = pd.DataFrame([row for test in tests() for row in rows_of(test)])
    lines = [f"| beside real rclpy | {' | '.join(map(str.capitalize, TESTED))} |", "|---|---|---|"]
    lines += [f"| {' | '.join(row)} |" for row in compatibility(rows).itertuples(index=False)]
    lines += [f"| {name} | {UNTESTED} | {UNTESTED} |" for name in ELSEWHERE]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.path.append(str(HERE.parent))  # where tests find what they share
    from test_readme import README, readme

    README.write_text(readme(BEGIN, table(), END), encoding="utf-8")
