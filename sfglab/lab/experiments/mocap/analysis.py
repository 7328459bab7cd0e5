"""Every check of a run, errors of looks, the claim A-VICON (the share that holds), and the figures.

A live check is one thing that section 4.5 of paper A says of the direct receiver or of the bridge.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import asdict
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.checks import CheckRow, check_row, lowest_share
from sfglab.lab.checks.trees import AGENT, RULE, WAYS, WORLD
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.mocap.experiment import Config, exp
from sfglab.lab.experiments.mocap.recordings import published_check
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
"""A tenth of how far the markers are from the base: whoever takes one frame for the other is further off."""


def tree_of(run: Run[Config], where: str, way: str) -> tuple[Edge, ...]:
    """Return the edges of one tree: of ``figure 6`` or of a live round, joined by one of `WAYS`."""
    edges = run["edge"]
    chosen = edges[(edges["where"] == where) & (edges["way"] == way)].drop(columns=["where", "way"])
    return tuple(
        Edge(**{str(key): value for key, value in row.items()}) for row in chosen.to_dict("records")
    )


def findings_of(run: Run[Config], where: str, way: str) -> tuple[FrameFinding, ...]:
    """Return what the lint finds wrong with one tree; names and root are demanded."""
    return lint_frames(tree_of(run, where, way), rule=RULE, root=WORLD)


@derived
def checks(run: Run[Config]) -> pd.DataFrame:
    """Return every check: ``how`` (exact, faults, flips or live), ``check``, counts and ``example``."""
    kinds = ["faults" if check.startswith("faults") else "exact" for check in run["check"]["check"]]
    exact = run["check"].assign(how=kinds)
    counts = run["confusion"].groupby(["truth", "verdict"])["count"].sum().to_dict()
    flips = pd.DataFrame([asdict(published_check(counts))])
    live = pd.DataFrame(
        [asdict(row) for name in run.config.rounds for row in _live_checks(run, name)]
    )
    columns = ["how", "check", "checked", "held", "example"]
    return pd.concat(
        [exact, flips.assign(how="flips"), live.assign(how="live")], ignore_index=True
    )[columns]


def _live_checks(run: Run[Config], name: str) -> Iterator[CheckRow]:
    """Yield the checks of one round."""
    found = {way: findings_of(run, name, way) for way in WAYS}
    trees = {way: tree_of(run, name, way) for way in WAYS}
    own = {
        way: {(e.child, e.parent, e.static) for e in trees[way] if e.parent != WORLD}
        for way in WAYS
    }
    looks = run["look"][run["look"]["round"] == name]
    cases: dict[str, Iterable[tuple[object, object]]] = {
        "proxy: the tree as heard is whole": [
            (found["proxy"], own["proxy"] and not found["proxy"])
        ],
        "proxy: the robot's own edges are as without": [
            (own["proxy"], own["proxy"] == own["direct"])
        ],
        "proxy: every look is answered": _numbered(looks["wait_ms"].notna()),
        f"proxy: the camera is within {RIGHT_MM:g} mm of the truth": _numbered(
            looks["error_mm"] < RIGHT_MM
        ),
        "direct: the tree as heard has two roots": [("", _has(found["direct"], "second-root"))],
        "direct: what is published is no frame of the robot": [("", _has(found["direct"], "name"))],
        "renamed: the markers have two parents": [("", _has(found["renamed"], "two-parents"))],
    }
    for check, tried in cases.items():
        yield check_row(f"live, {name}, {check}", [(str(text), bool(held)) for text, held in tried])
    yield from _flips(run["sight"], name)
    for way in ("direct", "renamed"):
        tries = run["try"][(run["try"]["round"] == name) & (run["try"]["way"] == way)]
        yield CheckRow(
            check=f"live, {name}, {way}: no look from the world to the camera is answered",
            checked=max(1, int(tries["count"].sum())),
            held=int(tries[tries["outcome"] != "found"]["count"].sum()),
            example=", ".join(tries["outcome"]),
        )


def _flips(sights: pd.DataFrame, name: str) -> Iterator[CheckRow]:
    """Yield whether the bridge published none of a round's flips; older logs do not know, nor ideal cameras."""
    flips = sights[(sights["round"] == name) & (sights["truth"] == "flipped")]
    if len(flips):
        sums = flips.groupby("published")["count"].sum()
        held, published = int(sums.get(False, 0)), int(sums.get(True, 0))
        words = f"{published} of {held + published} sights are"
        check = f"live, {name}, proxy: no flipped sight is published"
        yield CheckRow(check=check, checked=held + published, held=held, example=words)


def _has(findings: tuple[FrameFinding, ...], code: str) -> bool:
    return any(finding.code == code and AGENT in str(finding) for finding in findings)


def _numbered(held: pd.Series[bool]) -> list[tuple[object, object]]:
    return [(f"look {number}", holds) for number, holds in enumerate(held)]


@derived
def errors(run: Run[Config]) -> pd.DataFrame:
    """Return medians by live round: what is wrong with a look at its own time, and with the newest used as now.

    The ideal round has what the bridge and the tree add (continued odometry, interpolation), the faulty one
    the cameras' noise besides; the newest pose used as now adds the latency of all.
    """
    columns = ["error_mm", "error_mrad", "latest_mm", "latest_mrad", "age_ms", "wait_ms"]
    return run["look"].groupby("round", sort=False)[columns].median()


@exp.claim(
    "A-VICON",
    how=lambda r: How.LIVE if len(r["look"]) else How.EXACT,
)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of checks that hold, of live, fault and exact checks and flipped sights the lowest."""
    share = lowest_share(checks(run), "how")
    details = {
        "hosts": str(run.metadata("hosts")["description"]),
        **{f"{group} checks": held for group, held in share.groups.items()},
        **_live_details(run),
        **_fault_details(run),
    }
    return Finding(estimate=share.estimate, details=details, reason=share.reason)


def _live_details(run: Run[Config]) -> dict[str, str]:
    details: dict[str, str] = {}
    for name in run.config.rounds:
        looks = run["look"][run["look"]["round"] == name].dropna()
        heard = run["heard"][run["heard"]["round"] == name]
        if looks.empty or heard.empty:
            continue
        of = {
            "error at the time asked for": median_of(looks["error_mm"].to_numpy(), unit="mm"),
            "turn at the time asked for": median_of(looks["error_mrad"].to_numpy(), unit="mrad"),
            "error of the newest taken for now": median_of(
                looks["latest_mm"].to_numpy(), unit="mm"
            ),
            "until a time is known": median_of(looks["wait_ms"].to_numpy(), unit="ms"),
            "capture to listener": median_of(heard["heard_ms"].to_numpy(), unit="ms"),
        }
        details |= {f"{name}, {what}": str(estimate) for what, estimate in of.items()}
    return details


def _fault_details(run: Run[Config]) -> dict[str, str]:
    table = run["confusion"].assign(
        believed=run["confusion"]["verdict"].isin(["sound", "confirmed"])
    )
    counts = {
        key: int(count)
        for key, count in table.groupby(["truth", "believed"])["count"].sum().items()
    }
    flipped, seen = (
        [counts.get((truth, b), 0) for b in (True, False)] for truth in ("flipped", "seen")
    )
    return {
        "flipped sights that were published": f"{flipped[0]} of {sum(flipped)}",
        "true sights that were not": f"{seen[1]} of {sum(seen)}: after such a flip",
    }


_TITLES = {
    "direct": "Direct receiver (Fig. 6, left)",
    "renamed": "The same under the right name",
    "proxy": "Bridge, via the proxy frame (Fig. 6, right)",
}
_FAULTS = {"occluded": COLORS["network"], "flipped": COLORS["fourth"], "dropped": COLORS["third"]}
_ERRORS = (
    ("ideal", "error_mm", "third", "ideal"),
    ("faulty", "error_mm", "proxy", "faulty"),
    ("faulty", "latest_mm", "standard", "faulty, newest as now"),
)


@exp.figure("mocap_trees", size=(10, 4.6))
def draw_trees(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw both trees of Fig. 6, and the one between, with what is wrong."""
    twin: dict[str, Any] = {}
    for ax, (way, title) in zip(figure.subplots(1, 3), _TITLES.items(), strict=True):
        found = findings_of(run, "figure 6", way)
        draw_tree(ax, tree_of(run, "figure 6", way), findings=found, outside="mocap")
        ax.set_title(title)
        text = "\n".join(fill(f"{f.code}: {', '.join(f.frames)}", 42) for f in found)
        colour = "#A04000" if found else "#00664B"  # darker, for words
        place: dict[str, Any] = {
            "transform": ax.transAxes,
            "ha": "center",
            "va": "top",
            "fontsize": 8.5,
        }
        ax.text(0.5, -0.02, text or "nothing is found wrong", color=colour, **place)
        twin[way] = [str(finding) for finding in found]
    said = "A direct receiver breaks a robot's tree of frames, the bridge does not"
    figure.suptitle(f"{said} (blue: cameras' edge)")
    note(figure, "exact: the paper's example, as the linter finds it")
    return twin


@exp.figure("mocap_error", size=(10, 6.6))
def draw_error(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the live rounds: error and waiting time over time, with what the error is made of, and latencies."""
    axes = figure.subplot_mosaic("AAC;BBC")
    _draw_errors(axes["A"], run)
    _draw_waits(axes["B"], run)
    _draw_latencies(axes["C"], run)
    at, now = (errors(run)[name].get("faulty", np.nan) for name in ("error_mm", "latest_mm"))
    known = f"The camera's place is known to {at:.1f} mm"
    figure.suptitle(f"{known}; the newest taken for now is off by {now:.0f} mm")
    count = run["look"].groupby("round").size().max()
    note(
        figure, f"synthetic cameras; {count} looks a round, a dot each; in the legend: medians", run
    )
    return {"medians": errors(run).round(4).to_dict(orient="index")}


def _draw_errors(ax: Axes, run: Run[Config]) -> None:
    _mark_faults(ax, run)
    for name, column, color, text in _ERRORS:
        looks = _of(run["look"], name)
        style = series(color) | {"linestyle": "", "markersize": 2.5}
        ax.plot(
            looks["at_s"], looks[column], label=f"{text}: {looks[column].median():.2g} mm", **style
        )
    ax.set(yscale="log", ylabel="error, mm", title="How far the camera is from where it really is")
    ax.set_ylim(top=20 * looks["latest_mm"].max())  # room for the legend
    ax.legend(fontsize=8, ncols=3, loc="upper right")


def _draw_waits(ax: Axes, run: Run[Config]) -> None:
    _mark_faults(ax, run, named=True)
    looks = _of(run["look"], "faulty")
    ax.plot(looks["at_s"], looks["wait_ms"], ".", color=COLORS["proxy"], markersize=4)
    ax.set(yscale="log", xlabel="time, s", ylabel="until that time is known, ms")
    ax.set_ylim(top=5 * looks["wait_ms"].max())
    ax.set_title("How long a look at the present waits (faulty round)")
    ax.legend(fontsize=8, loc="upper right", ncols=3)


def _draw_latencies(ax: Axes, run: Run[Config]) -> None:
    heard = _of(run["heard"], "faulty")
    parts = (
        ("receipt_ms", "third", ":"),
        ("publication_ms", "proxy", "-"),
        ("heard_ms", "standard", "--"),
    )
    for (column, key, line), name in zip(parts, ("received", "published", "heard"), strict=True):
        values = np.sort(heard[column].to_numpy())
        share = np.arange(1, len(values) + 1) / max(1, len(values))
        ax.plot(values, share, color=COLORS[key], linestyle=line, label=name)
    ax.set(xscale="log", xlabel="since capture, ms", ylabel="share of transforms", title="Latency")
    ax.xaxis.set_minor_formatter("")
    ax.set_xticks([6, 10, 20, 50, 100], ["6", "10", "20", "50", "100"])
    ax.legend(fontsize=8)


def _mark_faults(ax: Axes, run: Run[Config], *, named: bool = False) -> None:
    spells = _of(run["spell"], "faulty")
    for kind, colour in _FAULTS.items():
        times = spells[spells["kind"] == kind][["begin_s", "end_s"]].to_numpy(dtype=float).tolist()
        for place, (begin_s, end_s) in enumerate(times):
            alpha = 0.8 if kind == "flipped" else 0.35
            label = kind if named and place == 0 else None
            span = ax.axvspan(
                begin_s - 0.01, end_s + 0.01, color=colour, alpha=alpha, linewidth=0, label=label
            )
            if kind == "dropped":  # not told by its colour alone
                span.set_height(0.08)


def _of(table: pd.DataFrame, name: str) -> pd.DataFrame:
    return table[table["round"] == name]


# Okabe and Ito's palette, distinct for all common kinds of colour blindness.
WRONG, OUTSIDE, PLAIN = "#D55E00", "#0072B2", "#666666"
_FILL, _WRONG_FILL = "#FFFFFF", "#FBE3D3"


def draw_tree(
    ax: Axes, edges: Iterable[Edge], *, findings: Sequence[FrameFinding] = (), outside: str = ""
) -> None:
    """Draw a tree, or what should be one; findings' frames and an outside authority's edges in colour."""
    edges = tuple(edges)
    places = tree_layout(edges)
    wrong = {frame for finding in findings for frame in finding.frames}
    for edge in edges:
        _draw_edge(ax, edge, places, OUTSIDE if edge.authority == outside and outside else PLAIN)
    for frame, (x, y) in places.items():
        bad = frame in wrong
        box = {
            "boxstyle": "round,pad=0.35",
            "facecolor": _WRONG_FILL if bad else _FILL,
            "edgecolor": WRONG if bad else PLAIN,
            "linewidth": 1.8 if bad else 1.0,
        }
        ax.text(x, y, _shown(frame), ha="center", va="center", fontsize=8, bbox=box, zorder=3)
    xs, ys = zip(*places.values(), strict=True) if places else ((0.0,), (0.0,))
    ax.set(xlim=(min(xs) - 0.6, max(xs) + 0.6), ylim=(min(ys) - 0.5, max(ys) + 0.5))
    ax.set_axis_off()


def tree_layout(edges: Iterable[Edge]) -> dict[str, tuple[float, float]]:
    """Return a place for every frame, below its first parent, leaves side by side; a circle starts anywhere."""
    edges = tuple(edges)
    parents: dict[str, str] = {}
    children: dict[str, list[str]] = defaultdict(list)
    counts = Counter(child for child, _ in {(edge.child, edge.parent) for edge in edges})
    for edge in edges:
        if parents.setdefault(edge.child, edge.parent) == edge.parent:
            children[edge.parent].append(edge.child)
    for below in children.values():
        below.sort(
            key=counts.__getitem__
        )  # who has several parents stands outside, near the other ones
    frames = list(dict.fromkeys(name for edge in edges for name in (edge.parent, edge.child)))
    places: dict[str, tuple[float, float]] = {}
    right = 0.0
    for frame in sorted(frames, key=lambda name: name in parents):
        if frame not in places:
            right = _place(frame, 0, right, children, places)
    return places


def _place(
    frame: str,
    depth: int,
    left: float,
    children: Mapping[str, Sequence[str]],
    places: dict[str, tuple[float, float]],
) -> float:
    """Place a frame above its children and return where the next one may begin."""
    # The room that a name takes, in the layout's units.
    width = 0.35 + 0.085 * max(map(len, _shown(frame).splitlines()))
    places[frame] = (left + width / 2, -float(depth))
    below = [child for child in dict.fromkeys(children.get(frame, ())) if child not in places]
    right = left
    for child in below:
        right = _place(child, depth + 1, right, children, places)
    if below:
        first, last = places[below[0]][0], places[below[-1]][0]
        places[frame] = ((first + last) / 2, -float(depth))
    return max(right, left + width)


def _shown(frame: str) -> str:
    return frame.replace("/", "/\n")


def _draw_edge(
    ax: Axes, edge: Edge, places: Mapping[str, tuple[float, float]], colour: str
) -> None:
    ax.annotate(
        "",
        xy=places[edge.child],
        xytext=places[edge.parent],
        arrowprops={
            "arrowstyle": "-|>",
            "color": colour,
            "linewidth": 1.2 if edge.static else 1.8,
            "shrinkA": 15,
            "shrinkB": 16,
        },
        zorder=2,
    )
