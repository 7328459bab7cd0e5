"""The feature table, and the baselines of rclpy in comparison with the surrogate nodes."""

from __future__ import annotations

import pandas as pd

from sfglab.lab.experiments.ros2.experiment import (
    REAL,
    STAND_IN,
    TABLE,
    exp,
)
from sfglab.lab.paths import find_project
from sfglab.lab.ros2 import TESTED
from sfglab.lab.runs import lines_of
from sfglab.lab.stats import Estimate, paired_ratios
from sfglab.record import LogReader

WORKS, FAILS, CANNOT, UNTESTED = "works", "fails", "cannot work", "untested"
ELSEWHERE = (
    "rmw_cyclonedds_cpp, rmw_connextdds, rmw_zenoh_cpp",
    "Humble, Rolling",
    "ROS 2 on aarch64",
)
"""Features without a test, because the tests have no build of them."""


# --- Features ---------------------------------------------------------------------------------


def verdict(rows: pd.DataFrame) -> str:
    """Return the common result of all tests of a feature with one distribution, in words."""
    if rows.empty or (rows["outcome"] == "skipped").all():
        return UNTESTED
    if (rows["outcome"] == "failed").any():
        return FAILS
    reasons = [reason for reason in rows["cannot"].unique() if reason]
    if reasons:
        return f"{CANNOT}: {'; '.join(reasons)}"
    conditions = [condition for condition in rows["condition"].unique() if condition]
    return ", ".join([WORKS, *conditions])


def compatibility(tests: pd.DataFrame) -> pd.DataFrame:
    """Return the verdict on each feature, in the order of the tests, by distribution."""
    lines = []
    for feature, of_feature in tests.groupby("feature", sort=False):
        line = {"feature": feature}
        for name in TESTED:
            line[name] = verdict(of_feature[of_feature["distribution"] == name])
        lines.append(line)
    return pd.DataFrame(lines)


def feature_table(tests: pd.DataFrame | None = None) -> pd.DataFrame:
    """Return the table of outcomes, with a row for what no test covers; without `tests`, that of the committed log."""
    if tests is None:
        tests = exp.load(find_project().reference_logs / "ros2.mcap")["test"]
    untested = pd.DataFrame({"feature": ELSEWHERE} | dict.fromkeys(TESTED, UNTESTED))
    return pd.concat([compatibility(tests), untested], ignore_index=True)


# --- Baselines --------------------------------------------------------------------------------


def baseline(name: str) -> pd.DataFrame:
    """Return the rows of a baseline from its committed log, which an earlier version may have recorded."""
    with LogReader(find_project().reference_logs / f"{name}_{TABLE}.mcap") as reader:
        return reader.table(TABLE)


def compared(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the medians of rclpy and of its surrogate nodes, and their ratio, by quantity and setting."""
    by = ["quantity", "setting"]
    medians = rows.groupby([*by, "kind", "repeat"], sort=False)["value"].median().reset_index()
    pairs = medians[medians["kind"].isin([REAL, STAND_IN])]
    both = pairs.groupby(by)["kind"].transform("nunique") == 2
    order = (STAND_IN, REAL)
    table = paired_ratios(pairs[both], by=by, pair="kind", order=order, values=["value"])
    ratios = []
    for line in lines_of(table):
        ratio = Estimate(value=line.ratio, low=line.low, high=line.high, unit="times")
        ratios.append(str(ratio))
    return table[[*by, REAL, STAND_IN]].assign(**{"stand-in / ROS 2": ratios})
