"""The driving application's nodes, each with images whose answer is known."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from sfglab.errors import InvalidValueError
from sfglab.soc import load_graph
from sfglab.soc.driving import NODES, Camera, nodes
from sfglab.soc.driving.car import CarState, Drive, drive
from sfglab.soc.driving.odometry import Pose, VisualOdometry, planar_motion

GRAPH = Path(__file__).parents[2] / "data/graphs/driving.yaml"
STRAIGHT = nodes.Lane(offset_m=0.0, slope=0.0, bend_per_m=0.0)
RED = (45, 45, 250)
GREEN = (70, 235, 60)


def grey_image(level: int = 90) -> np.ndarray:
    return np.full((240, 320, 3), level, np.uint8)


def with_lamp(bgr: tuple[int, int, int], radius: int) -> np.ndarray:
    return cv2.circle(grey_image(), (200, 90), radius, bgr, cv2.FILLED, cv2.LINE_AA)


def test_the_nodes_have_the_names_and_topics_of_the_graph_of_fig_9():
    graph = load_graph(GRAPH)
    assert {ports.node for ports in NODES} == {node.name for node in graph.nodes}
    for ports in NODES:
        subscribed = {topic.name for topic in graph.topics if ports.node in topic.subscribers}
        published = {topic.name for topic in graph.topics if ports.node in topic.publishers}
        assert (set(ports.subscribes), set(ports.publishes)) == (subscribed, published), ports.node


# car and camera


def test_a_camera_below_the_ground_is_refused():
    with pytest.raises(InvalidValueError, match=r"mount_m: given .*, allowed: above zero"):
        Camera(mount_m=-0.1)


def test_a_car_at_constant_yaw_rate_returns_and_one_that_brakes_keeps_its_limit():
    car = CarState(speed_mps=1.0, steer_rad=math.atan(0.26))
    assert drive(car, Drive(), dt_s=0.1).speed_mps == pytest.approx(0.85)
    for _ in range(100):
        car = drive(car, Drive(speed_mps=1.0, yaw_rate_rps=1.0), dt_s=math.tau / 100)
    assert (car.x_m, car.y_m, car.yaw_rad) == pytest.approx((0, 0, 0), abs=1e-6)


# compensation and blur


def test_compensation_removes_outliers_keeps_an_edge_and_uses_all_levels():
    image = grey_image(60)
    image[:, 160:] = 180
    image[50, 50] = image[100, 250] = (255, 0, 255)
    clean = nodes.compensate(image)
    assert (clean[:, :160] == 0).all()
    assert (clean[:, 160:] == 255).all()


def test_the_blur_spreads_a_pixel_and_keeps_its_sum():
    image = grey_image(0)
    image[120, 160] = 250
    blurred = nodes.blur(image)
    assert blurred[120, 160, 0] < 60
    assert int(blurred[..., 0].sum()) == pytest.approx(250, abs=15)


# lane planner and polyfit


def mask_of(lane: nodes.Lane) -> np.ndarray:
    """The mask of an image of a lane with a yellow line on the left and a white one on the right."""
    image = grey_image()
    x = np.linspace(0.4, 4.0, 200)
    middle = lane.offset_m + lane.slope * x + lane.bend_per_m * x * x
    for side, bgr in ((0.25, (40, 190, 225)), (-0.25, (235, 240, 240))):
        left = np.stack([x, middle + side + 0.025, 0 * x], axis=1)
        right = np.stack([x, middle + side - 0.025, 0 * x], axis=1)
        pixels = Camera().project(np.vstack([left, right[::-1]]))[0]
        cv2.fillPoly(image, [np.rint(pixels).astype(np.int32)], bgr)
    return nodes.lane_mask(image, Camera())


@pytest.mark.parametrize(
    ("offset_m", "slope", "bend_per_m"),
    [(0.0, 0.0, 0.0), (0.08, 0.0, 0.0), (-0.03, 0.1, 0.0), (0.0, 0.0, 0.12), (0.02, -0.05, -0.08)],
)
def test_a_drawn_lane_is_found_within_2_cm_where_the_car_aims(offset_m, slope, bend_per_m):
    lane = nodes.Lane(offset_m=offset_m, slope=slope, bend_per_m=bend_per_m)
    found = nodes.fit_lane(mask_of(lane))
    assert found is not None
    for x_m in (0.6, 0.9, 1.5):
        assert found.y_m(x_m) == pytest.approx(lane.y_m(x_m), abs=0.02)


def test_one_line_is_enough_and_lines_beyond_it_and_across_do_not_move_the_lane():
    mask = mask_of(STRAIGHT)
    more = mask.copy()
    more[:, 80:85] = nodes.WHITE  # a line beyond the yellow one
    more[120:125, 140:180] = nodes.WHITE  # a stop line
    only_yellow = np.where(mask == nodes.YELLOW, mask, 0)
    only_white = np.where(mask == nodes.WHITE, mask, 0)
    for seen in (only_yellow, only_white, more):
        assert nodes.fit_lane(seen).y_m(0.9) == pytest.approx(0.0, abs=0.02)
    assert nodes.fit_lane(mask * 0) is None


# traffic lights


@pytest.mark.parametrize(("bgr", "colour"), [(RED, nodes.Colour.RED), (GREEN, nodes.Colour.GREEN)])
def test_a_round_lamp_is_found_by_its_own_colour_with_its_radius(bgr, colour):
    image = with_lamp(bgr, 9)
    for each in nodes.Colour:
        radii = [9] if each is colour else []
        assert list(nodes.lamp_radii(image, each)) == pytest.approx(radii, abs=1.2)
    bar = cv2.rectangle(grey_image(), (100, 80), (160, 90), bgr, cv2.FILLED)
    assert not list(nodes.lamp_radii(bar, colour))


@pytest.mark.parametrize(("radius", "found"), [(4, False), (10, True), (20, False)])
def test_a_red_light_counts_where_the_car_can_still_stop_and_see_it(radius, found):
    assert nodes.LightDetector(nodes.Colour.RED).detect(with_lamp(RED, radius)) is found


def test_each_detection_wakes_the_other_and_sleeps_after_it_found_its_light():
    red = nodes.LightDetector(nodes.Colour.RED)
    green = nodes.LightDetector(nodes.Colour.GREEN)
    assert not green.detect(with_lamp(GREEN, 10)), "green starts inactive"
    assert red.detect(with_lamp(RED, 10))
    assert not red.detect(with_lamp(RED, 10)), "red is inactive now"
    green.wake()
    assert not green.detect(with_lamp(RED, 10))
    assert green.detect(with_lamp(GREEN, 10))
    red.wake()
    assert (red.active, green.active) == (True, False)


# lane control


def test_the_car_is_slower_in_bends_and_stands_from_red_to_green():
    control = nodes.LaneControl()
    assert control.step(STRAIGHT, Pose()) == Drive(speed_mps=0.9)
    bend = control.step(nodes.Lane(offset_m=0.0, slope=0.0, bend_per_m=0.4), Pose())
    assert bend.yaw_rate_rps > 0
    assert bend.speed_mps < 0.9
    control.stop()
    assert control.step(STRAIGHT, Pose()) == Drive()
    control.go()
    assert control.step(STRAIGHT, Pose()).speed_mps > 0


def test_without_a_lane_the_car_drives_to_the_last_point_by_odometry_and_stops_there():
    control = nodes.LaneControl()
    assert control.step(None, Pose()) == Drive(), "no lane so far"
    control.step(STRAIGHT, Pose())
    assert control.step(None, Pose(x_m=0.3, y_m=0.1)).yaw_rate_rps < 0
    assert control.step(None, Pose(x_m=0.7)) == Drive()


# odometry


@pytest.mark.parametrize("seed", range(20))
def test_planar_motion_is_found_among_a_quarter_of_wrong_matches(seed):
    rng = np.random.default_rng(seed)
    x_m, y_m, yaw_rad = rng.uniform(-0.4, 0.4, 3)
    motion = Pose(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)
    now = rng.uniform((0.5, -1), (3, 1), (60, 2))
    before = np.array([motion.to_parent(*point) for point in now])
    assert motion.from_parent(*before[-1]) == pytest.approx(now[-1].tolist())
    before[:15] += rng.uniform(0.3, 1.0, (15, 2))
    found = planar_motion(before, now)
    assert (found.x_m, found.y_m, found.yaw_rad) == pytest.approx((x_m, y_m, yaw_rad), abs=1e-6)
    assert planar_motion(before[-7:], now[-7:]) is None, "too few"


def test_an_image_without_features_loses_the_odometry_and_does_not_move_it():
    odometry = VisualOdometry(Camera())
    assert odometry.update(grey_image()) == Pose()
    assert odometry.update(grey_image()) == Pose()
    assert odometry.lost == 1
