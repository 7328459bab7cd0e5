"""The chain's time beside the paper's, the lap that is drawn, all laps, and the drawn lap as a short film.

The film has the camera with the lane, the bird's view, the lights, and the car in its town, all from the log.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from sfglab.lab.experiments.driving.analysis import (
    LIVE,
    Picture,
    chain_ms,
    live_ms,
    parts_ms,
    pictures,
    ratio,
    saved_ms,
    stops,
)
from sfglab.lab.experiments.driving.experiment import MAPPINGS, PAPER_MS, READINGS, Config, exp
from sfglab.lab.experiments.driving.lap import lane_points, road_lines
from sfglab.lab.figures import COLORS, MARKERS, PAPER_STYLE, mp4, note
from sfglab.lab.runs import Run, lines_of
from sfglab.soc.driving import CHAIN, SHARED_TOPIC, Camera, Rules
from sfglab.soc.driving.nodes import WHITE, YELLOW, BirdView

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

_COLORS = {"software": COLORS["standard"], "gateway": COLORS["proxy"]}
_SAID = {"software": "A in\nsoftware", "gateway": "A with\na gateway"}
_LIGHTS = {True: "#D62728", False: "#2CA02C"}


@exp.figure("driving_chain", size=(10, 4.3))
def draw_chain(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the chain's time: each frame's, live as well, and what it is made of, with the paper's."""
    live = live_ms(run)
    left, *middle, right = figure.subplots(
        1, 3 if live else 2, width_ratios=(1.1, *[0.7] * bool(live), 1.8)
    )
    _draw_frames(left, chain_ms(run), PAPER_MS)
    for axes in middle:
        _draw_frames(axes, live, {})
    _draw_parts(right, run)
    figure.suptitle(
        f"The node chain from image to command: {ratio(run).value:.1f} times as fast with a gateway "
        f"(paper: 1.4), {saved_ms(run):.1f} ms saved (paper: 8.0 ms)"
    )
    frames = len(run["chain"])
    note(
        figure,
        f"{frames} frames; transfers modelled, nodes assumed in hardware, measured in software",
    )
    twin: dict[str, Any] = {"saved_ms": saved_ms(run), "frames": frames}
    for of, times in {
        LIVE: live,
        **{reading: chain_ms(run, reading) for reading in READINGS},
    }.items():
        for mapping, ms in times.items():
            twin[f"{of}, {mapping}"] = {"mean_ms": ms.mean(), "deviation_ms": ms.std(ddof=1)}
    return twin


def _draw_frames(
    axes: Axes, times: Mapping[str, Any], paper: Mapping[str, tuple[float, float]]
) -> None:
    """Draw a dot a frame, beside it mean and deviation here and in the paper; of live ones the latest not."""
    top, most = (
        1.2 * max(np.percentile(ms, 98) for ms in times.values()),
        max(map(np.max, times.values())),
    )
    for place, (mapping, ms) in enumerate(times.items()):
        aside = (np.arange(len(ms)) * 0.6180339887 % 1.0 - 0.5) * 0.3
        axes.plot(place - 0.2 + aside, ms, ".", color=_COLORS[mapping], markersize=2, alpha=0.5)
        _draw_mean(axes, place + 0.06, (float(ms.mean()), float(ms.std(ddof=1))), _COLORS[mapping])
        if mapping in paper:
            _draw_mean(axes, place + 0.5, paper[mapping], "black")
    axes.set(xlim=(-0.45, 1.75), ylim=(0, None if paper else top))
    axes.set_xticks((0, 1), [_SAID[mapping] for mapping in MAPPINGS])
    axes.set_ylabel("time of the chain (ms)")
    axes.grid(visible=False, axis="x")
    simulated = "simulated; mean ± deviation:\ncoloured ours, black the paper's"
    axes.set_title(
        simulated if paper else f"live across processes,\nup to {most:.0f} ms", fontsize=9
    )


def _draw_mean(axes: Axes, place: float, stated: tuple[float, float], color: str) -> None:
    mean, deviation = stated
    axes.errorbar(place, mean, deviation, fmt="o", color=color, capsize=4, markersize=4)
    said = f"{mean:.1f}\n± {deviation:.2f}"
    axes.annotate(said, (place, mean - deviation - 0.5), fontsize=8, ha="center", va="top")


def _draw_parts(axes: Axes, run: Run[Config]) -> None:
    """Draw means of nodes, topic A and other topics, one after the other, for both readings and mappings."""
    names = []
    for place, (reading, mapping) in enumerate(product(READINGS, MAPPINGS)):
        means = {name: float(ms.mean()) for name, ms in parts_ms(run, reading, mapping).items()}
        nodes, shared = sum(means[name] for name in CHAIN), means[SHARED_TOPIC]
        rest, left = sum(means.values()) - nodes - shared, 0.0
        shown = {"nodes": (nodes, COLORS["network"]), "A": (shared, _COLORS[mapping])}
        for said, (mean, color) in {**shown, "others": (rest, COLORS["third"])}.items():
            axes.barh(place, mean, 0.6, left, color=color, edgecolor="white")
            ink = "white" if color == COLORS["proxy"] else "black"
            where = (left + mean / 2, place)
            axes.annotate(
                f"{said}\n{mean:.1f}", where, ha="center", va="center", fontsize=8, color=ink
            )
            left += mean
        names.append(f"nodes in {reading},\n{_SAID[mapping]}: {left:.1f}")
    for mapping, (mean, _) in PAPER_MS.items():
        axes.axvline(mean, color=_COLORS[mapping], **PAPER_STYLE)
        axes.annotate(f" paper {mean:.1f}", (mean, -0.4), fontsize=8, va="bottom")
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.set(xlabel="mean time (ms)", xlim=(0, 34), ylim=(len(names) - 0.6, -0.7))
    axes.grid(visible=False, axis="y")


@exp.figure("driving_lap", size=(10, 6.2))
def draw_drawn_lap(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw one lap: the town and the track, the lateral error, four images with what was seen in them."""
    row = run["lap"].iloc[0]
    grid = figure.add_gridspec(3, 4, width_ratios=(0.8, 0.8, 1, 1), height_ratios=(1, 1, 0.6))
    _draw_map(figure.add_subplot(grid[:2, :2]), run)
    _draw_lateral(figure.add_subplot(grid[2, :]), run)
    moments = _chosen(run, pictures(run))
    for place, (said, picture) in enumerate(moments.items()):
        axes = figure.add_subplot(grid[place // 2, 2 + place % 2])
        moment = lines_of(run["track"][run["track"]["t_s"] == picture.t_s])[0]
        axes.imshow(draw_lane(picture.bgr, moment, width=480)[:, :, ::-1])
        axes.set_title(f"{said}, {picture.t_s:.1f} s", fontsize=8.5)
        axes.set_axis_off()
    ending, lights = "passed" if row["passed"] else "did not pass", int(row["red_lights_obeyed"])
    figure.suptitle(
        f"Town {int(row['seed'])}: {row['lap_s']:.1f} s, {lights} red lights obeyed, {ending}"
    )
    note(figure, "simulated town and car, real nodes on the drawn images; one lap")
    return {
        "seed": int(row["seed"]),
        "stops": [{"t_s": stop.t_s, "lasted_s": stop.lasted_s} for stop in stops(run)],
        "largest_lateral_m": float(row["largest_lateral_m"]),
        "images": {said: picture.t_s for said, picture in moments.items()},
    }


def _draw_map(axes: Axes, run: Run[Config]) -> None:
    for name, line in road_lines(run.metadata("town")).items():
        axes.plot(
            *np.array(line).T, color="#E6B800" if name == "yellow" else "#888888", linewidth=1.0
        )
    for corners in run.metadata("town")["buildings"]:
        axes.fill(*np.array(corners).T, color="#d8d4cc")
    axes.plot(run["track"]["x_m"], run["track"]["y_m"], color=COLORS["proxy"], linewidth=1.6)
    start = run["track"].iloc[0]
    axes.plot(start["x_m"], start["y_m"], MARKERS["network"], color="black", markersize=7)
    axes.annotate(
        "start", (start["x_m"], start["y_m"]), (6, 6), textcoords="offset points", fontsize=8
    )
    for number, (x, y, _, resting) in enumerate(run.metadata("town")["lights"], start=1):
        axes.plot(
            x, y, "s" if resting else "o", color="black", markerfacecolor="white", markersize=9
        )
        axes.annotate(str(number), (x, y), ha="center", va="center", fontsize=7)
    for stop in stops(run):
        axes.plot(stop.x_m, stop.y_m, "o", color=_LIGHTS[True], markersize=5)
        place = (stop.x_m + -0.22 * stop.x_m, stop.y_m + -0.22 * stop.y_m)
        axes.annotate(f"{stop.lasted_s:.0f} s", place, fontsize=8, ha="center")
    axes.set(aspect="equal", xlabel="east (m)", ylabel="north (m)")
    title = "the track, where it stood (red),\nlights at their lines (square: rests in red)"
    axes.set_title(title, fontsize=8.5)


def _draw_lateral(axes: Axes, run: Run[Config]) -> None:
    tracks, limit = run["track"], Rules().lateral_m * 100
    axes.plot(tracks["t_s"], tracks["left_m"] * 100, color=COLORS["proxy"], linewidth=1.2)
    for side in (-limit, limit):
        axes.axhline(side, color="black", linestyle=":", linewidth=1)
    for stop in stops(run):
        axes.axvspan(
            stop.t_s, stop.t_s + stop.lasted_s, color=_LIGHTS[True], alpha=0.15, linewidth=0
        )
    axes.set(xlim=(0, tracks["t_s"].iloc[-1]), ylim=(-limit * 1.15, limit * 1.15))
    axes.set(xlabel="time (s); red: the car stands", ylabel="left of the lane's\nmiddle (cm)")
    axes.set_title("dotted: a wheel would leave the lane", fontsize=8.5)


def _chosen(run: Run[Config], pictures: Sequence[Picture]) -> dict[str, Picture]:
    """Return four images by rule: the start, the first stop, the first after it, the sharpest bend."""
    bend, stood = run["track"].set_index("t_s")["lane_bend_per_m"].to_dict(), stops(run)
    bends = [abs(bend[one.t_s]) for one in pictures]
    chosen = {
        "at the start": pictures[0],
        "in the sharpest bend": pictures[int(np.nanargmax(bends))],
    }
    if stood:
        moments = {"at the first stop": stood[0].t_s, "after it": stood[0].t_s + stood[0].lasted_s}
        for name, t_s in moments.items():
            chosen[name] = next((one for one in pictures if one.t_s >= t_s), pictures[-1])
    return dict(sorted(chosen.items(), key=lambda item: item[1].t_s))


@exp.figure("driving_laps", size=(10.2, 5.4))
def draw_laps(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw all laps by seed: largest lateral error, red lights, odometry's error."""
    laps = run["lap"]
    columns = {
        "largest lateral error (cm)": laps["largest_lateral_m"] * 100,
        "red lights obeyed": laps["red_lights_obeyed"],
        "odometry's error at the end\n(% of the lap)": laps["odometry_error_m"]
        / laps["lane_m"]
        * 100,
    }
    limits = {0: Rules().lateral_m * 100, 1: Rules().red_lights}
    colors = [COLORS["proxy"] if passed else COLORS["standard"] for passed in laps["passed"]]
    panels = figure.subplots(3, 1, sharex=True)
    for place, (axes, (said, values)) in enumerate(zip(panels, columns.items(), strict=True)):
        axes.bar(laps["seed"], values, 0.7, color=colors)
        axes.set_ylabel(said, fontsize=8)
        axes.grid(visible=False, axis="x")
        if place in limits:
            axes.axhline(limits[place], color="black", linestyle=":", linewidth=1)
    panels[-1].set(
        xlabel="seed of the town", xticks=laps["seed"] if len(laps) <= 25 else laps["seed"][::5]
    )
    figure.suptitle(f"{int(laps['passed'].sum())} of {len(laps)} laps passed")
    note(
        figure,
        "simulated, a lap a town; dotted: the largest error allowed, the fewest lights asked for",
    )
    return {
        "passed": int(laps["passed"].sum()),
        "laps": len(laps),
        **{said.replace("\n", " "): values.tolist() for said, values in columns.items()},
    }


# --- The film -------------------------------------------------------------------------------------------------

_LANE_BGR = (230, 140, 20)
_FPS = 8
_WIDTH, _HEIGHT = 1184, 384
_CAMERA, _BIRD, _TOWN = (12, 12, 480), (504, 12, 320), (836, 12, 336)
"""Left, top and width of the three panels, in pixels."""

_TEXT_TOP = 282
_PAPER, _INK = (250, 250, 250), (40, 40, 40)
_LIGHTS_BGR = {True: (40, 40, 215), False: (60, 160, 40)}
_CAR_BGR = (178, 114, 0)
_EDGE_M = 9.3
_SHIFT = 4


def film(run: Run[Config]) -> bytes:
    """Return the drawn lap as an MP4 file: its pictures, eight a second; a stop shows one every two seconds."""
    return mp4(frames_of(run), (_WIDTH, _HEIGHT), fps=_FPS, crf=30, pixels="bgr24")


def frames_of(run: Run[Config]) -> Iterator[NDArray[np.uint8]]:
    """Yield the film's pictures, BGR, shape (height, width, 3)."""
    background = _background(run)
    lights = _pixels(np.array([light[:2] for light in run.metadata("town")["lights"]]))
    track = _pixels(run["track"][["x_m", "y_m"]].to_numpy())
    rows = {row.t_s: (number, row) for number, row in enumerate(lines_of(run["track"]))}
    for picture in pictures(run):
        number, row = rows[picture.t_s]
        image = background.copy()
        _put(image, _CAMERA, draw_lane(picture.bgr, row, width=_CAMERA[2]))
        _put(image, _BIRD, draw_bird(picture.mask, row))
        _draw_track(image, track[: number + 1], row, lights)
        _say(image, row)
        yield image


def _background(run: Run[Config]) -> NDArray[np.uint8]:
    """Return the empty picture with the town drawn in it."""
    image = np.full((_HEIGHT, _WIDTH, 3), _PAPER, np.uint8)
    for corners in run.metadata("town")["buildings"]:
        cv2.fillPoly(image, [_pixels(np.array(corners))], (204, 212, 216), cv2.LINE_AA, _SHIFT)
    for name, line in road_lines(run.metadata("town")).items():
        _polyline(
            image,
            _pixels(np.array(line)),
            (20, 180, 225) if name == "yellow" else (150, 150, 150),
            1,
        )
    return image


def _pixels(points_xy: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return a town's points in the film's picture, in parts of a pixel as OpenCV takes them."""
    left, top, width = _TOWN
    x, y = points_xy.T
    scale = width / (2 * _EDGE_M)
    return _parts(np.column_stack((left + (x + _EDGE_M) * scale, top + (_EDGE_M - y) * scale)))


def _parts(pixels: NDArray[np.float64]) -> NDArray[np.int32]:
    return np.asarray(np.rint(pixels * (1 << _SHIFT)), np.int32)


def _put(image: NDArray[np.uint8], place: tuple[int, int, int], part: NDArray[np.uint8]) -> None:
    left, top, _ = place
    image[top : top + part.shape[0], left : left + part.shape[1]] = part


def _polyline(image: Any, pixels: NDArray[np.int32], bgr: tuple[int, int, int], px: int) -> None:
    cv2.polylines(image, [pixels], False, bgr, px, cv2.LINE_AA, _SHIFT)


def _disc(image: NDArray[np.uint8], pixel: Any, radius: int, bgr: tuple[int, int, int]) -> None:
    x, y = (int(part) for part in pixel)
    cv2.circle(image, (x, y), radius << _SHIFT, bgr, cv2.FILLED, cv2.LINE_AA, _SHIFT)


def _draw_track(
    image: NDArray[np.uint8], way: NDArray[np.int32], row: Any, lights: NDArray[np.int32]
) -> None:
    _polyline(image, way, _CAR_BGR, 2)
    for pixel, red in zip(lights, row.red, strict=True):
        _disc(image, pixel, 6, _LIGHTS_BGR[red == "1"])
    nose = np.array([(row.x_m + 0.6 * np.cos(row.yaw_rad), row.y_m + 0.6 * np.sin(row.yaw_rad))])
    _polyline(image, np.vstack((way[-1:], _pixels(nose))), _INK, 2)
    _disc(image, way[-1], 5, _CAR_BGR)


def _say(image: NDArray[np.uint8], row: Any) -> None:
    """Write time, speed, command and what the lights did to the car below the bird's view."""
    lines = (
        (f"{row.t_s:.1f} s    {row.speed_mps:.2f} m/s", _INK),
        (f"{100 * row.left_m:+.1f} cm from the lane's middle", _INK),
        ("held by a red light", _LIGHTS_BGR[True]) if row.held else ("driving", _LIGHTS_BGR[False]),
        ("bird's view: yellow, white, lane", (130, 130, 130)),
    )
    for number, (said, color) in enumerate(lines):
        where = (_BIRD[0], _TEXT_TOP + 25 * number)
        cv2.putText(image, said, where, cv2.FONT_HERSHEY_SIMPLEX, 0.55, color, 1, cv2.LINE_AA)


def draw_lane(bgr: NDArray[np.uint8], row: Any, *, width: int) -> NDArray[np.uint8]:
    """Return the camera's image at another width, pixels, with the lane's middle of its ``track`` row in it."""
    camera = Camera()
    image = cv2.resize(
        bgr, (width, width * camera.height // camera.width), interpolation=cv2.INTER_CUBIC
    )
    if points := lane_points(row):
        pixels = camera.project(np.array([(x, y, 0.0) for x, y in points]))[0] * (
            width / camera.width
        )
        _polyline(image, _parts(pixels), _LANE_BGR, 3)
    return np.asarray(image, np.uint8)


def draw_bird(mask: NDArray[np.uint8], row: Any) -> NDArray[np.uint8]:
    """Return the lane planner's mask in its colours, with the lane's middle of its ``track`` row in it."""
    image = np.full((*mask.shape, 3), 50, np.uint8)
    image[mask == YELLOW] = (40, 190, 225)
    image[mask == WHITE] = (235, 235, 235)
    if points := lane_points(row):
        pixels = (
            np.array([(x, y, 1.0) for x, y in points])
            @ np.linalg.inv(BirdView().ground_from_bird).T
        )
        _polyline(image, _parts(pixels[:, :2]), _LANE_BGR, 2)
    return image
