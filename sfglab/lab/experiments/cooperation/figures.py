"""Figures 16, 17 and 18 of paper B, redrawn from a run, what was out of date when a run failed, and films.

In films the walls are drawn once by matplotlib; robots and beams are drawn onto that picture.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.arp.hallway import AREAS, BEAMS_DEG, HALF_WIDTH_M, HOME, RADIUS_M, WAYPOINTS, End, course_length_m
from sfglab.arp.robots import METHODS
from sfglab.lab.experiment import Look
from sfglab.lab.experiments.cooperation.analysis import contrasts, courses, difference, rates
from sfglab.lab.experiments.cooperation.experiment import Config, driven, exp, point_of
from sfglab.lab.experiments.cooperation.stage import scan_at
from sfglab.lab.figures import COLORS, MARKERS, grouped_bars, house_style, mp4
from sfglab.lab.runs import lines_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from sfglab.lab.runs import Run


RUN_COLORS = {
    "success": COLORS["third"],
    "failure": COLORS["standard"],
    "live": COLORS["proxy"],
    "simulated": COLORS["fourth"],
}
_DEPTH_MARKERS = {1: MARKERS["third"], 10: MARKERS["standard"], 1000: MARKERS["fourth"]}
_MARK_S = 10.0
_FAILED = "o"


@exp.figure("cooperation", size=(9.6, 6.1))
def draw_success(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the success rate of each method, a panel for each Rmax."""
    rows = courses(run)
    shown = sorted(rows["rate_max_hz"].unique())
    lines = (len(shown) + 1) // 2
    figure.set_size_inches(9.6, 2.7 * lines + 0.7)
    panels = figure.subplots(lines, min(2, len(shown)), squeeze=False, sharey=True).flat
    for axes, rate_hz in zip(panels, shown, strict=False):
        _draw_rates(axes, rows[rows["rate_max_hz"] == rate_hz])
        axes.set_title(f"Rmax = {rate_hz} Hz", fontsize=9)
    home = rates(rows, "method").set_index("method")["rate"]
    said = ", ".join(f"{name} {home[name]:.0%}" for name in ("none", "LC", "OPT", "OPT+LC") if name in home)
    figure.suptitle(f"Cooperation: rounds that three robots complete: {said}")
    more, names = difference(rows), ("successes", "runs", "low", "high")
    return {
        "rates": {
            f"{row.method}, Rmax {row.rate_max_hz}, depth {row.depth}": {n: getattr(row, n) for n in names}
            for row in lines_of(rates(rows, "method", "rate_max_hz", "depth"))
        },
        "difference": more,
        "course": {"length_m": course_length_m(), "width_m": 2 * HALF_WIDTH_M},
    }


def _draw_rates(axes: Axes, courses: pd.DataFrame) -> None:
    """Draw the success rates of one Rmax: a bar and its interval a method, a mark each depth."""
    table = rates(courses, "method")
    deep = rates(courses[courses["depth"] > 0], "method", "depth")
    for position, row in enumerate(lines_of(table)):
        optimised = METHODS[row.method].optimised
        axes.bar(position, row.rate, color=COLORS["third" if optimised else "proxy"], width=0.6)
        error = [[row.rate - row.low], [row.high - row.rate]]
        axes.errorbar(position, row.rate, yerr=error, color="black", capsize=3)
        for one in lines_of(deep[deep["method"] == row.method]):
            place = position + {1: -0.2, 10: 0.0, 1000: 0.2}.get(one.depth, 0.0)
            marker = _DEPTH_MARKERS.get(one.depth, "x")
            axes.plot(place, one.rate, marker, color="white", markeredgecolor="black", markersize=5)
    axes.set_xticks(range(len(table)), [name.replace("+", "\n+") for name in table["method"]], fontsize=8)
    axes.set(ylabel="runs that succeeded", ylim=(0, 1.08))
    axes.grid(visible=False, axis="x")
    if not deep.empty:
        _depth_legend(axes)


def _depth_legend(axes: Axes) -> None:
    for depth, marker in _DEPTH_MARKERS.items():
        axes.plot([], [], marker, color="white", markeredgecolor="black", markersize=5, label=f"depth {depth}")
    axes.legend(fontsize=7, loc="upper left", handletextpad=0.1)


@exp.figure("cooperation_tracks", size=(10.2, 7.1))
def draw_ways(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the three robots' ways in a run that succeeded (Fig. 17) and in one that failed (Fig. 18)."""
    examples = run.metadata("examples")
    shown: dict[str, Any] = {name: examples[name] for name in ("success", "failure") if name in examples}
    lines = max(1, len(shown))
    figure.set_size_inches(10.2, 3.3 * lines + 0.5)
    grid = figure.subplots(lines, len(AREAS), squeeze=False)
    for row, (name, example) in zip(grid, shown.items(), strict=False):
        _draw_run(row, run["track"][run["track"]["run"] == name], name, example)
    figure.suptitle("The three robots' ways, a mark every 10 s, and where the failure was")
    return shown


def _draw_run(row: Sequence[Axes], tracks: pd.DataFrame, name: str, example: dict[str, Any]) -> None:
    for axes, area in zip(row, AREAS, strict=True):
        draw_area(axes, area.robot)
        way = tracks[tracks["robot"] == area.robot]
        _draw_track(axes, way, RUN_COLORS[name])
        guilty = example["robot"] == area.robot
        if guilty:
            last = way.iloc[-1]
            axes.plot(last["x_m"], last["y_m"], "o", markersize=15, markerfacecolor="none", color="black")
        said = f"\n{example['end']} at {example['ended_s']:.1f} s" if guilty else ""
        axes.set_title(f"{area.robot}{said}", fontsize=9)
    label = "optimum" if example["depth"] == 0 else example["depth"]
    title = f"{name}: {example['method']}, Rmax {example['rate_max_hz']} Hz, depth {label}"
    row[0].set_ylabel(title, fontsize=8)


def draw_area(axes: Axes, robot: str) -> None:
    """Draw a robot's hallway and its home."""
    [area] = [area for area in AREAS if area.robot == robot]
    walls = 2 * len(WAYPOINTS)
    for number, (ax, ay, bx, by) in enumerate(area.segments):
        axes.plot([ax, bx], [ay, by], color="black" if number < walls else COLORS["network"], linewidth=1.3)
    for box in area.boxes:
        axes.fill(*box.corners().T, color=COLORS["network"], alpha=0.6)
    axes.plot(*HOME[:2], "+", color="black", markersize=9)
    axes.set(aspect="equal", xticks=(), yticks=())
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _draw_track(axes: Axes, way: pd.DataFrame, color: str, **style: Any) -> None:
    """Draw a robot's way with a mark every ten seconds, and the robot where it ended."""
    from matplotlib.patches import Circle

    axes.plot(way["x_m"], way["y_m"], color=color, linewidth=1.2, **style)
    every = way[np.isclose(way["t_s"] % _MARK_S, 0.0, atol=1e-6)]
    axes.plot(every["x_m"], every["y_m"], _FAILED, color=color, markersize=2.5)
    last = way.iloc[-1]
    axes.add_patch(Circle((last["x_m"], last["y_m"]), RADIUS_M, color=color, alpha=0.7))


@exp.look(
    "hallway",
    Look(
        turn=("methods", "rates_hz", "depths", "loss", "vendor", "seed"),
        needs=("course",),
        size=(10.2, 3.9),
        start={"methods": ("LC",), "rates_hz": (100,), "depths": (10,), "seeds": 1},
        reference="cooperation_tracks",
    ),
)
def draw_round(figure: Figure, run: Run[Config]) -> None:
    """Draw the three robots' ways in a run's first round."""
    row = lines_of(run["course"])[0]
    name = "success" if row.end == End.SUCCESS.value else "failure"
    tracks = pd.DataFrame(driven(point_of(row, run.config), row.seed)[0].tracks)
    _draw_run(figure.subplots(1, len(AREAS)), tracks, name, row._asdict())
    late = f"at worst {row.stale_flow} was out of date for {row.stale_s:.2f} s"
    figure.suptitle(f"{row.end} after {row.ended_s:.1f} s; {late}")


@exp.figure("cooperation_staleness", size=(9.6, 3.8))
def draw_staleness(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw for each run the longest time that something was out of date, successes beside failures."""
    rows, axes = courses(run), figure.subplots()
    names = [name for name in METHODS if name in set(rows["method"])]
    kinds = ((True, "third", "success"), (False, "standard", "failure"))
    for success, color, label in kinds:
        for position, name in enumerate(names):
            runs = rows[(rows["method"] == name) & (rows["success"] == success)]
            # Beside each other in a fixed pattern, so that the picture is the same each time.
            aside = (np.arange(len(runs)) * 0.6180339887 % 1.0 - 0.5) * 0.3 + (-0.18 if success else 0.18)
            stale = runs["stale_s"].clip(lower=1e-3)
            axes.plot(position + aside, stale, MARKERS[color], color=COLORS[color], markersize=3.5, alpha=0.7)
        axes.plot([], [], MARKERS[color], color=COLORS[color], markersize=4, label=label)
    axes.axhline(3.0, color="black", linestyle=(0, (4, 2)), linewidth=1.0)
    axes.annotate("heartbeat:\n3 s", (-0.48, 3.0), va="center", fontsize=8, backgroundcolor="white")
    axes.set(xlim=(-0.52, len(names) - 0.5), yscale="log")
    axes.set_xticks(range(len(names)), names)
    axes.set_ylabel("longest time out of date (s)")
    axes.grid(visible=False, axis="x")
    axes.legend(fontsize=8, loc="lower left", ncols=2)
    axes.set_title("What a run's readers missed at worst, and how it ended")
    medians = rows.groupby(["method", "success"])["stale_s"].median().reset_index()
    named = {True: "success", False: "failure"}
    return {f"{row.method}, {named[row.success]}": row.stale_s for row in lines_of(medians)}


@exp.figure("cooperation_contrasts", size=(8.6, 3.4), when=lambda run: not contrasts(run).empty)
def draw_contrasts(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the success rates as they are beside those of each contrast."""
    table, axes = contrasts(run), figure.subplots()
    spots = grouped_bars(axes, table, COLORS.values(), width=0.8)
    for at, kind in zip(spots, table.columns, strict=True):
        for spot, rate in zip(at.tolist(), table[kind], strict=True):
            said, turn = ("not run", 90) if np.isnan(rate) else (f"{rate:.2f}", 0)
            where = (spot, np.nan_to_num(rate))
            axes.annotate(said, where, ha="center", va="bottom", fontsize=7, rotation=turn)
    axes.set_xticks(range(len(table)), list(table.index))
    axes.set(ylabel="runs that succeeded", ylim=(0, 1.12))
    figure.legend(loc="outside lower center", ncols=len(table.columns))
    figure.suptitle("What keeps OPT+LC from completing the round, asked from the other side")
    return {str(kind): table[kind].dropna().to_dict() for kind in table.columns}


@exp.figure("cooperation_live", size=(10.2, 3.6), when=lambda run: bool((run["track"]["run"] == "live").any()))
def draw_live(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the live drive beside the simulated one."""
    tracks, live = run["track"], run.metadata("live")
    for axes, area in zip(figure.subplots(1, len(AREAS)), AREAS, strict=True):
        draw_area(axes, area.robot)
        for name, style in (("simulated", "-"), ("live", (0, (4, 2)))):
            way = tracks[(tracks["run"] == name) & (tracks["robot"] == area.robot)]
            _draw_track(axes, way, RUN_COLORS[name], linestyle=style, label=name)
        axes.set_title(area.robot, fontsize=9)
    figure.axes[0].legend(loc="center", fontsize=8, bbox_to_anchor=(0.42, 0.5))
    apart = apart_m(tracks)
    figure.suptitle(
        f"Live over DDS and simulated, the first {live['lasted_s']:.0f} s: apart by "
        f"{100 * apart:.0f} cm at most across the way"
    )
    return {"apart_m": apart, **live}


def apart_m(tracks: pd.DataFrame) -> float:
    """Return how far the live ways are from the simulated ones at most: to the nearest point of the other."""
    worst = 0.0
    for area in AREAS:
        both = [
            tracks[(tracks["run"] == run) & (tracks["robot"] == area.robot)][["x_m", "y_m"]].to_numpy()
            for run in ("live", "simulated")
        ]
        # The other way may have come further; its end alone does not count.
        distances = np.linalg.norm(both[0][:, None] - both[1][None], axis=2)
        nearest = distances.argmin(axis=1)
        within = nearest < len(both[1]) - 1
        worst = max(worst, float(distances.min(axis=1)[within].max(initial=0.0)))
    return worst


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
        panels = dict(zip([area.robot for area in AREAS], figure.subplots(1, len(AREAS)), strict=True))
        for robot, axes in panels.items():
            draw_area(axes, robot)
            axes.set_title(robot, fontsize=9)
        figure.suptitle(f"{example['method']}, Rmax {example['rate_max_hz']} Hz: {example['end']}", fontsize=10)
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
        found: list[list[int]] = np.rint(np.column_stack((x, image.shape[0] - y))).astype(np.int32).tolist()
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
    said, where = f"{rows['t_s'].iloc[0]:5.1f} s   {rows['manoeuvre'].iloc[0]}", (12, image.shape[0] - 10)
    cv2.putText(image, said, where, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    return image
