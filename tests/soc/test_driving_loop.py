"""The closed loop: a lap in a town passes, and the judge fails those who drive badly."""

import math
from itertools import count

import numpy as np
import pytest

from sfglab.soc.driving import (
    NODES,
    Camera,
    Judge,
    Rules,
    Scene,
    Stack,
    Stopwatch,
    make_town,
    run_lap,
)
from sfglab.soc.driving.car import CarState
from sfglab.soc.driving.nodes import LightDetector
from sfglab.soc.driving.town import Light, Place, Road, Signals

TOWN = make_town(np.random.default_rng(1))


class Blind(LightDetector):
    def see(self, bgr):  # noqa: ARG002 - blind
        return False


# town


@pytest.mark.parametrize("seed", range(5))
def test_no_building_stands_on_the_road_or_in_another(seed):
    town = make_town(np.random.default_rng(seed))
    assert len(town.buildings) > 10
    for i, building in enumerate(town.buildings):
        away = np.hypot(*(town.road.points_xy - (building.x_m, building.y_m)).T).min()
        assert away - building.radius_m > 1.0
        for other in town.buildings[:i]:
            apart = math.hypot(other.x_m - building.x_m, other.y_m - building.y_m)
            assert apart > other.radius_m + building.radius_m


def test_a_seed_is_a_town_points_are_found_and_a_circle_s_road_has_its_length():
    again = make_town(np.random.default_rng(1))
    assert (again.lights, again.buildings) == (TOWN.lights, TOWN.buildings)
    x, y, _ = TOWN.lane.at(12.0, 0.1)
    place = TOWN.lane.place(x, y)
    assert (place.along_m, place.left_m) == pytest.approx((12.0, 0.1), abs=0.03)
    angle = np.linspace(0, math.tau, 1000, endpoint=False)
    road = Road(np.column_stack([np.cos(angle), np.sin(angle)]))
    assert road.length_m == pytest.approx(math.tau, rel=1e-4)
    assert road.at(0.0) == pytest.approx((1, 0, math.pi / 2), abs=1e-3)


def test_a_light_rests_in_red_until_it_notices_a_car_before_its_line_or_keeps_its_clock():
    resting, clocked = Light(stop_m=5.0, wait_s=6.0), Light(stop_m=5.0, offset_s=1.0)
    assert resting.red_since_s(100.0, None) == resting.red_since_s(105.9, 100.0) == -math.inf
    assert resting.red_since_s(106.0, 100.0) is None
    assert [clocked.red_since_s(t, None) for t in (1.0, 6.9, 7.0, 12.9, 13.0)] == [
        1.0,
        1.0,
        None,
        None,
        13.0,
    ]
    signals, stop = Signals(TOWN), next(li.stop_m for li in TOWN.lights if li.wait_s is not None)
    index = [light.stop_m for light in TOWN.lights].index(stop)
    signals.red_since_s(0.0, Place(along_m=stop + 0.1, left_m=0.0))
    assert signals.red_since_s(60.0, Place(along_m=stop - 1.0, left_m=0.0))[index] is not None
    assert signals.red_since_s(70.0, Place(along_m=stop - 1.0, left_m=0.0))[index] is None


# scene


def test_the_image_shows_a_red_or_a_green_lamp_and_the_same_seed_the_same_image():
    x, y, yaw = TOWN.lane.at(TOWN.lights[0].stop_m - 0.4)
    car = CarState(x_m=x, y_m=y, yaw_rad=yaw)
    stack = Stack(Camera())
    images = [
        Scene(TOWN, Camera(), np.random.default_rng(3)).render(car, [red] * 5, now_s=0.0)
        for red in (True, True, False)
    ]
    assert (images[0] == images[1]).all()
    assert stack.step(images[2]).red is False
    assert stack.step(images[0]).red is True
    assert stack.step(images[2]).green is True


def test_a_camera_of_640_x_480_finds_the_same_lane():
    x, y, yaw = TOWN.lane.at(3.0)
    car = CarState(x_m=x, y_m=y, yaw_rad=yaw)
    lanes = []
    for camera in (Camera(), Camera(width=640, height=480)):
        image = Scene(TOWN, camera, np.random.default_rng(3)).render(car, [True] * 5, now_s=0.0)
        lanes.append(Stack(camera).step(image).lane)
    assert lanes[0].y_m(0.9) == pytest.approx(lanes[1].y_m(0.9), abs=0.02)


# judge


def judged(steps, red_since_s, rules=None):
    judge = Judge(TOWN, rules)
    for now_s, along_m, left_m, speed_mps in steps:
        judge.watch(now_s, Place(along_m=along_m, left_m=left_m), speed_mps, red_since_s)
    return judge


def test_a_line_crossed_at_red_is_run_unless_just_turned_and_out_of_its_lane_a_car_fails():
    stop = TOWN.lights[0].stop_m
    steps = [(10.0, stop - 0.1, 0.0, 0.9), (10.1, stop + 0.1, 0.0, 0.9)]
    assert judged(steps, [-math.inf, *[None] * 4]).verdict().red_lights_run == 0, (
        "starts in the middle"
    )
    whole = [(0.0, 0.0, 0.0, 0.0), *[(a, a, 0.0, 0.9) for a in np.arange(0.1, stop + 0.2, 0.1)]]
    assert judged(whole, [-math.inf, *[None] * 4]).verdict().red_lights_run == 1
    assert judged(whole, [stop - 0.5, *[None] * 4]).verdict().red_lights_run == 0
    judge = judged([(0.0, 0.0, 0.2, 0.9)], [None] * 5)
    assert (judge.over, judge.verdict().passed) == (True, False)


@pytest.mark.parametrize(("before_m", "obeyed"), [(0.4, 1), (2.5, 0)])
def test_a_stop_before_a_red_light_is_obeyed_and_one_far_away_is_not(before_m, obeyed):
    judge = judged([(5.0, TOWN.lights[0].stop_m - before_m, 0.0, 0.0)], [-math.inf, *[None] * 4])
    assert judge.verdict().red_lights_obeyed == obeyed


# closed loop


def test_the_car_completes_a_lap_in_its_lane_and_stops_at_three_red_lights_or_more():
    lap = run_lap(1, rate_hz=10.0)
    assert lap.verdict.passed
    assert lap.verdict.red_lights_obeyed >= 3
    assert lap.odometry_lost < 0.05 * lap.frames
    assert lap.lanes_missed < 0.05 * lap.frames


def test_the_judge_fails_a_car_that_sees_no_red_light_or_steers_the_wrong_way():
    stack = Stack(Camera())
    stack.red = Blind(stack.red.colour)
    resting = min(light.stop_m for light in TOWN.lights if light.wait_s is not None)
    verdict = run_lap(1, stack=stack, rules=Rules(timeout_s=resting / 0.9 + 3)).verdict
    assert verdict.red_lights_run >= 1
    assert not verdict.passed
    stack = Stack(Camera())
    step = stack.control.step
    stack.control.step = lambda lane, pose: step(
        lane
        and type(lane)(offset_m=-lane.offset_m, slope=-lane.slope, bend_per_m=-lane.bend_per_m),
        pose,
    )
    verdict = run_lap(1, stack=stack, rules=Rules(timeout_s=10)).verdict
    assert not verdict.completed
    assert not verdict.passed


def test_a_clock_gives_each_node_its_time_in_every_frame_and_without_one_nothing_is_timed():
    stack = Stack(Camera(), count(0, 1000).__next__)
    lap = run_lap(1, stack=stack, rules=Rules(timeout_s=0.4))
    timed = {ports.node for ports in NODES if ports.subscribes} - {"car"} | {"camera"}
    assert set(stack.timed.frames_ns) == set(lap.node_s) == timed
    assert {len(times) for times in stack.timed.frames_ns.values()} == {lap.frames}
    assert lap.node_s["polyfit"] == pytest.approx(1e-6)
    stopwatch = Stopwatch()
    assert stopwatch("node", max, 1, 2) == 2
    assert stopwatch.frames_ns == {}
