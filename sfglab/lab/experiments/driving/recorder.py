"""The lap that is drawn: its town, its moments five times a second, some of them with their pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from sfglab.lab.experiments.driving.rows import DrivingTrackRow
from sfglab.soc.driving import Camera, Rules, Stack, make_town, run_lap
from sfglab.soc.driving.town import Signals

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.soc.driving import Frame, Lap, Town
    from sfglab.soc.driving.car import CarState


PICTURE_SIZE = (240, 180)
"""Width and height of pictures in the log; the camera's are larger."""

_TRACK_FRAMES, _PICTURE_FRAMES, _STANDING_FRAMES = 3, 6, 30
"""Of 15 frames a second, which are moments, and which of these have a picture: driving and standing."""

_JPEG_QUALITY = 25
_STANDING_MPS = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """A moment as it goes into the log."""

    row: DrivingTrackRow  #: What there is in numbers.
    image_jpeg: bytes = b""  #: The camera's image, smaller; empty without one.
    mask_png: bytes = b""  #: The lane planner's bird's view; empty without one.


def record_lap(seed: int, limit_s: float) -> tuple[Lap, list[Moment]]:
    """Drive a lap again and keep its moments.

    Args:
        seed: Of the town.
        limit_s: As for the lap that it repeats.

    Returns:
        The lap, without node times, and its moments.
    """
    stack = Stack(Camera())
    recorder = Recorder(make_town(np.random.default_rng(seed)), stack)
    lap = run_lap(seed, stack=stack, rules=Rules(timeout_s=limit_s), watch=recorder.watch)
    return lap, recorder.moments


class Recorder:
    """Watches a lap.

    Args:
        town: The lap's.
        stack: The nodes that drive.
    """

    def __init__(self, town: Town, stack: Stack) -> None:
        self.moments: list[Moment] = []
        self._town, self._stack = town, stack
        self._signals = Signals(town)  # they change by the car's place alone, so these are the lap's
        self._frames = 0

    def watch(self, now_s: float, car: CarState, frame: Frame) -> None:
        """Take a frame of `run_lap`."""
        place = self._town.lane.place(car.x_m, car.y_m)
        red = [since is not None for since in self._signals.red_since_s(now_s, place)]
        number, self._frames = self._frames, self._frames + 1
        if number % _TRACK_FRAMES:
            return
        every = _STANDING_FRAMES if car.speed_mps < _STANDING_MPS else _PICTURE_FRAMES
        pictured = number % every == 0
        row = self._row(now_s, car, frame, red=red, left_m=place.left_m, pictured=pictured)
        if pictured:
            self.moments.append(Moment(row=row, image_jpeg=_jpeg(frame.image), mask_png=_png(frame.mask)))
        else:
            self.moments.append(Moment(row=row))

    def _row(
        self, now_s: float, car: CarState, frame: Frame, *, red: list[bool], **more: Any
    ) -> DrivingTrackRow:
        lane, pose, command = frame.lane, frame.pose, frame.command
        return DrivingTrackRow(
            t_s=now_s,
            x_m=car.x_m,
            y_m=car.y_m,
            yaw_rad=car.yaw_rad,
            speed_mps=car.speed_mps,
            red="".join(str(int(one)) for one in red),
            held=self._stack.control.held,
            lane_seen=lane is not None,
            lane_offset_m=lane.offset_m if lane else math.nan,
            lane_slope=lane.slope if lane else math.nan,
            lane_bend_per_m=lane.bend_per_m if lane else math.nan,
            odometry_x_m=pose.x_m,
            odometry_y_m=pose.y_m,
            odometry_yaw_rad=pose.yaw_rad,
            command_mps=command.speed_mps,
            command_rps=command.yaw_rate_rps,
            **more,
        )


def town_metadata(seed: int) -> dict[str, Any]:
    """Return what stands in a town, in numbers for the log: metres, to the millimetre.

    Args:
        seed: Of the town.

    Returns:
        ``seed``; ``road``: the yellow line's points; ``buildings``: four corners each; ``lights``: middle of
        the stop line, heading, and whether it rests in red.
    """
    town = make_town(np.random.default_rng(seed))
    return {
        "seed": seed,
        "road": town.road.points_xy[::4].round(3).tolist(),
        "buildings": [_corners(b.x_m, b.y_m, b.yaw_rad, b.length_m, b.width_m) for b in town.buildings],
        "lights": [
            [*(round(value, 3) for value in town.lane.at(light.stop_m)), light.wait_s is not None]
            for light in town.lights
        ],
    }


def _corners(x_m: float, y_m: float, yaw_rad: float, length_m: float, width_m: float) -> list[list[float]]:
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    corners = signs * (length_m / 2, width_m / 2) @ np.array([[cos, sin], [-sin, cos]]) + (x_m, y_m)
    rounded: list[list[float]] = corners.round(3).tolist()
    return rounded


def _jpeg(bgr: NDArray[np.uint8]) -> bytes:
    small = cv2.resize(bgr, PICTURE_SIZE, interpolation=cv2.INTER_AREA)
    return cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


def _png(mask: NDArray[np.uint8]) -> bytes:
    return cv2.imencode(".png", mask, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()
