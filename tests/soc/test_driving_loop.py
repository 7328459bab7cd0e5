"""The closed loop: a lap in a town passes, and the judge fails a car that drives badly."""

import math
from dataclasses import asdict
from itertools import count

import numpy as np
import pytest
from graph_strategies import GRAPHS

from sfglab.soc import load_graph
from sfglab.soc.driving import Camera, Judge, Scene, Stack, make_town, run_lap
from sfglab.soc.driving.car import CarState
from sfglab.soc.driving.town import Light, Place

GRAPH = load_graph(GRAPHS / "driving.yaml")
TOWN = make_town(np.random.default_rng(1))
LINE_M = TOWN.lights[0].stop_m


def test_a_light_is_red_until_some_time_after_it_detects_a_car_or_follows_the_clock():
    resting = Light(stop_m=5.0, wait_s=6.0)
    found = [
        resting.red_since_s(*times) for times in ((100.0, None), (105.9, 100.0), (106.0, 100.0))
    ]
    assert found == [-math.inf, -math.inf, None]
    clocked = Light(stop_m=5.0, offset_s=1.0)
    found = [clocked.red_since_s(now_s, None) for now_s in (1.0, 6.9, 7.0, 12.9, 13.0)]
    assert found == [1.0, 1.0, None, None, 13.0]


def image_at(along_m, camera, *, red=False):
    scene = Scene(TOWN, camera, np.random.default_rng(3))
    return scene.render(CarState(**asdict(TOWN.lane.at(along_m))), [red] * 5, now_s=0.0)


@pytest.mark.parametrize("camera", [Camera(), Camera(width=640, height=480)])
def test_a_red_light_in_the_image_is_found(camera):
    red, green = (image_at(LINE_M - 0.4, camera, red=red) for red in (True, False))
    stack = Stack(camera)
    held = []
    for image in (green, red, green):
        stack.step(image)
        held.append(stack.control.held)
    assert held == [False, True, False]


@pytest.mark.parametrize("along_m", np.arange(0.5, 30, 3).tolist())
@pytest.mark.parametrize("camera", [Camera(), Camera(width=640, height=480)])
def test_the_lane_in_the_image_is_found_within_2_cm_where_the_car_aims(camera, along_m):
    lane = Stack(camera).step(image_at(along_m, camera)).lane
    aim = TOWN.lane.at(along_m + 0.9)
    middle = TOWN.lane.at(along_m).from_parent(aim.x_m, aim.y_m)
    assert lane.y_m(middle[0]) == pytest.approx(middle[1], abs=0.02)


TO_LIGHT_M = np.arange(0.0, LINE_M + 0.2, 0.1)
LAP_M = np.arange(0.0, TOWN.lane.length_m + 0.2, 0.1)


@pytest.mark.parametrize(
    ("along_m", "left_m", "speed_mps", "red_since_s", "found"),
    [
        # Run and obeyed lights, whether the lap is over, and whether it passes with no light to obey.
        (TO_LIGHT_M, 0.0, 0.9, -math.inf, (1, 0, False, False)),
        (TO_LIGHT_M, 0.0, 0.9, LINE_M - 0.5, (0, 0, False, False)),  # just turned
        ([LINE_M - 0.4], 0.0, 0.0, -math.inf, (0, 1, False, False)),
        ([LINE_M - 2.5], 0.0, 0.0, -math.inf, (0, 0, False, False)),  # too far away
        ([0.0], 0.2, 0.9, None, (0, 0, True, False)),  # left its lane
        (LAP_M, 0.0, 0.9, None, (0, 0, True, True)),
        (LAP_M, 0.0, 0.9, -math.inf, (1, 0, True, False)),
    ],
)
def test_the_judge_counts_lights_and_passes_a_lap_in_the_lane_that_runs_no_red_light(
    along_m, left_m, speed_mps, red_since_s, found
):
    verdicts = []
    for red_lights in (0, 3):
        judge = Judge(TOWN, red_lights=red_lights)
        for at_m in along_m:
            place = Place(along_m=at_m % TOWN.lane.length_m, left_m=left_m)
            judge.observe(at_m, place, speed_mps, [red_since_s, *[None] * 4])
        verdicts.append(judge.verdict())
    anyhow, enough = verdicts
    counted = anyhow.red_lights_run, anyhow.red_lights_obeyed, judge.over
    assert (*counted, anyhow.passed) == found
    assert not enough.passed, "three lights must be obeyed"


def test_the_car_completes_a_lap_in_its_lane_and_stops_at_three_red_lights_or_more():
    stack = Stack(Camera())
    lanes = []
    lap = run_lap(1, stack=stack, watch=lambda moment: lanes.append(moment.frame.lane))
    assert lap.verdict.passed
    assert lap.verdict.red_lights_obeyed >= 3
    assert lap.odometry_error_m < 0.05 * lap.lane_m
    assert lanes.count(None) < 0.05 * len(lanes)


def test_a_clock_gives_each_node_of_fig_9_its_time_in_every_frame():
    stack = Stack(Camera(), count(0, 1000).__next__)
    run_lap(1, stack=stack, timeout_s=0.4)
    assert stack.times_ns == {node.name: [1000] * 7 for node in GRAPH.nodes[1:-1]}
