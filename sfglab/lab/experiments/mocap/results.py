"""Checks of TF trees and of live TF lookups, the claim A-VICON, and the figures."""

from __future__ import annotations

from dataclasses import asdict, fields
from textwrap import fill
from typing import TYPE_CHECKING

import pandas as pd

from sfglab.lab.checks import Case, CheckRow, check_row, lowest_share, shown_checks
from sfglab.lab.checks.trees import AGENT, CAMERAS, DIRECT, PROXY, RENAMED, WAYS, WORLD
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.mocap.experiment import FIGURE_6, LIVE, Config, exp
from sfglab.lab.figures import COLORS, note, series
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import median_of
from sfglab.spatial.frames.buffer import Edge
from sfglab.spatial.frames.lint import FrameFinding, lint_frames

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RIGHT_MM = 20.0
"""Limit of the error of a position: a tenth of the distance between markers and base, so that no frame is
taken for the other one."""
STATEMENTS = {
    "live, proxy: the tree as received is whole": "live, proxy: the received tree is connected",
    "live, proxy: the robot's own edges are as without": (
        "live, proxy: the robot's own edges are those without motion capture"
    ),
    "live, direct: what is published is no frame of the robot": (
        "live, direct: the published frame does not belong to the robot"
    ),
    "direct: what is published is no frame of the robot": (
        "direct: the published frame does not belong to the robot"
    ),
    "proxy: nothing is found wrong": "proxy: the tree has no error",
    "proxy: every frame stands where matrices put it": (
        "proxy: the pose of every frame is the product of matrices"
    ),
    "renamed, markers at the root: the tree is whole": (
        "renamed, markers at the root: the tree is connected"
    ),
}
"""Texts for readers of some checks, by their name in the log."""


@derived
def tree_of(run: Run[Config], where: str, way: str) -> tuple[Edge, ...]:
    """Return the edges of the TF tree of one method (`way`) in Fig. 6 or in the live run (`where`)."""
    table = run["edge"]
    chosen = table[(table["where"] == where) & (table["way"] == way)]
    names = [field.name for field in fields(Edge)]
    rows = chosen[names].to_numpy().tolist()
    return tuple(Edge(**dict(zip(names, row, strict=True))) for row in rows)


def findings_of(run: Run[Config], where: str, way: str) -> tuple[FrameFinding, ...]:
    """Return the errors of the TF tree of one method (`way`) in Fig. 6 or in the live run (`where`)."""
    return lint_frames(tree_of(run, where, way), agents=[AGENT], root=WORLD)


@derived
def checks(run: Run[Config]) -> pd.DataFrame:
    """Return all checks: ``how``, exact or live, and the fields of `CheckRow`."""
    rows = [asdict(row) for row in _live_checks(run)] if len(run["try"]) else []
    columns = ["how", "check", "checked", "held", "example"]
    both = [pd.DataFrame(rows).assign(how=How.LIVE.value), run["check"].assign(how=How.EXACT.value)]
    return pd.concat(both, ignore_index=True)[columns]


def check_table(run: Run[Config]) -> pd.DataFrame:
    """Return the table of a run's checks, as the notebook shows it."""
    return shown_checks(checks(run)[["check", "how", "checked", "held"]], STATEMENTS)


def _live_checks(run: Run[Config]) -> Iterator[CheckRow]:
    found = {way: findings_of(run, LIVE, way) for way in WAYS}
    own = {way: _own_edges(tree_of(run, LIVE, way)) for way in WAYS}
    is_same = bool(own[PROXY]) and own[PROXY] == own[DIRECT]
    wrong = "; ".join(map(str, found[PROXY]))
    looks = run["look"]
    cases: dict[str, list[Case]] = {
        "proxy: the tree as received is whole": [(wrong, bool(own[PROXY]) and not wrong)],
        "proxy: the robot's own edges are as without": [("", is_same)],
        "proxy: each look-up is answered": _numbered(looks["wait_ms"].notna()),
        f"proxy: the camera is within {RIGHT_MM:g} mm of its true position": _numbered(
            looks["error_mm"] < RIGHT_MM
        ),
        "direct: the tree as received has two roots": [("", _has(found[DIRECT], "second-root"))],
        "direct: what is published is no frame of the robot": [("", _has(found[DIRECT], "name"))],
        "renamed: the markers have two parents": [("", _has(found[RENAMED], "two-parents"))],
    }
    for check, tried in cases.items():
        yield check_row(f"live, {check}", tried)
    tries = run["try"]
    for way in (DIRECT, RENAMED):
        outcomes = tries[tries["way"] == way]
        checked = int(outcomes["count"].sum())
        held = checked - int(outcomes["count"][outcomes["outcome"] == "found"].sum())
        yield CheckRow(
            check=f"live, {way}: no look-up from the world to the camera is answered",
            checked=max(1, checked),
            held=held,
            example=", ".join(outcomes["outcome"]),
        )


def _own_edges(edges: Iterable[Edge]) -> set[tuple[str, str, bool]]:
    """Return the edges of a tree that motion capture does not publish."""
    return {(edge.child, edge.parent, edge.static) for edge in edges if edge.parent != WORLD}


def _has(findings: Iterable[FrameFinding], code: str) -> bool:
    return any(finding.code == code and AGENT in finding.what for finding in findings)


def _numbered(held: pd.Series[bool]) -> list[Case]:
    return [(f"look-up {number}", bool(holds)) for number, holds in enumerate(held)]


def _how(run: Run[Config]) -> How:
    return How.LIVE if len(run["look"]) else How.EXACT


@exp.claim("A-VICON", how=_how, also=How.EXACT)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of checks that hold, exact or live, whichever is lower."""
    share = lowest_share(checks(run), "how")
    details = {"hosts": str(run.metadata("hosts")["description"])}
    for how, counts in share.groups.items():
        details[f"{how} checks"] = counts
    looks = run["look"].dropna()
    quantities = {
        "position error at the time asked for": (looks["error_mm"], "mm"),
        "orientation error at the time asked for": (looks["error_mrad"], "mrad"),
        "position error of the latest transforms": (looks["latest_mm"], "mm"),
        "wait until a time is known": (looks["wait_ms"], "ms"),
    }
    for name, (values, unit) in quantities.items():
        if len(values):
            details[name] = str(median_of(values.to_numpy(), unit=unit))
    return Finding(estimate=share.estimate, details=details, reason=share.reason)


# --- Figures ---

_BASE, _MARKERS, _CAMERA = (f"{AGENT}/{name}" for name in ("base", "markers", "camera"))
_ROBOT = {_BASE: (1.5, 1.0), _MARKERS: (1.0, 0.0), _CAMERA: (2.0, 0.0)}
_PLACES = {
    DIRECT: {**_ROBOT, WORLD: (0.2, 2.0), f"{AGENT}_markers": (0.2, 1.0)},
    RENAMED: {**_ROBOT, WORLD: (0.2, 2.0)},
    PROXY: {**_ROBOT, WORLD: (1.5, 2.0)},
}
"""Places of the frames of Fig. 6 by way."""
_TITLES = {
    DIRECT: "Direct receiver (Fig. 6, left)",
    RENAMED: "Direct receiver, right name",
    PROXY: "Bridge with proxy frame (Fig. 6, right)",
}
_WRONG = "#FBE3D3"  # fill of frames with errors


@exp.figure("mocap_trees", size=(10, 4.6), measured=False)
def draw_trees(figure: Figure, run: Run[Config]) -> None:
    """Draw the TF trees with the direct receiver, with it under the right name, and with the bridge."""
    for axes, (way, title) in zip(figure.subplots(1, 3), _TITLES.items(), strict=True):
        findings = findings_of(run, FIGURE_6, way)
        _draw_tree(axes, tree_of(run, FIGURE_6, way), _PLACES[way], findings)
        axes.set_title(title)
        lines = [fill(f"{one.code}: {one.what}", 44) for one in findings]
        text = "\n".join(lines) or "no error"
        middle = 1.5 if way == PROXY else 1.0
        axes.text(middle, -0.45, text, ha="center", va="top", fontsize=8.5)
    figure.suptitle("The direct receiver breaks a robot's TF tree, the bridge does not")
    note(
        figure, "the paper's example; blue: published by motion capture; orange: named in an error"
    )


def _draw_tree(
    axes: Axes,
    edges: Sequence[Edge],
    places: Mapping[str, tuple[float, float]],
    findings: Iterable[FrameFinding],
) -> None:
    wrong = {frame for finding in findings for frame in finding.frames}
    for edge in edges:
        arrow = {
            "arrowstyle": "-|>",
            "color": COLORS["proxy" if edge.authority == CAMERAS else "network"],
            "linewidth": 1.5,
            "shrinkA": 15,
            "shrinkB": 16,
        }
        axes.annotate("", xy=places[edge.child], xytext=places[edge.parent], arrowprops=arrow)
    for frame, (x, y) in places.items():
        is_wrong = frame in wrong
        box = {
            "boxstyle": "round,pad=0.35",
            "facecolor": _WRONG if is_wrong else "white",
            "edgecolor": COLORS["standard" if is_wrong else "network"],
        }
        axes.text(x, y, frame.replace("/", "/\n"), ha="center", va="center", fontsize=8, bbox=box)
    axes.set(xlim=(-0.5, 2.5), ylim=(-0.4, 2.4))
    axes.set_axis_off()


@exp.figure("mocap_error", size=(10, 5.6))
def draw_error(figure: Figure, run: Run[Config]) -> None:
    """Draw errors of the camera's position (top) and waits for its transforms (bottom) over the live run."""
    looks = run["look"]
    errors, waits = figure.subplots(2, 1, sharex=True)
    kinds = {
        "error_mm": ("proxy", "at the requested time stamp (waits)"),
        "latest_mm": ("standard", "latest transforms (no wait)"),
    }
    for column, (key, text) in kinds.items():
        errors.plot(
            looks["at_s"], looks[column], label=text, linestyle="", markersize=2.5, **series(key)
        )
    errors.set(yscale="log", ylabel="position error (mm)")
    errors.margins(y=0.25)  # room for the legend
    errors.legend(fontsize=9, ncols=2, loc="upper right")
    waits.plot(looks["at_s"], looks["wait_ms"], ".", color=COLORS["proxy"], markersize=4)
    waits.set(yscale="log", xlabel="time since the start of the run (s)", ylabel="wait (ms)")
    wait_ms = _quartiles(looks["wait_ms"].dropna(), "ms")
    waits.set_title(f"Wait for the transforms of the requested time stamp: {wait_ms}", fontsize=10)
    error_mm, latest_mm = (_quartiles(looks[column], "mm") for column in kinds)
    errors.set_title(
        f"Error of the camera's position: {error_mm} at the requested time stamp,\n"
        f"{latest_mm} with the latest transforms",
        fontsize=10,
    )
    note(
        figure,
        f"{len(looks)} look-ups in one run;\nsimulated motion capture with occlusions and lost captures",
        run,
    )


def _quartiles(values: pd.Series[float], unit: str) -> str:
    low, median, high = values.quantile([0.25, 0.5, 0.75])
    return f"median {median:.2g} {unit} (quartiles {low:.2g} and {high:.2g})"
