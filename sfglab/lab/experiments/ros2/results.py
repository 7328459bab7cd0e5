"""The feature table, and the baselines of real ROS 2 beside their stand-ins."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd

from sfglab.lab.experiments.ros2.experiment import (
    BASELINES,
    REAL,
    SETTINGS,
    STAND_IN,
    TABLE,
    Config,
    exp,
)
from sfglab.lab.figures import note, series
from sfglab.lab.paths import find_project
from sfglab.lab.ros2 import TESTED
from sfglab.lab.runs import lines_of
from sfglab.lab.stats import Estimate, paired_ratios
from sfglab.record import LogReader

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.runs import Run

WORKS, FAILS, CANNOT, UNTESTED = "works", "fails", "cannot work", "untested against the real thing"
ELSEWHERE = (
    "rmw_cyclonedds_cpp, rmw_connextdds, rmw_zenoh_cpp",
    "Humble, Rolling",
    "ROS 2 on aarch64",
)
"""Features without a test, because the tests have no build of them."""
STYLES = ("standard", "proxy", "third", "fourth")


# --- Features ---------------------------------------------------------------------------------


def verdict(rows: pd.DataFrame) -> str:
    """Return what the tests of a feature with one distribution say together."""
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
    """Return the table of outcomes, those of the committed log if None, and what no test covers."""
    if tests is None:
        tests = exp.load(find_project().reference_logs / "ros2.mcap")["test"]
    untested = pd.DataFrame({"feature": ELSEWHERE} | dict.fromkeys(TESTED, UNTESTED))
    return pd.concat([compatibility(tests), untested], ignore_index=True)


# --- Baselines --------------------------------------------------------------------------------


def baseline(name: str) -> pd.DataFrame:
    """Return the rows of a baseline from its committed log, which is also that of an earlier version."""
    with LogReader(find_project().reference_logs / f"{name}_{TABLE}.mcap") as reader:
        return reader.table(TABLE)


def compared(rows: pd.DataFrame) -> pd.DataFrame:
    """Return medians of real ROS 2 and of its stand-in, and their ratio, by quantity and setting."""
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


@exp.figure("discovery_ros2", size=(11.5, 3.6))
def draw_discovery(figure: Figure, _: Run[Config]) -> dict[str, Any]:
    """Draw discovery times and received bytes of fleets of ROS 2 nodes and of their stand-ins."""
    return draw_baseline(figure, "discovery")


@exp.figure("decode_once_ros2", size=(11.5, 3.6))
def draw_decode_once(figure: Figure, _: Run[Config]) -> dict[str, Any]:
    """Draw CPU and received pictures of subscribers of raw images, of rclpy and of sfglab."""
    return draw_baseline(figure, "decode_once")


@exp.figure("latency_ros2", size=(11.5, 3.6))
def draw_latency(figure: Figure, _: Run[Config]) -> dict[str, Any]:
    """Draw ages of raw images and times to the first one, of rclpy and of sfglab."""
    return draw_baseline(figure, "latency")


def draw_baseline(figure: Figure, name: str) -> dict[str, Any]:
    """Draw the values of a committed baseline over the settings, with medians; return the sidecar."""
    rows = baseline(name)
    quantities = rows.groupby("quantity", sort=False)
    panels = figure.subplots(1, quantities.ngroups)
    for axes, (quantity, of_quantity) in zip(panels, quantities, strict=True):
        draw_quantity(axes, of_quantity)
        axes.set_title(quantity, fontsize=9)
        axes.set_xlabel(SETTINGS[name])
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower right", ncols=len(labels))
    figure.suptitle(BASELINES[name])
    note(figure, f"one dot per value, lines: medians; {rows['repeat'].nunique()} repetitions")
    return {"log": f"{name}_{TABLE}.mcap", "compared": compared(rows)}


def draw_quantity(axes: Axes, rows: pd.DataFrame) -> None:
    """Draw the values of one quantity."""
    settings = sorted(rows["setting"].unique())
    kinds = sorted(rows["kind"].unique(), key=lambda kind: (not kind.startswith(REAL), kind))
    for place, kind in enumerate(kinds):
        style = series(STYLES[place])
        of_kind = rows[rows["kind"] == kind]
        x = of_kind["setting"].map(settings.index) + 0.2 * (place - (len(kinds) - 1) / 2)
        dots = {"linestyle": "", "markersize": 4, "alpha": 0.6, **style}
        axes.plot(x, of_kind["value"], label=kind, **dots)
        medians = of_kind["value"].groupby(x).median()
        axes.hlines(medians, medians.index - 0.08, medians.index + 0.08, color=style["color"])
    axes.set_xticks(range(len(settings)), settings, rotation=60 if len(settings) > 5 else 0)
    axes.set(xlim=(-0.5, len(settings) - 0.5), ylim=(0, 1.1 * rows["value"].max()))
