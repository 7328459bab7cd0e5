"""The driving application's nodes, each with images whose answer is known."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from sfglab.soc.driving import Camera, nodes
from sfglab.soc.driving.car import CarState, Drive, drive
from sfglab.soc.driving.odometry import VisualOdometry, planar_motion
from sfglab.soc.driving.pose import Pose

STRAIGHT = nodes.Lane(offset_m=0.0, slope=0.0, bend_per_m=0.0)
RED, GREEN = nodes.Colour
BGR = {RED: (45, 45, 250), GREEN: (70, 235, 60)}


def grey_image(level=90):
    return np.full((240, 320, 3), level, np.uint8)


def lamp(colour, radius=10):
    return cv2.circle(grey_image(), (200, 90), radius, BGR[colour], cv2.FILLED, cv2.LINE_AA)


def test_a_car_at_constant_yaw_rate_returns_and_one_that_brakes_keeps_its_limit():
    car = CarState(speed_mps=1.0, steer_rad=math.atan(0.26))
    assert drive(car, Drive(), dt_s=0.1).speed_mps == pytest.approx(0.85)
    for _ in range(100):
        car = drive(car, Drive(speed_mps=1.0, yaw_rate_rps=1.0), dt_s=math.tau / 100)
    assert (car.x_m, car.y_m, car.yaw_rad) == pytest.approx((0, 0, 0), abs=1e-6)


def test_compensation_removes_outliers_keeps_an_edge_and_uses_all_levels():
    image = grey_image(60)
    image[:, 160:] = 180
    image[50, 50] = image[100, 250] = (255, 0, 255)
    clean = nodes.compensate(image)
    assert (clean[:, :160] == 0).all()
    assert (clean[:, 160:] == 255).all()


# lane planner and polyfit: `test_driving_loop` has their answers in images of a town


def mask_of(*lines):
    """The mask of a straight lane with lines at distances to the left, m, seen from above."""
    mask = np.zeros((240, 320), np.uint8)
    for left_m, colour in lines:
        column = round(160 - 100 * left_m)
        mask[:, column - 2 : column + 2] = colour
    return mask


YELLOW, WHITE = (0.25, nodes.YELLOW), (-0.25, nodes.WHITE)


def test_one_line_is_enough_and_lines_beyond_it_and_across_do_not_move_the_lane():
    across = mask_of(YELLOW, WHITE, (0.75, nodes.WHITE))
    across[120:125, 140:180] = nodes.WHITE  # a stop line
    for seen in (mask_of(YELLOW), mask_of(WHITE), across):
        assert nodes.fit_lane(seen).y_m(0.9) == pytest.approx(0.0, abs=0.02)
    assert nodes.fit_lane(mask_of()) is None


# traffic lights


@pytest.mark.parametrize("colour", [RED, GREEN])
def test_a_round_lamp_is_found_by_its_own_colour_with_its_radius(colour):
    for each in (RED, GREEN):
        radii = [9] if each is colour else []
        assert list(nodes.lamp_radii(lamp(colour, 9), each)) == pytest.approx(radii, abs=1.2)
    bar = cv2.rectangle(grey_image(), (100, 80), (160, 90), BGR[colour], cv2.FILLED)
    assert not list(nodes.lamp_radii(bar, colour))


def test_each_detection_wakes_the_other_and_sleeps_after_it_found_its_light():
    red, green = nodes.LightDetector(RED), nodes.LightDetector(GREEN)
    assert not green.detect(lamp(GREEN)), "green starts inactive"
    assert not red.detect(lamp(RED, 4)), "too far away"
    assert not red.detect(lamp(RED, 20)), "the car can no longer stop"
    assert red.detect(lamp(RED))
    assert not red.detect(lamp(RED)), "red is inactive now"
    green.active = True
    assert not green.detect(lamp(RED))
    assert green.detect(lamp(GREEN))
    assert not green.active


# lane control


def test_the_car_is_slower_in_bends_stands_at_red_and_drives_to_its_last_point_without_a_lane():
    control = nodes.LaneControl()
    assert control.step(None, Pose()) == Drive(), "no lane so far"
    assert control.step(STRAIGHT, Pose()) == Drive(speed_mps=0.9)
    assert control.step(None, Pose(x_m=0.3, y_m=0.1)).yaw_rate_rps < 0
    assert control.step(None, Pose(x_m=0.7)) == Drive(), "the last point"
    bend = control.step(replace(STRAIGHT, bend_per_m=0.4), Pose())
    assert bend.yaw_rate_rps > 0
    assert bend.speed_mps < 0.9
    control.held = True
    assert control.step(STRAIGHT, Pose()) == Drive()
    control.held = False
    assert control.step(STRAIGHT, Pose()).speed_mps > 0


# odometry


@pytest.mark.parametrize("seed", range(20))
def test_planar_motion_is_found_among_a_quarter_of_wrong_matches(seed):
    rng = np.random.default_rng(seed)
    x_m, y_m, yaw_rad = rng.uniform(-0.4, 0.4, 3)
    motion = Pose(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)
    now = rng.uniform((0.5, -1), (3, 1), (60, 2))
    before = np.array([motion.to_parent(*point) for point in now])
    before[:15] += rng.uniform(0.3, 1.0, (15, 2))
    found = planar_motion(before, now)
    assert (found.x_m, found.y_m, found.yaw_rad) == pytest.approx((x_m, y_m, yaw_rad), abs=1e-6)
    assert planar_motion(before[-7:], now[-7:]) is None, "too few"


def test_matches_in_one_place_tell_no_turn():
    now = np.random.default_rng(0).uniform(0, 1, (10, 2))
    found = planar_motion(np.ones((10, 2)), now)
    x_m, y_m = 1 - now.mean(axis=0)
    assert (found.x_m, found.y_m, found.yaw_rad) == pytest.approx((x_m, y_m, 0))


def test_an_image_without_features_loses_the_odometry_and_does_not_move_it():
    odometry = VisualOdometry(Camera())
    assert [odometry.update(grey_image()) for _ in range(2)] == [Pose(), Pose()]
