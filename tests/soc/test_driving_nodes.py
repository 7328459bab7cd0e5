"""The driving application's nodes, each with pictures whose answer is known."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.soc import load_graph
from sfglab.soc.driving import NODES, Camera, nodes
from sfglab.soc.driving.car import CarState, Chassis, Drive, drive
from sfglab.soc.driving.odometry import Pose, VisualOdometry, planar_motion

GRAPH = Path(__file__).parents[2] / "data/graphs/driving.yaml"
VIEW = nodes.BirdView()
STRAIGHT = nodes.Lane(offset_m=0.0, slope=0.0, bend_per_m=0.0)


def grey_image(level: int = 90) -> np.ndarray:
    return np.full((240, 320, 3), level, np.uint8)


def with_lamp(bgr: tuple[int, int, int], radius: int) -> np.ndarray:
    return cv2.circle(grey_image(), (200, 90), radius, bgr, cv2.FILLED, cv2.LINE_AA)


RED, GREEN = (45, 45, 250), (70, 235, 60)


def test_the_nodes_hear_and_say_what_the_graph_of_fig_9_has():
    graph = load_graph(GRAPH)
    assert {ports.node for ports in NODES} == {node.name for node in graph.nodes}
    for ports in NODES:
        heard = {topic.name for topic in graph.topics if ports.node in topic.subscribers}
        said = {topic.name for topic in graph.topics if ports.node in topic.publishers}
        assert (set(ports.subscribes), set(ports.publishes)) == (heard, said), ports.node


# camera


def test_a_ground_point_to_the_left_lies_left_of_the_middle_and_the_ground_s_homography_undoes_it():
    camera, points = Camera(), np.array([[2.0, 0.0, 0.0], [2.0, 0.5, 0.0], [1.3, -0.2, 0.0]])
    pixels, depth = camera.project(points)
    assert pixels[0, 0] == pytest.approx(160)
    assert pixels[0, 1] > camera.horizon_row
    assert pixels[1, 0] < pixels[0, 0]
    assert (depth > 0).all()
    raw = np.column_stack([pixels, np.ones(3)]) @ camera.ground_from_image.T
    assert raw[:, :2] / raw[:, 2:] == pytest.approx(points[:, :2])


def test_a_camera_below_the_ground_is_refused():
    with pytest.raises(InvalidValueError, match=r"mount_m: given .*, allowed: above zero"):
        Camera(mount_m=-0.1)


# car


def test_a_car_at_constant_yaw_rate_comes_back_brakes_hard_and_leaves_its_line_by_its_steering():
    chassis = Chassis(steer_rate_rps=1e9, acceleration_mps2=1e9)
    command = Drive(speed_mps=1.0, yaw_rate_rps=1.0)
    start = car = drive(CarState(), command, dt_s=1e-9, chassis=chassis)
    for _ in range(100):
        car = drive(car, command, dt_s=math.tau / 100, chassis=chassis)
    assert (car.x_m, car.y_m, car.yaw_rad) == pytest.approx(
        (start.x_m, start.y_m, start.yaw_rad), abs=1e-6
    )
    car, chassis = CarState(speed_mps=0.9), Chassis(steer_bias_rad=0.02)
    assert drive(car, Drive(), dt_s=0.1, chassis=Chassis()).speed_mps == pytest.approx(0.75)
    off = drive(car, Drive(speed_mps=0.9), dt_s=1.0, chassis=chassis)
    assert off.yaw_rad == pytest.approx(0.9 * math.tan(0.02) / 0.26)


# compensation, blur


def test_compensation_keeps_an_edge_the_stretch_swaps_no_levels_and_the_blur_keeps_the_sum():
    image = grey_image(60)
    image[:, 160:] = 180
    image[50, 50] = image[100, 250] = (255, 0, 255)
    clean = nodes.compensate(image)
    assert set(np.unique(clean)) == {0, 255}
    assert (clean[:, :160] == 0).all()
    assert (clean[:, 160:] == 255).all()
    assert nodes.compensate(grey_image()).shape == (240, 320, 3), "of one level alone"
    ramp = np.repeat(np.linspace(60, 180, 320).astype(np.uint8)[None, :, None], 240, axis=0).repeat(
        3, axis=2
    )
    table = nodes.stretch(ramp)
    assert (table[60], table[180]) == (0, 255)
    assert (np.diff(table.astype(int)) >= 0).all()
    image = grey_image(0)
    image[120, 160] = 250
    blurred = nodes.blur(image)
    assert blurred[120, 160, 0] < 60
    assert int(blurred[..., 0].sum()) == pytest.approx(250, abs=15)


# lane planner, polyfit


@pytest.mark.parametrize(
    ("bgr", "level"),
    [
        ((40, 190, 225), nodes.YELLOW),
        ((235, 240, 240), nodes.WHITE),
        ((90, 90, 90), 0),
        ((66, 96, 74), 0),
    ],
)
def test_yellow_and_white_are_markings_and_asphalt_and_grass_are_not(bgr, level):
    assert (nodes.marking_mask(np.full((8, 8, 3), bgr, np.uint8)) == level).all()


def drawn(lane: nodes.Lane) -> np.ndarray:
    """A camera image of a lane with a yellow line on the left and a white one on the right."""
    image, x = grey_image(), np.linspace(0.4, 4.0, 200)
    middle = lane.offset_m + lane.slope * x + lane.bend_per_m * x * x
    for side, bgr in ((0.25, (40, 190, 225)), (-0.25, (235, 240, 240))):
        left, right = (
            np.stack([x, middle + side + half, 0 * x], axis=1) for half in (0.025, -0.025)
        )
        pixels = Camera().project(np.vstack([left, right[::-1]]))[0]
        cv2.fillPoly(image, [np.rint(pixels).astype(np.int32)], bgr)
    return image


@pytest.mark.parametrize(
    "lane",
    [
        STRAIGHT,
        nodes.Lane(offset_m=0.08, slope=0.0, bend_per_m=0.0),
        nodes.Lane(offset_m=-0.03, slope=0.1, bend_per_m=0.0),
        nodes.Lane(offset_m=0.0, slope=0.0, bend_per_m=0.12),
        nodes.Lane(offset_m=0.02, slope=-0.05, bend_per_m=-0.08),
    ],
)
def test_a_drawn_lane_is_found_again_within_2_cm_where_the_car_aims(lane):
    found = nodes.fit_lane(nodes.lane_mask(drawn(lane), VIEW), VIEW)
    assert found is not None
    for x_m in (0.6, 0.9, 1.5):
        assert found.y_m(x_m) == pytest.approx(lane.y_m(x_m), abs=0.02)


def test_one_line_is_enough_and_lines_beyond_it_and_across_do_not_move_the_lane():
    mask = nodes.lane_mask(drawn(STRAIGHT), VIEW)
    more = mask.copy()
    more[:, 80:85] = more[120:125, 140:180] = (
        nodes.WHITE
    )  # one beyond the yellow line, and a stop line
    for seen in (
        np.where(mask == nodes.YELLOW, mask, 0),
        np.where(mask == nodes.WHITE, mask, 0),
        more,
    ):
        assert nodes.fit_lane(seen.astype(np.uint8), VIEW).y_m(0.9) == pytest.approx(0.0, abs=0.02)
    assert nodes.fit_lane(mask * 0, VIEW) is None


# lights


@pytest.mark.parametrize(("bgr", "colour"), [(RED, nodes.Colour.RED), (GREEN, nodes.Colour.GREEN)])
def test_a_lamp_is_found_by_its_own_colour_only_with_place_and_radius(bgr, colour):
    image = with_lamp(bgr, 9)
    (lamp,) = nodes.find_lamps(image, colour)
    assert (lamp.u, lamp.v) == pytest.approx((200, 90), abs=1)
    assert lamp.radius == pytest.approx(9, abs=1.2)
    other = nodes.Colour.GREEN if colour is nodes.Colour.RED else nodes.Colour.RED
    assert nodes.find_lamps(image, other) == []
    bar = cv2.rectangle(grey_image(), (100, 80), (160, 90), bgr, cv2.FILLED)
    assert nodes.find_lamps(bar, colour) == [], "not round"


@pytest.mark.parametrize(("radius", "found"), [(4, False), (10, True), (20, False)])
def test_a_red_light_counts_where_the_car_can_still_stop_and_see_it(radius, found):
    assert nodes.LightDetector(nodes.Colour.RED).see(with_lamp(RED, radius)) is found


def test_the_detectors_wake_each_other_and_sleep_when_they_found_their_light():
    red, green = nodes.LightDetector(nodes.Colour.RED), nodes.LightDetector(nodes.Colour.GREEN)
    assert not green.see(with_lamp(GREEN, 10)), "green sleeps at first"
    assert red.see(with_lamp(RED, 10))
    assert not red.see(with_lamp(RED, 10)), "red sleeps now"
    green.hear_other()
    assert not green.see(with_lamp(RED, 10))
    assert green.see(with_lamp(GREEN, 10))
    red.hear_other()
    assert (red.active, green.active) == (True, False)


# control


def test_a_lane_to_the_left_is_steered_to_a_bend_taken_slower_and_red_holds_until_green():
    straight = nodes.LaneControl().step(STRAIGHT, Pose())
    bend = nodes.LaneControl().step(nodes.Lane(offset_m=0.0, slope=0.0, bend_per_m=0.4), Pose())
    assert straight == Drive(speed_mps=0.9, yaw_rate_rps=0.0)
    assert bend.yaw_rate_rps > 0
    assert bend.speed_mps < straight.speed_mps
    control = nodes.LaneControl()
    control.hear_red()
    assert control.step(STRAIGHT, Pose()) == Drive()
    control.hear_green()
    assert control.step(STRAIGHT, Pose()).speed_mps > 0


def test_without_a_lane_the_car_goes_on_to_the_last_point_by_odometry_and_halts_there():
    control = nodes.LaneControl()
    assert control.step(None, Pose()) == Drive(), "nothing was ever seen"
    control.step(STRAIGHT, Pose())
    assert control.step(None, Pose(x_m=0.3, y_m=0.1)).yaw_rate_rps < 0
    assert control.step(None, Pose(x_m=0.7)) == Drive()


# odometry

METRES = st.floats(-0.3, 0.3)


@settings(max_examples=50, deadline=None)
@given(METRES, METRES, st.floats(-0.5, 0.5), st.integers(0, 1000))
def test_planar_motion_is_found_among_a_quarter_of_wrong_matches(x, y, yaw, seed):
    rng, motion = np.random.default_rng(seed), Pose(x_m=x, y_m=y, yaw_rad=yaw)
    now = rng.uniform((0.5, -1), (3, 1), (60, 2))
    before = np.array([motion.outwards(*point) for point in now])
    before[:15] += rng.uniform(0.3, 1.0, (15, 2))
    found = planar_motion(before, now)
    assert found is not None
    assert (found.x_m, found.y_m, found.yaw_rad) == pytest.approx((x, y, yaw), abs=1e-6)
    assert planar_motion(before[-7:], now[-7:]) is None, "too few"


@given(METRES, METRES, st.floats(-3, 3), METRES, METRES)
def test_a_pose_s_two_directions_undo_each_other(x, y, yaw, px, py):
    pose = Pose(x_m=x, y_m=y, yaw_rad=yaw)
    assert pose.inwards(*pose.outwards(px, py)) == pytest.approx((px, py), abs=1e-9)


def test_an_image_without_features_loses_the_odometry_and_does_not_move_it():
    odometry = VisualOdometry(Camera())
    assert odometry.see(grey_image()) == Pose()
    assert odometry.see(grey_image()) == Pose()
    assert odometry.lost == 1
