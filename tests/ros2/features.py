"""The features that tests beside ROS 2 show by their marks.

@pytest.mark.feature("Topics", condition="on one host", cannot={"kilted": "why"})
"""

from importlib import import_module
from pathlib import Path

from sfglab.lab.experiments.ros2.experiment import FeatureRow
from sfglab.lab.ros2 import TESTED

HERE = Path(__file__).parent


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
