"""The closed loop: town, camera, nodes, car, round and round, and the judge of a lap.

`Stack` is the nodes wired as in the graph, from an image to a command; it gets pixels and nothing else.
`run_lap` drives it round a town and has it judged. Refuses to know a bus: nodes are called one after the other.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.soc.driving.car import Camera, CarState, Chassis, Drive, drive
from sfglab.soc.driving.nodes import (
    BirdView,
    Colour,
    Lane,
    LaneControl,
    LightDetector,
    blur,
    compensate,
    fit_lane,
    lane_mask,
)
from sfglab.soc.driving.odometry import Pose, VisualOdometry
from sfglab.soc.driving.scene import Scene
from sfglab.soc.driving.town import LANE_M, Place, Signals, Town, make_town

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """What the judge asks for."""

    #: Farther from the lane's middle a wheel leaves the lane (half a lane less half a car of 18 cm).
    lateral_m: float = LANE_M / 2 - 0.09
    red_lights: int = 3  #: Fewest that the car must have stopped at.
    #: A line crossed so soon after the light turned red is not held against the car: at 0.9 m/s it brakes for
    #: 0.6 s, and a look takes it some frames.
    grace_s: float = 1.0
    stop_m: float = 2.0  #: How near before its line a car stops for a light.
    timeout_s: float = 150.0  #: A lap that takes longer has failed.


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What the judge saw."""

    completed: bool  #: Whether the car came round.
    red_lights_obeyed: int  #: Red lights that it stopped at and did not run.
    red_lights_run: int  #: Lines that it crossed at red.
    largest_lateral_m: float  #: Largest distance of the rear axle from the lane's middle.
    lap_s: float  #: Time of the run, in the town.
    passed: bool  #: Whether the rules are met.


class Judge:
    """Watches a run from its first frame at place 0, and judges it; a car is where its rear axle is."""

    def __init__(self, town: Town, rules: Rules | None = None) -> None:
        self._town = town
        self.rules = rules or Rules()
        self.driven_m = 0.0
        self._largest_m = 0.0
        self._stopped: set[int] = set()
        self._run: set[int] = set()
        self._before: Place | None = None
        self._now_s = 0.0

    def watch(
        self, now_s: float, car: Place, speed_mps: float, red_since_s: Sequence[float | None]
    ) -> None:
        """Take a frame: the car's true place on its lane and speed, and since when each light is red."""
        self._now_s = now_s
        self._largest_m = max(self._largest_m, abs(car.left_m))
        length = self._town.lane.length_m
        if self._before is not None:
            step = (car.along_m - self._before.along_m + length / 2) % length - length / 2
            self._watch_lines(self.driven_m, self.driven_m + step, red_since_s)
            self.driven_m += step
        self._before = car
        for i, (light, since) in enumerate(zip(self._town.lights, red_since_s, strict=True)):
            if (
                since is not None
                and speed_mps < 0.02
                and 0 <= light.stop_m - car.along_m <= self.rules.stop_m
            ):
                self._stopped.add(i)

    def _watch_lines(
        self, before_m: float, now_m: float, red_since_s: Sequence[float | None]
    ) -> None:
        for i, (light, since) in enumerate(zip(self._town.lights, red_since_s, strict=True)):
            late = since is not None and self._now_s - since > self.rules.grace_s
            if late and before_m < light.stop_m <= now_m:
                self._run.add(i)

    @property
    def over(self) -> bool:
        """Whether there is nothing left to see: a lap driven, the lane left, or the time up."""
        left = self._largest_m > self.rules.lateral_m
        return (
            self.driven_m >= self._town.lane.length_m or left or self._now_s >= self.rules.timeout_s
        )

    def verdict(self) -> Verdict:
        """Return what was seen so far."""
        completed = self.driven_m >= self._town.lane.length_m
        obeyed = len(self._stopped - self._run)
        in_lane = self._largest_m <= self.rules.lateral_m
        return Verdict(
            completed=completed,
            red_lights_obeyed=obeyed,
            red_lights_run=len(self._run),
            largest_lateral_m=self._largest_m,
            lap_s=self._now_s,
            passed=completed and in_lane and not self._run and obeyed >= self.rules.red_lights,
        )


_BIAS_RAD = 0.02  #: Largest error of a car's steering, drawn for each run; the nodes are not told.

_STEPS = 4  #: Steps of the car's model a frame.


@dataclass(frozen=True, slots=True)
class Ports:
    """A node's topics, named as in the graph of paper C, Fig. 9."""

    node: str  #: Its name.
    subscribes: tuple[str, ...]  #: Topics that it hears.
    publishes: tuple[str, ...]  #: Topics that it says something on.


NODES = (
    Ports("camera", (), ("/image",)),
    Ports("compensation", ("/image",), ("/A",)),
    Ports("gaussian_blur", ("/A",), ("/blurred",)),
    Ports("lane_planner", ("/blurred",), ("/lane_mask",)),
    Ports("polyfit", ("/lane_mask",), ("/lane",)),
    Ports("red_light_detection", ("/A", "/green_light"), ("/red_light",)),
    Ports("green_light_detection", ("/A", "/red_light"), ("/green_light",)),
    Ports("visual_odometry", ("/A",), ("/pose",)),
    Ports("lane_control", ("/lane", "/red_light", "/green_light", "/pose"), ("/cmd_vel",)),
    Ports("car", ("/cmd_vel",), ()),
)
"""Every node's topics, in the order of the chain; a test compares them with the graph's file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """Everything that the nodes said about one image."""

    image: NDArray[np.uint8]
    compensated: NDArray[np.uint8]
    blurred: NDArray[np.uint8]
    mask: NDArray[np.uint8]
    lane: Lane | None
    red: bool
    green: bool
    pose: Pose
    command: Drive


@dataclass(frozen=True, slots=True, kw_only=True)
class Lap:
    """A run's record."""

    seed: int  #: Of the town.
    verdict: Verdict  #: The judge's.
    frames: int  #: Images seen.
    lanes_missed: int  #: Of them, those in which no lane was found.
    odometry_error_m: float  #: Distance between where the odometry ends and where the car is.
    odometry_lost: int  #: Frames that the odometry could not match.
    #: Mean seconds a frame by node; empty without a clock. `camera` is the renderer.
    node_s: dict[str, float] = field(default_factory=dict)


class Stopwatch:
    """What each node took in each frame, by a clock of nanoseconds; None measures nothing."""

    def __init__(self, clock: Callable[[], int] | None = None) -> None:
        self._clock = clock
        #: Nanoseconds by node, one a call, in the calls' order.
        self.frames_ns: dict[str, list[int]] = {}

    def __call__(self, node: str, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Call a node's function and return what it returns."""
        if self._clock is None:
            return function(*args, **kwargs)
        start_ns = self._clock()
        value = function(*args, **kwargs)
        self.frames_ns.setdefault(node, []).append(self._clock() - start_ns)
        return value


class Stack:
    """The nodes, wired as in the graph, for a camera's images; a clock of nanoseconds times them."""

    def __init__(self, camera: Camera, clock: Callable[[], int] | None = None) -> None:
        self.view = BirdView(camera=camera)
        self.red, self.green = LightDetector(Colour.RED), LightDetector(Colour.GREEN)
        self.control = LaneControl()
        self.odometry = VisualOdometry(camera)
        self.timed = Stopwatch(clock)  #: What the nodes took, frame by frame.

    def step(self, image: NDArray[np.uint8]) -> Frame:
        """Return what all nodes say to an image."""
        timed = self.timed
        compensated = timed("compensation", compensate, image)
        blurred = timed("gaussian_blur", blur, compensated)
        mask = timed("lane_planner", lane_mask, blurred, self.view)
        lane = timed("polyfit", fit_lane, mask, self.view, lane_m=LANE_M)
        red, green = self._lights(compensated)
        pose = timed("visual_odometry", self.odometry.see, compensated)
        command = timed("lane_control", self.control.step, lane, pose)
        return Frame(
            image=image,
            compensated=compensated,
            blurred=blurred,
            mask=mask,
            lane=lane,
            red=red,
            green=green,
            pose=pose,
            command=command,
        )

    def _lights(self, compensated: NDArray[np.uint8]) -> tuple[bool, bool]:
        """Run both detectors on an image, then deliver what they published; whoever wakes looks at the next."""
        red = self.timed("red_light_detection", self.red.see, compensated)
        green = self.timed("green_light_detection", self.green.see, compensated)
        if red:
            self.green.hear_other()
            self.control.hear_red()
        if green:
            self.red.hear_other()
            self.control.hear_green()
        return red, green


def run_lap(
    seed: int,
    *,
    stack: Stack | None = None,
    rules: Rules | None = None,
    rate_hz: float = 15.0,
    watch: Callable[[float, CarState, Frame], None] | None = None,
) -> Lap:
    """Drive one lap and have it judged; the seed is that of town, textures and noise.

    A command takes effect one frame after its image, as long as a real chain takes. 15 Hz: the car moves 6 cm
    a frame, a fifteenth of its lookahead. `watch` is called with time, the car's true state and what the
    nodes said, after each frame. Without a stack, the nodes are those of a default camera without a clock.
    """
    stack = stack or Stack(Camera())
    rng = np.random.default_rng(seed)
    town = make_town(rng)
    car = seen_from = start = _start(town, rng)
    chassis = Chassis(steer_bias_rad=rng.uniform(-_BIAS_RAD, _BIAS_RAD))
    scene, signals, judge = Scene(town, stack.view.camera, rng), Signals(town), Judge(town, rules)
    frames, missed, command = 0, 0, Drive()
    while not judge.over:
        now_s = frames / rate_hz
        place = town.lane.place(car.x_m, car.y_m)
        red_since_s = signals.red_since_s(now_s, place)
        judge.watch(now_s, place, car.speed_mps, red_since_s)
        red = [since is not None for since in red_since_s]
        frame = stack.step(stack.timed("camera", scene.render, car, red, now_s=now_s))
        frames, missed = frames + 1, missed + (frame.lane is None)
        if watch is not None:
            watch(now_s, car, frame)
        seen_from = car
        for _ in range(_STEPS):
            car = drive(car, command, dt_s=1 / rate_hz / _STEPS, chassis=chassis)
        command = frame.command
    return Lap(
        seed=seed,
        verdict=judge.verdict(),
        frames=frames,
        lanes_missed=missed,
        odometry_error_m=_error_m(start, seen_from, stack.odometry.pose),
        odometry_lost=stack.odometry.lost,
        node_s={node: sum(ns) / 1e9 / frames for node, ns in stack.timed.frames_ns.items()},
    )


def _start(town: Town, rng: np.random.Generator) -> CarState:
    """Return a car at the lane's first point, put down carelessly: a few centimetres and degrees off."""
    x_m, y_m, yaw_rad = town.lane.at(0.0, float(rng.uniform(-0.06, 0.06)))
    return CarState(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad + float(rng.uniform(-0.06, 0.06)))


def _error_m(start: CarState, end: CarState, pose: Pose) -> float:
    """Return how far from the car the odometry, begun at its start, believes it to be."""
    x_m, y_m = Pose(x_m=start.x_m, y_m=start.y_m, yaw_rad=start.yaw_rad).outwards(
        pose.x_m, pose.y_m
    )
    return float(np.hypot(x_m - end.x_m, y_m - end.y_m))
