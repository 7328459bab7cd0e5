"""The module `loop` connects town, camera, nodes and car to a closed loop for one lap.

The class `Stack` contains the nodes and connects the nodes as in the graph of Fig. 9. A stack receives only images.
The function `run_lap` drives a car with a stack round a town. The stack calls the nodes one after the other, without
a bus.
"""

from __future__ import annotations

import math
import time
from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar, TypeVarTuple

import numpy as np

from sfglab.soc.driving.car import Camera, CarState, Drive, drive
from sfglab.soc.driving.judge import Judge, Verdict
from sfglab.soc.driving.nodes import (
    Colour,
    Lane,
    LaneControl,
    LightDetector,
    blur,
    compensate,
    fit_lane,
    lane_mask,
)
from sfglab.soc.driving.odometry import VisualOdometry
from sfglab.soc.driving.scene import Scene
from sfglab.soc.driving.town import Road, Signals, make_town

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from sfglab.soc.driving.pose import Pose

    Image = NDArray[np.uint8]

T = TypeVar("T")
Ts = TypeVarTuple("Ts")


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """A `Frame` has the results of the nodes for one image."""

    image: Image  #: Image of the camera (height, width, 3), BGR.
    mask: Image  #: Markings in the bird's-eye view.
    lane: Lane | None  #: Lane that the node found; None if the image shows no lane.
    pose: Pose  #: Pose of the car by the odometry.
    command: Drive  #: Drive command of the lane control.


class Stack:
    """A `Stack` runs all nodes on a camera's images, and measures each node's time with `clock_ns`."""

    def __init__(self, camera: Camera, clock_ns: Callable[[], int] = time.thread_time_ns) -> None:
        self.camera = camera
        self.red = LightDetector(Colour.RED)
        self.green = LightDetector(Colour.GREEN)
        self.odometry = VisualOdometry(camera)
        self.control = LaneControl()
        self._clock_ns = clock_ns
        #: Execution times in ns by node, one per frame.
        self.times_ns: dict[str, list[int]] = defaultdict(list)

    def step(self, image: Image) -> Frame:
        """Return the results of all nodes for an image (height, width, 3), BGR."""
        compensated = self._timed("compensation", compensate, image)
        blurred = self._timed("gaussian_blur", blur, compensated)
        mask = self._timed("lane_planner", lane_mask, blurred, self.camera)
        lane = self._timed("polyfit", fit_lane, mask)
        # Both detection nodes see the image before either node receives the message of the other node.
        red_found = self._timed("red_light_detection", self.red.detect, compensated)
        green_found = self._timed("green_light_detection", self.green.detect, compensated)
        if red_found:
            self.green.active = True
            self.control.held = True
        if green_found:
            self.red.active = True
            self.control.held = False
        pose = self._timed("visual_odometry", self.odometry.update, compensated)
        command = self._timed("lane_control", self.control.step, lane, pose)
        return Frame(image=image, mask=mask, lane=lane, pose=pose, command=command)

    def _timed(self, node: str, run: Callable[[*Ts], T], *args: *Ts) -> T:
        start_ns = self._clock_ns()
        result = run(*args)
        self.times_ns[node].append(self._clock_ns() - start_ns)
        return result


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """A `Moment` has the true state of the car and the results of the nodes in one frame."""

    now_s: float  #: Time in the town, s.
    car: CarState  #: True state of the car.
    frame: Frame  #: Results of the nodes.


@dataclass(frozen=True, slots=True, kw_only=True)
class Lap:
    """A `Lap` is the result of one lap."""

    verdict: Verdict  #: Result of the judge.
    lane_m: float  #: Length of the lane, m.
    odometry_error_m: float  #: Distance between the odometry's position and the car at the end, m.


_RATE_HZ = 15.0  #: Frame rate of the camera.
_STEPS = 4  #: Steps of the car's model per frame.
_BIAS_RAD = 0.02  #: Largest error of the steering angle.
_START_OFFSET = 0.06  #: Largest error of the start pose, m and rad.


def run_lap(
    seed: int,
    *,
    stack: Stack | None = None,
    timeout_s: float = 150.0,
    watch: Callable[[Moment], None] | None = None,
) -> Lap:
    """Drive one lap of a car round a town.

    A command takes effect one frame after its image, because a real node chain takes about one frame. The car moves
    at most 6 cm per frame.

    Args:
        seed: Seed of town, texture, noise, start pose and steering error.
        stack: The nodes. [default: new nodes for a default camera]
        timeout_s: Time in the town after which the lap has failed, s.
        watch: Function that the loop calls after each frame.
    """
    stack = stack or Stack(Camera())
    rng = np.random.default_rng(seed)
    town = make_town(rng)
    start = _start(town.lane, rng)
    steer_bias_rad = rng.uniform(-_BIAS_RAD, _BIAS_RAD)
    scene = Scene(town, stack.camera, rng)
    signals = Signals(town)
    judge = Judge(town, timeout_s=timeout_s)
    car = seen_from = start
    command = Drive()
    step_s = 1 / _RATE_HZ / _STEPS
    frames = 0
    while not judge.over:
        now_s = frames / _RATE_HZ
        place = town.lane.place(car.x_m, car.y_m)
        red_since_s = signals.red_since_s(now_s, place)
        judge.observe(now_s, place, car.speed_mps, red_since_s)
        red = [since_s is not None for since_s in red_since_s]
        frame = stack.step(scene.render(car, red, now_s=now_s))
        frames += 1
        if watch is not None:
            watch(Moment(now_s=now_s, car=car, frame=frame))
        seen_from = car
        for _ in range(_STEPS):
            car = drive(car, command, dt_s=step_s, steer_bias_rad=steer_bias_rad)
        command = frame.command
    error_m = _odometry_error_m(start, seen_from, stack.odometry.pose)
    return Lap(verdict=judge.verdict(), lane_m=town.lane.length_m, odometry_error_m=error_m)


def _start(lane: Road, rng: np.random.Generator) -> CarState:
    """Return the state of a standing car near the lane's first point."""
    place = lane.at(0.0, float(rng.uniform(-_START_OFFSET, _START_OFFSET)))
    yaw_error = float(rng.uniform(-_START_OFFSET, _START_OFFSET))
    return CarState(x_m=place.x_m, y_m=place.y_m, yaw_rad=place.yaw_rad + yaw_error)


def _odometry_error_m(start: CarState, end: CarState, pose: Pose) -> float:
    x_m, y_m = start.to_parent(pose.x_m, pose.y_m)
    return math.hypot(x_m - end.x_m, y_m - end.y_m)
