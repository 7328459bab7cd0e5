"""A drawn run as a short film: the three areas, the robots, their beams, and what the station has released.

The walls are drawn once by matplotlib; robots and beams are drawn onto that picture, and PyAV encodes it.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.hallway import AREAS, BEAMS_DEG, RADIUS_M
from sfglab.lab.experiments.cooperation.analysis import lines_of
from sfglab.lab.experiments.cooperation.figures import RUN_COLORS, draw_area
from sfglab.lab.experiments.cooperation.stage import scan_at
from sfglab.lab.figures import house_style

if TYPE_CHECKING:
    from collections.abc import Iterator

    import pandas as pd
    from IPython.display import Video
    from numpy.typing import NDArray

    from sfglab.lab.experiments.cooperation.experiment import Config
    from sfglab.lab.runs import Run


_SPEED = 5  # times real time
_FPS = 10
_SIZE = (9.6, 3.2)  # inches, at 100 dots each
_GREY = (170, 170, 170)


def show_film(run: Run[Config], name: str) -> Video:
    """Return a film for the notebook.

    Args:
        run: The run.
        name: One of the drawn runs.
    """
    from IPython.display import Video

    return Video(film(run, name), embed=True, mimetype="video/mp4", width=860)


def film(run: Run[Config], name: str) -> bytes:
    """Return a drawn run as an MP4 file, five times as fast as it was.

    Args:
        run: The run.
        name: One of the drawn runs.
    """
    import av

    buffer = io.BytesIO()
    # One thread, so that the same log gives the same file.
    with av.open(buffer, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=_FPS, options={"crf": "27", "threads": "1"})
        stream.width, stream.height = (int(100 * inches) for inches in _SIZE)
        stream.pix_fmt = "yuv420p"
        for image in frames_of(run, name):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    return buffer.getvalue()


def frames_of(run: Run[Config], name: str) -> Iterator[NDArray[np.uint8]]:
    """Yield the film's pictures, RGB, shape (height, width, 3).

    Args:
        run: The run.
        name: One of the drawn runs.
    """
    tracks = run["track"][run["track"]["run"] == name]
    background, places = _background(run, name)
    moments = sorted(tracks["t_s"].unique())
    step = max(1, round(_SPEED / _FPS / 0.1))
    by_moment = dict(iter(tracks.groupby("t_s")))
    trails: dict[str, list[NDArray[np.int32]]] = {area.robot: [] for area in AREAS}
    chosen = [*moments[::step], *[moments[-1]] * _FPS]  # stands still for a second at its end
    for moment in chosen:
        yield _picture(background.copy(), places, by_moment[moment], trails, _rgb(RUN_COLORS[name]))


def _rgb(color: str) -> tuple[int, int, int]:
    red, green, blue = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return red, green, blue


def _background(run: Run[Config], name: str) -> tuple[NDArray[np.uint8], dict[str, Any]]:
    """Return the empty areas as a picture, and for each robot what makes pixels of metres."""
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
    height = image.shape[0]

    def pixels(axes: Any) -> Any:
        def convert(points: NDArray[np.float64]) -> NDArray[np.int32]:
            x, y = axes.transData.transform(points).T
            converted: NDArray[np.int32] = np.rint(np.column_stack((x, height - y))).astype(np.int32)
            return converted

        return convert

    return image, {robot: pixels(axes) for robot, axes in panels.items()}


def _picture(
    image: NDArray[np.uint8],
    places: dict[str, Any],
    rows: pd.DataFrame,
    trails: dict[str, list[NDArray[np.int32]]],
    color: tuple[int, int, int],
) -> NDArray[np.uint8]:
    import cv2

    for area, row in zip(AREAS, lines_of(rows), strict=True):
        pixels = places[area.robot]
        middle = np.array((row.x_m, row.y_m))
        edge = (row.x_m + RADIUS_M, row.y_m)
        (cx, cy), (ex, _) = pixels(np.stack((middle, edge))).tolist()
        trails[area.robot].append(np.array((cx, cy), np.int32))
        ranges = scan_at(area, row.x_m, row.y_m, row.heading_rad)
        angles = row.heading_rad + np.radians(BEAMS_DEG)
        seen = np.isfinite(ranges)
        ends = middle + (ranges[seen] * np.array((np.cos(angles[seen]), np.sin(angles[seen])))).T
        for x, y in pixels(ends).tolist():
            cv2.line(image, (cx, cy), (x, y), _GREY, 1, cv2.LINE_AA)
        cv2.polylines(image, [np.stack(trails[area.robot])], isClosed=False, color=color, thickness=1)
        cv2.circle(image, (cx, cy), max(2, ex - cx), color, -1, cv2.LINE_AA)
        nose = middle + RADIUS_M * np.array((np.cos(row.heading_rad), np.sin(row.heading_rad)))
        cv2.line(image, (cx, cy), tuple(pixels(nose[None])[0].tolist()), (0, 0, 0), 1, cv2.LINE_AA)
    said = f"{rows['t_s'].iloc[0]:5.1f} s   {rows['manoeuvre'].iloc[0]}"
    cv2.putText(
        image, said, (12, image.shape[0] - 10), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA
    )
    return image
