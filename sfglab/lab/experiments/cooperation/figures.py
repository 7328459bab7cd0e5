"""Figures 16, 17 and 18 of paper B, redrawn from a run, what was out of date when a run failed, and films.

In films the walls are drawn once by matplotlib; robots and beams are drawn onto that picture.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.arp.hallway import (
    AREAS,
    BEAMS_DEG,
    HALF_WIDTH_M,
    HOME,
    RADIUS_M,
    WAYPOINTS,
    End,
    course_length_m,
)
from sfglab.arp.robots import METHODS
from sfglab.lab.experiment import Look
from sfglab.lab.experiments.cooperation.analysis import contrasts, courses, difference, rates
from sfglab.lab.experiments.cooperation.experiment import (
    Config,
    driven,
    exp,
    settings_of,
    track_rows,
)
from sfglab.lab.experiments.cooperation.stage import LIVE_POINT, scan_at
from sfglab.lab.figures import COLORS, MARKERS, grouped_bars, house_style, mp4, note
from sfglab.lab.runs import Run, lines_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

RUN_COLORS = {"success": COLORS["third"], "failure": COLORS["standard"]}
_ROBOT_COLORS = {"robot1": COLORS["proxy"], "robot2": "#E69F00", "robot3": "black"}
_MARK_S = 10.0


@exp.figure("cooperation", size=(10, 5.6))
def draw_success(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the rounds that succeed: by method with Wilson's 95 % intervals, and by depth and Rmax."""
    rows = courses(run)
    of_methods, of_cells = figure.subplots(1, 2, width_ratios=(1, 1.2))
    table, cells = rates(rows, "method"), rates(rows, "method", "depth", "rate_max_hz")
    _draw_rates(of_methods, table)
    _draw_counts(of_cells, cells)
    said = ", ".join(
        f"{row.method} {row.rate:.0%}" for row in lines_of(table) if "CC" not in row.method
    )
    figure.suptitle(f"Who completes the round: {said} (paper: OPT+LC does, none does not)")
    note(figure, "simulated; bars: Wilson's 95 % interval; DEPTH opt: Eq. 6's")
    more, names = difference(rows), ("successes", "runs", "low", "high")
    return {
        "rates": {
            f"{row.method}, Rmax {row.rate_max_hz}, depth {row.depth}": {
                n: getattr(row, n) for n in names
            }
            for row in lines_of(cells)
        },
        "difference": more,
        "course": {"length_m": course_length_m(), "width_m": 2 * HALF_WIDTH_M},
    }


def _draw_rates(axes: Axes, table: pd.DataFrame) -> None:
    for place, row in enumerate(lines_of(table)):
        error = [[100 * (row.rate - row.low)], [100 * (row.high - row.rate)]]
        axes.errorbar(100 * row.rate, place, xerr=error, fmt="o", color=COLORS["proxy"], capsize=3)
        said = f"{row.successes} of {row.runs}"
        axes.annotate(said, (100 * row.rate, place), (0, 6), textcoords="offset points", fontsize=8)
    axes.set_yticks(range(len(table)), table["method"])
    axes.set(
        xlabel="rounds completed (%), 95 % interval", xlim=(-3, 103), ylim=(len(table) - 0.5, -0.7)
    )


def _draw_counts(axes: Axes, cells: pd.DataFrame) -> None:
    """Draw how many rounds succeed, darker the more: a line a method and depth, a column an Rmax."""
    names = cells["method"] + ", " + cells["depth"].replace(0, "opt").astype(str)
    order, columns = list(dict.fromkeys(names)), sorted(cells["rate_max_hz"].unique())
    for name, row in zip(names, lines_of(cells), strict=True):
        x, y = columns.index(row.rate_max_hz), order.index(name)
        axes.barh(
            y, 0.96, left=x - 0.48, height=0.92, color=COLORS["third"], alpha=0.08 + 0.62 * row.rate
        )
        axes.text(x, y, f"{row.successes} of {row.runs}", ha="center", va="center", fontsize=8)
    axes.set_xticks(range(len(columns)), [f"{rate} Hz" for rate in columns])
    axes.set_yticks(range(len(order)), order, fontsize=8)
    axes.set(xlabel="Rmax", ylabel="method, DEPTH", ylim=(len(order) - 0.5, -0.5))
    axes.grid(visible=False)


@exp.figure("cooperation_tracks", size=(10, 4.6))
def draw_ways(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the three robots' ways in a run that succeeded (Fig. 17) and in one that failed (Fig. 18)."""
    examples = run.metadata("examples")
    shown: dict[str, Any] = {
        name: examples[name] for name in ("success", "failure") if name in examples
    }
    panels = figure.subplots(1, max(1, len(shown)), squeeze=False)[0]
    for axes, (name, example) in zip(panels, shown.items(), strict=False):
        _draw_run(axes, run["track"][run["track"]["run"] == name], name, example)
    by = [
        f"{one['method']} by {one['robot']} {one['end']} at {one['ended_s']:.0f} s"
        for one in shown.values()
    ]
    figure.suptitle("How a round ends: " + "; ".join(by).replace("by  ", "by "))
    note(figure, "simulated, one round each; a dot every 10 s; ringed: what ended the round")
    return shown


def _draw_run(axes: Axes, tracks: pd.DataFrame, name: str, example: dict[str, Any]) -> None:
    """Draw the ways of a run into one hallway: a colour a robot, and its boxes in that colour."""
    for robot, color in _ROBOT_COLORS.items():
        draw_area(axes, robot, color)
        way = tracks[tracks["robot"] == robot]
        _draw_track(axes, way, color, label=robot)
        if example.get("robot") == robot:
            last = way.iloc[-1]
            axes.plot(
                last["x_m"], last["y_m"], "o", markersize=17, markerfacecolor="none", color="black"
            )
    left, bottom = np.min([np.min(line.get_xydata(), axis=0) for line in axes.lines], axis=0)
    axes.plot([left, left + 1], [bottom - 0.3] * 2, color="black", linewidth=2.5)
    axes.annotate("1 m", (left + 1.1, bottom - 0.3), va="center", fontsize=8)
    label = "optimum" if example["depth"] == 0 else example["depth"]
    axes.set_title(
        f"{name}: {example['method']}, Rmax {example['rate_max_hz']} Hz, depth {label}", fontsize=9
    )
    axes.legend(fontsize=8, title="way and boxes of", title_fontsize=8, loc="upper right")


def draw_area(axes: Axes, robot: str, color: str = COLORS["network"]) -> None:
    """Draw a robot's hallway, its boxes in a colour, and its home."""
    [area] = [area for area in AREAS if area.robot == robot]
    walls = 2 * len(WAYPOINTS)
    for number, (ax, ay, bx, by) in enumerate(area.segments):
        axes.plot([ax, bx], [ay, by], color="black" if number < walls else color, linewidth=1.3)
    for box in area.boxes:
        axes.fill(*box.corners().T, color=color, alpha=0.6)
    axes.plot(*HOME[:2], "+", color="black", markersize=9)
    axes.set(aspect="equal", xticks=(), yticks=())
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)


def _draw_track(axes: Axes, way: pd.DataFrame, color: str, **style: Any) -> None:
    """Draw a robot's way with a mark every ten seconds, and the robot where it ended."""
    from matplotlib.patches import Circle

    axes.plot(way["x_m"], way["y_m"], color=color, linewidth=1.2, **style)
    every = way[np.isclose(way["t_s"] % _MARK_S, 0.0, atol=1e-6)]
    axes.plot(every["x_m"], every["y_m"], "o", color=color, markersize=2.5)
    last = way.iloc[-1]
    axes.add_patch(Circle((last["x_m"], last["y_m"]), RADIUS_M, color=color, alpha=0.7))


@exp.look(
    "hallway",
    Look(
        turn=("methods", "rates_hz", "depths", "loss", "vendor", "seed"),
        needs=("course",),
        size=(6.4, 4.6),
        start={"methods": ("LC",), "rates_hz": (100,), "depths": (10,), "seeds": 1},
        reference="cooperation_tracks",
    ),
)
def draw_round(figure: Figure, run: Run[Config]) -> None:
    """Draw the three robots' ways in a run's first round."""
    row = lines_of(run["course"])[0]
    name = "success" if row.end == End.SUCCESS.value else "failure"
    tracks = pd.DataFrame(
        track_rows(name, driven(settings_of(row, run.config), row.seed)[0].snapshots)
    )
    _draw_run(figure.subplots(), tracks, name, row._asdict())
    late = f"at worst {row.stale_flow} was out of date for {row.stale_s:.2f} s"
    figure.suptitle(f"{row.end} after {row.ended_s:.1f} s; {late}")


@exp.figure("cooperation_staleness", size=(9.6, 3.8))
def draw_staleness(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw for each round the longest time that something was out of date, successes beside failures."""
    rows, axes = courses(run), figure.subplots()
    names = [name for name in METHODS if name in set(rows["method"])]
    for success, color, label in ((True, "third", "success"), (False, "standard", "failure")):
        for position, name in enumerate(names):
            runs = rows[(rows["method"] == name) & (rows["success"] == success)]
            # Beside each other in a fixed pattern, so that the picture is the same each time.
            aside = (np.arange(len(runs)) * 0.6180339887 % 1.0 - 0.5) * 0.3 + (
                -0.18 if success else 0.18
            )
            stale = runs["stale_s"].clip(lower=1e-3)
            axes.plot(
                position + aside,
                stale,
                MARKERS[color],
                color=COLORS[color],
                markersize=3.5,
                alpha=0.7,
            )
        axes.plot([], [], MARKERS[color], color=COLORS[color], markersize=4, label=label)
    axes.axhline(3.0, color="black", linestyle=(0, (4, 2)), linewidth=1.0)
    edge = axes.get_yaxis_transform()
    axes.text(1.0, 3.0, "heartbeat: 3 s", transform=edge, va="bottom", ha="right", fontsize=8)
    axes.set(xlim=(-0.5, len(names) + 0.1), yscale="log")
    axes.set_xticks(range(len(names)), names)
    axes.set_ylabel("longest time out of date (s)")
    axes.grid(visible=False, axis="x")
    axes.legend(fontsize=8, loc="lower left", ncols=2)
    worst, failed = (
        rows["stale_s"][rows["success"]].max(),
        rows["stale_s"][~rows["success"]].median(),
    )
    figure.suptitle(
        f"In rounds that succeed nothing is out of date for more than {worst:.1f} s, in half of the others "
        f"for {failed:.1f} s or more"
    )
    note(figure, f"simulated; a mark a round, {len(rows)} of them")
    medians = rows.groupby(["method", "success"])["stale_s"].median().reset_index()
    named = {True: "success", False: "failure"}
    return {f"{row.method}, {named[row.success]}": row.stale_s for row in lines_of(medians)}


@exp.figure("cooperation_contrasts", size=(10, 3.8), when=lambda run: not contrasts(run).empty)
def draw_contrasts(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the success rates as they are beside those of each contrast."""
    table, axes = contrasts(run), figure.subplots()
    counts = [contrasts(run, of) for of in ("successes", "runs")]
    shades = (COLORS["standard"], COLORS["proxy"], "#56B4E9", "black")
    spots = grouped_bars(axes, 100 * table, shades, width=0.9)
    for at, kind in zip(spots, table.columns, strict=True):
        for spot, method in zip(at.tolist(), table.index, strict=True):
            rate, (won, of) = table[kind][method], (count[kind][method] for count in counts)
            said = "not run" if np.isnan(rate) else f"{won:.0f} of {of:.0f}"
            axes.annotate(
                said, (spot, 100 * np.nan_to_num(rate)), ha="center", va="bottom", fontsize=7.5
            )
    axes.set_xticks(range(len(table)), list(table.index))
    axes.set(ylabel="rounds completed (%)", ylim=(0, 112))
    axes.legend(loc="upper left", ncols=2)
    best = table.iloc[-1]
    said = "; ".join(f"{kind} {rate:.0%}" for kind, rate in best.dropna().items())
    figure.suptitle(f"{best.name} completes its rounds: {said}")
    note(figure, "simulated; at the lowest and the highest Rmax")
    return {str(kind): table[kind].dropna().to_dict() for kind in table.columns}


@exp.figure(
    "cooperation_live", size=(10, 4.2), when=lambda run: bool((run["track"]["run"] == "live").any())
)
def draw_live(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the live drive, and how far each robot's way is from the simulated one."""
    tracks, live = run["track"], run.metadata("live")
    ways, distances = figure.subplots(1, 2)
    _draw_run(ways, tracks[tracks["run"] == "live"], "live", asdict(LIVE_POINT))
    for robot, color in _ROBOT_COLORS.items():
        distances.plot(*off_m(tracks, robot) * [[1], [100]], color=color, label=robot)
    distances.set(xlabel="time (s)", ylabel="from the simulated way (cm)", ylim=(0, None))
    apart = apart_m(tracks)
    figure.suptitle(
        f"Live over DDS the robots stay within {100 * apart:.0f} cm of their simulated ways"
    )
    note(figure, f"live beside simulated, one drive of {live['lasted_s']:.0f} s; a dot every 10 s")
    return {"apart_m": apart, **live}


def off_m(tracks: pd.DataFrame, robot: str) -> NDArray[np.float64]:
    """Return when a live robot was how far from its simulated way's nearest point: s, m; shape (2, moments)."""
    mine = tracks[tracks["robot"] == robot]
    live, simulated = (mine[mine["run"] == run] for run in ("live", "simulated"))
    both = [way[["x_m", "y_m"]].to_numpy() for way in (live, simulated)]
    # The other way may have come further; its end alone does not count.
    apart = np.linalg.norm(both[0][:, None] - both[1][None], axis=2)
    return np.array([live["t_s"], apart.min(axis=1)])[:, apart.argmin(axis=1) < len(both[1]) - 1]


def apart_m(tracks: pd.DataFrame) -> float:
    """Return how far the live ways are from the simulated ones at most, in metres."""
    return max(float(off_m(tracks, area.robot)[1].max(initial=0.0)) for area in AREAS)


# --- Films ----------------------------------------------------------------------------------------------------

_SPEED = 5  # times real time
_FPS = 10
_SIZE = (9.6, 3.2)  # inches, at 100 dots each
_GREY = (170, 170, 170)


def film(run: Run[Config], name: str) -> bytes:
    """Return a drawn run as an MP4 file, five times as fast as it was."""
    return mp4(frames_of(run, name), (960, 320), fps=_FPS, crf=27, pixels="rgb24")


def frames_of(run: Run[Config], name: str) -> Iterator[NDArray[np.uint8]]:
    """Yield the pictures of a drawn run's film, RGB, shape (height, width, 3)."""
    tracks = run["track"][run["track"]["run"] == name]
    background, panels = _background(run, name)
    moments = [rows for _, rows in tracks.groupby("t_s")]
    step = max(1, round(_SPEED / _FPS / 0.1))
    trails: dict[str, list[list[int]]] = {area.robot: [] for area in AREAS}
    for rows in [*moments[::step], *[moments[-1]] * _FPS]:  # stands still for a second at its end
        yield _picture(background.copy(), panels, rows, trails, bytes.fromhex(RUN_COLORS[name][1:]))


def _background(run: Run[Config], name: str) -> tuple[NDArray[np.uint8], dict[str, Axes]]:
    """Return the empty areas as a picture, and each robot's axes in it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    example = run.metadata("examples")[name]
    with house_style():
        figure = Figure(figsize=_SIZE, dpi=100)
        canvas = FigureCanvasAgg(figure)
        panels = dict(
            zip([area.robot for area in AREAS], figure.subplots(1, len(AREAS)), strict=True)
        )
        for robot, axes in panels.items():
            draw_area(axes, robot)
            axes.set_title(robot, fontsize=9)
        figure.suptitle(
            f"{example['method']}, Rmax {example['rate_max_hz']} Hz: {example['end']}", fontsize=10
        )
        canvas.draw()  # type: ignore[no-untyped-call]
        image = np.asarray(canvas.buffer_rgba())[:, :, :3].copy()  # type: ignore[no-untyped-call]
    return image, panels


def _picture(
    image: NDArray[np.uint8],
    panels: dict[str, Axes],
    rows: pd.DataFrame,
    trails: dict[str, list[list[int]]],
    color: Sequence[int],
) -> NDArray[np.uint8]:
    import cv2

    def pixels(robot: str, points: NDArray[np.float64]) -> list[list[int]]:
        x, y = panels[robot].transData.transform(points).T
        found: list[list[int]] = (
            np.rint(np.column_stack((x, image.shape[0] - y))).astype(np.int32).tolist()
        )
        return found

    for (robot, way), area, row in zip(trails.items(), AREAS, lines_of(rows), strict=True):
        middle_m, heading = np.array((row.x_m, row.y_m)), row.heading_rad
        ranges, angles = scan_at(area, row.x_m, row.y_m, heading), heading + np.radians(BEAMS_DEG)
        seen = np.isfinite(ranges)
        ends = middle_m + (ranges[seen] * np.array((np.cos(angles[seen]), np.sin(angles[seen])))).T
        nose = middle_m + RADIUS_M * np.array((np.cos(heading), np.sin(heading)))
        edge = (row.x_m + RADIUS_M, row.y_m)
        middle, (edge_x, _), tip, *beams = pixels(robot, np.vstack((middle_m, edge, nose, ends)))
        way.append(middle)
        for end in beams:
            cv2.line(image, middle, end, _GREY, 1, cv2.LINE_AA)
        cv2.polylines(image, [np.array(way, np.int32)], isClosed=False, color=color, thickness=1)
        cv2.circle(image, middle, max(2, edge_x - middle[0]), color, -1, cv2.LINE_AA)
        cv2.line(image, middle, tip, (0, 0, 0), 1, cv2.LINE_AA)
    said, where = (
        f"{rows['t_s'].iloc[0]:5.1f} s   {rows['manoeuvre'].iloc[0]}",
        (12, image.shape[0] - 10),
    )
    cv2.putText(image, said, where, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    return image
