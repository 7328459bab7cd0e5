"""The drawn lap as a short film: camera with lane, bird's view, lights, and the car in its town.

Everything is in the log: pictures, moments and the town. OpenCV draws, PyAV encodes.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from sfglab.lab.experiments.driving.analysis import lines_of, load_pictures, load_results
from sfglab.lab.experiments.driving.overlay import draw_bird, draw_lane
from sfglab.lab.experiments.driving.replay import road_lines

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from IPython.display import Video
    from numpy.typing import NDArray

    from sfglab.lab.experiments.driving.analysis import Results


_FPS = 8
_WIDTH, _HEIGHT = 1184, 384
_CAMERA, _BIRD, _TOWN = (12, 12, 480), (504, 12, 320), (836, 12, 336)
"""Left, top and width of the three panels, in pixels."""

_TEXT_TOP = 282
_PAPER, _INK = (250, 250, 250), (40, 40, 40)
_LIGHTS = {True: (40, 40, 215), False: (60, 160, 40)}
_CAR_BGR = (178, 114, 0)
_EDGE_M = 9.3
_SHIFT = 4


def show_film(log: Path) -> Video:
    """Return the film for the notebook.

    Args:
        log: The run's log.
    """
    from IPython.display import Video

    return Video(film(log), embed=True, mimetype="video/mp4", width=920)


def film(log: Path) -> bytes:
    """Return the drawn lap as an MP4 file: all its pictures, eight a second; a stop is seen every two seconds.

    Args:
        log: The run's log.
    """
    import av

    buffer = io.BytesIO()
    # One thread, so that the same log gives the same file.
    with av.open(buffer, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=_FPS, options={"crf": "30", "threads": "1"})
        stream.width, stream.height = _WIDTH, _HEIGHT
        stream.pix_fmt = "yuv420p"
        for image in frames_of(log):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        container.mux(stream.encode(None))
    return buffer.getvalue()


def frames_of(log: Path) -> Iterator[NDArray[np.uint8]]:
    """Yield the film's pictures, BGR, shape (height, width, 3).

    Args:
        log: The run's log.
    """
    results = load_results(log)
    background = _background(results)
    track = _pixels(results.tracks[["x_m", "y_m"]].to_numpy())
    rows = {row.t_s: (number, row) for number, row in enumerate(lines_of(results.tracks))}
    for picture in load_pictures(log):
        number, row = rows[picture.t_s]
        image = background.copy()
        _put(image, _CAMERA, draw_lane(picture.bgr, row, width=_CAMERA[2]))
        _put(image, _BIRD, draw_bird(picture.mask, row))
        _draw_track(image, track[: number + 1], row, results)
        _say(image, row)
        yield image


def _background(results: Results) -> NDArray[np.uint8]:
    """Return the empty picture with the town drawn in it."""
    image = np.full((_HEIGHT, _WIDTH, 3), _PAPER, np.uint8)
    for corners in results.town["buildings"]:
        cv2.fillPoly(image, [_pixels(np.array(corners))], (204, 212, 216), cv2.LINE_AA, _SHIFT)
    for name, line in road_lines(results.town).items():
        color = (20, 180, 225) if name == "yellow" else (150, 150, 150)
        _polyline(image, _pixels(np.array(line)), color, 1)
    return image


def _pixels(points_xy: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return a town's points in the film's picture, in parts of a pixel as OpenCV takes them."""
    left, top, width = _TOWN
    x, y = points_xy.T
    scale = width / (2 * _EDGE_M)
    raw = np.column_stack((left + (x + _EDGE_M) * scale, top + (_EDGE_M - y) * scale))
    return np.asarray(np.rint(raw * (1 << _SHIFT)), np.int32)


def _put(image: NDArray[np.uint8], place: tuple[int, int, int], part: NDArray[np.uint8]) -> None:
    left, top, _ = place
    image[top : top + part.shape[0], left : left + part.shape[1]] = part


def _polyline(image: NDArray[np.uint8], pixels: NDArray[np.int32], bgr: tuple[int, int, int], px: int) -> None:
    cv2.polylines(image, [pixels], False, bgr, px, cv2.LINE_AA, _SHIFT)


def _disc(image: NDArray[np.uint8], pixel: Any, radius: int, bgr: tuple[int, int, int]) -> None:
    x, y = (int(part) for part in pixel)
    cv2.circle(image, (x, y), radius << _SHIFT, bgr, cv2.FILLED, cv2.LINE_AA, _SHIFT)


def _draw_track(image: NDArray[np.uint8], track: NDArray[np.int32], row: Any, results: Results) -> None:
    _polyline(image, track, _CAR_BGR, 2)
    for pixel, red in zip(_pixels(_light_places(results)), row.red, strict=True):
        _disc(image, pixel, 6, _LIGHTS[red == "1"])
    nose = np.array([(row.x_m + 0.6 * np.cos(row.yaw_rad), row.y_m + 0.6 * np.sin(row.yaw_rad))])
    _polyline(image, np.vstack((track[-1:], _pixels(nose))), _INK, 2)
    _disc(image, track[-1], 5, _CAR_BGR)


def _light_places(results: Results) -> NDArray[np.float64]:
    return np.array([light[:2] for light in results.town["lights"]])


def _say(image: NDArray[np.uint8], row: Any) -> None:
    """Write time, speed, command and what the lights did to the car below the bird's view."""
    lines = (
        (f"{row.t_s:.1f} s    {row.speed_mps:.2f} m/s", _INK),
        (f"{100 * row.left_m:+.1f} cm from the lane's middle", _INK),
        ("held by a red light", _LIGHTS[True]) if row.held else ("driving", _LIGHTS[False]),
        ("bird's view: yellow, white, lane", (130, 130, 130)),
    )
    for number, (said, color) in enumerate(lines):
        where = (_BIRD[0], _TEXT_TOP + 25 * number)
        cv2.putText(image, said, where, cv2.FONT_HERSHEY_SIMPLEX, 0.55, color, 1, cv2.LINE_AA)
