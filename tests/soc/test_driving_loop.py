"""The closed loop: a lap in a town passes, and the judge fails a car that drives badly."""

import math
from itertools import count

import numpy as np
import pytest

from sfglab.soc.driving import NODES, Camera, Judge, Rules, Scene, Stack, make_town, run_lap
from sfglab.soc.driving.car import CarState
from sfglab.soc.driving.nodes import LightDetector
from sfglab.soc.driving.odometry import Pose
from sfglab.soc.driving.town import Light, Place

TOWN = make_town(np.random.default_rng(1))
GREEN = [None] * 4  #: of all lights but the first


def on_lane(along_m: float, left_m: float = 0.0) -> Place:
    return Place(along_m=along_m, left_m=left_m)


def image_at(along_m: float, *, red: bool, camera: Camera) -> np.ndarray:
    x, y, yaw = TOWN.lane.at(along_m)
    scene = Scene(TOWN, camera, np.random.default_rng(3))
    return scene.render(CarState(x_m=x, y_m=y, yaw_rad=yaw), [red] * 5, now_s=0.0)


def seen_from(along_m: float) -> Pose:
    x_m, y_m, yaw_rad = TOWN.lane.at(along_m)
    return Pose(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)


# town


def test_a_seed_gives_one_town_and_a_road_finds_its_own_places():
    assert make_town(np.random.default_rng(1)).lights == TOWN.lights
    x, y, _ = TOWN.lane.at(12.0, 0.1)
    place = TOWN.lane.place(x, y)
    assert (place.along_m, place.left_m) == pytest.approx((12.0, 0.1), abs=0.03)


def test_a_light_is_red_until_some_time_after_it_detects_a_car_or_follows_the_clock():
    resting = Light(stop_m=5.0, wait_s=6.0)
    assert resting.red_since_s(100.0, None) == resting.red_since_s(105.9, 100.0) == -math.inf
    assert resting.red_since_s(106.0, 100.0) is None
    clocked = Light(stop_m=5.0, offset_s=1.0)
    found = [clocked.red_since_s(now_s, None) for now_s in (1.0, 6.9, 7.0, 12.9, 13.0)]
    assert found == [1.0, 1.0, None, None, 13.0]


# scene


@pytest.mark.parametrize("camera", [Camera(), Camera(width=640, height=480)])
def test_light_and_lane_in_the_image_are_found_and_a_seed_gives_one_image(camera):
    before_m = TOWN.lights[0].stop_m - 0.4
    red = image_at(before_m, red=True, camera=camera)
    green = image_at(before_m, red=False, camera=camera)
    assert (red == image_at(before_m, red=True, camera=camera)).all()
    stack = Stack(camera)
    held = []
    for image in (green, red, green):
        lane = stack.step(image).lane
        held.append(stack.control.held)
    assert held == [False, True, False]
    middle = TOWN.lane.at(before_m + 0.9)
    assert lane.y_m(0.9) == pytest.approx(seen_from(before_m).from_parent(*middle[:2])[1], abs=0.02)


# judge


def judge_of(*steps, red_since_s):
    judge = Judge(TOWN)
    for now_s, place, speed_mps in steps:
        judge.observe(now_s, place, speed_mps, [red_since_s, *GREEN])
    return judge


@pytest.mark.parametrize(("red_for_s", "run"), [(math.inf, 1), (0.5, 0)])
def test_a_line_crossed_at_red_is_run_unless_the_light_just_turned_red(red_for_s, run):
    stop_m = TOWN.lights[0].stop_m
    steps = [(s, on_lane(s), 0.9) for s in np.arange(0.0, stop_m + 0.2, 0.1)]
    assert judge_of(*steps, red_since_s=stop_m - red_for_s).verdict().red_lights_run == run


@pytest.mark.parametrize(("before_m", "obeyed"), [(0.4, 1), (2.5, 0)])
def test_a_stop_near_the_line_of_a_red_light_is_obeyed(before_m, obeyed):
    step = (5.0, on_lane(TOWN.lights[0].stop_m - before_m), 0.0)
    assert judge_of(step, red_since_s=-math.inf).verdict().red_lights_obeyed == obeyed


def test_a_car_that_leaves_its_lane_ends_the_lap_and_fails():
    judge = judge_of((0.0, on_lane(0.0, 0.2), 0.9), red_since_s=None)
    assert (judge.over, judge.verdict().passed) == (True, False)


# closed loop


def test_the_car_completes_a_lap_in_its_lane_and_stops_at_three_red_lights_or_more():
    stack = Stack(Camera())
    lanes = []
    lap = run_lap(
        1, stack=stack, rate_hz=10.0, watch=lambda moment: lanes.append(moment.frame.lane)
    )
    assert lap.verdict.passed
    assert lap.verdict.red_lights_obeyed >= 3
    assert lap.odometry_error_m < 0.05 * lap.lane_m
    assert stack.odometry.lost < 0.05 * len(lanes)
    assert lanes.count(None) < 0.05 * len(lanes)


class Blind(LightDetector):
    def detect(self, bgr):  # noqa: ARG002 - blind
        return False


def test_the_judge_fails_a_car_that_sees_no_red_light():
    stack = Stack(Camera())
    stack.red = Blind(stack.red.colour)
    resting_m = min(light.stop_m for light in TOWN.lights if light.wait_s is not None)
    verdict = run_lap(1, stack=stack, rules=Rules(timeout_s=resting_m / 0.9 + 3)).verdict
    assert verdict.red_lights_run >= 1
    assert not verdict.passed


def test_a_clock_gives_each_node_its_time_in_every_frame():
    stack = Stack(Camera(), count(0, 1000).__next__)
    run_lap(1, stack=stack, rules=Rules(timeout_s=0.4))
    times_ns = {ports.node: [1000] * 7 for ports in NODES[1:-1]}
    assert stack.times_ns == times_ns
