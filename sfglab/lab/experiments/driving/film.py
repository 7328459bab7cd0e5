"""The drawn lap as a short film: camera with lane, bird's view, lights, and the car in its town.

Everything is in the log: pictures, moments and the town. OpenCV draws, PyAV encodes.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from sfglab.lab.experiments.driving.analysis import lines_of, pictures
from sfglab.lab.experiments.driving.lap import lane_points, road_lines
from sfglab.soc.driving import Camera
from sfglab.soc.driving.nodes import WHITE, YELLOW, BirdView

if TYPE_CHECKING:
    from collections.abc import Iterator

    from IPython.display import Video
    from numpy.typing import NDArray

    from sfglab.lab.experiments.driving.experiment import Config
    from sfglab.lab.runs import Run

_LANE_BGR = (230, 140, 20)
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


def show_film(run: Run[Config]) -> Video:
    """Return the film for the notebook."""
    from IPython.display import Video

    return Video(film(run), embed=True, mimetype="video/mp4", width=920)


def film(run: Run[Config]) -> bytes:
    """Return the drawn lap as an MP4 file: its pictures, eight a second; a stop shows one every two seconds."""
    import av

    buffer = io.BytesIO()
    # One thread, so that the same log gives the same file.
    with av.open(buffer, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=_FPS, options={"crf": "30", "threads": "1"})
        stream.width, stream.height = _WIDTH, _HEIGHT
        stream.pix_fmt = "yuv420p"
        for image in frames_of(run):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        container.mux(stream.encode(None))
    return buffer.getvalue()


def frames_of(run: Run[Config]) -> Iterator[NDArray[np.uint8]]:
    """Yield the film's pictures, BGR, shape (height, width, 3)."""
    background = _background(run)
    track = _pixels(run["track"][["x_m", "y_m"]].to_numpy())
    rows = {row.t_s: (number, row) for number, row in enumerate(lines_of(run["track"]))}
    for picture in pictures(run):
        number, row = rows[picture.t_s]
        image = background.copy()
        _put(image, _CAMERA, draw_lane(picture.bgr, row, width=_CAMERA[2]))
        _put(image, _BIRD, draw_bird(picture.mask, row))
        _draw_track(image, track[: number + 1], row, run)
        _say(image, row)
        yield image


def _background(run: Run[Config]) -> NDArray[np.uint8]:
    """Return the empty picture with the town drawn in it."""
    image = np.full((_HEIGHT, _WIDTH, 3), _PAPER, np.uint8)
    for corners in run.metadata("town")["buildings"]:
        cv2.fillPoly(image, [_pixels(np.array(corners))], (204, 212, 216), cv2.LINE_AA, _SHIFT)
    for name, line in road_lines(run.metadata("town")).items():
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


def _draw_track(image: NDArray[np.uint8], track: NDArray[np.int32], row: Any, run: Run[Config]) -> None:
    _polyline(image, track, _CAR_BGR, 2)
    for pixel, red in zip(_pixels(_light_places(run)), row.red, strict=True):
        _disc(image, pixel, 6, _LIGHTS[red == "1"])
    nose = np.array([(row.x_m + 0.6 * np.cos(row.yaw_rad), row.y_m + 0.6 * np.sin(row.yaw_rad))])
    _polyline(image, np.vstack((track[-1:], _pixels(nose))), _INK, 2)
    _disc(image, track[-1], 5, _CAR_BGR)


def _light_places(run: Run[Config]) -> NDArray[np.float64]:
    return np.array([light[:2] for light in run.metadata("town")["lights"]])


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


def draw_lane(bgr: NDArray[np.uint8], row: Any, *, width: int) -> NDArray[np.uint8]:
    """Return an image at another width with the lane's middle in it.

    Args:
        bgr: The image, of the default camera's shape.
        row: A line of the table ``track``.
        width: In pixels.
    """
    camera = Camera()
    height = width * camera.height // camera.width
    image = cv2.resize(bgr, (width, height), interpolation=cv2.INTER_CUBIC)
    points = lane_points(row)
    if points:
        ground = np.array([(x, y, 0.0) for x, y in points])
        pixels = camera.project(ground)[0] * (width / camera.width)
        _line(image, pixels, _LANE_BGR, 3)
    return np.asarray(image, np.uint8)


def draw_bird(mask: NDArray[np.uint8], row: Any) -> NDArray[np.uint8]:
    """Return the bird's view in its colours with the lane's middle in it.

    Args:
        mask: The lane planner's.
        row: A line of the table ``track``.
    """
    image = np.full((*mask.shape, 3), 50, np.uint8)
    image[mask == YELLOW] = (40, 190, 225)
    image[mask == WHITE] = (235, 235, 235)
    points = lane_points(row)
    if points:
        inverse = np.linalg.inv(BirdView().ground_from_bird)
        pixels = np.array([(x, y, 1.0) for x, y in points]) @ inverse.T
        _line(image, pixels[:, :2], _LANE_BGR, 2)
    return image


def _line(image: Any, pixels: NDArray[np.float64], bgr: tuple[int, int, int], width: int) -> None:
    points = np.rint(pixels * (1 << _SHIFT)).astype(np.int32)
    cv2.polylines(image, [points], False, bgr, width, cv2.LINE_AA, _SHIFT)
