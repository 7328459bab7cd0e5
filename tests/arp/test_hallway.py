"""The hallway's walls, LIDAR and robots against what can be worked out by hand; and what its nodes decide."""

import math
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.arp import LocalCache, hallway
from sfglab.arp.hallway import (
    STEP_NS,
    STOP,
    WAYPOINTS,
    End,
    Manoeuvre,
    Station,
    Verdict,
    judge,
    step_from_range,
)
from sfglab.arp.hallway.course import drive, scan, winding_rad
from sfglab.arp.hallway.nodes import NO_ECHO, SAFE_M, SPEED_M_S, LocalisationNode
from sfglab.arp.hallway.station import PlanningNode, command_for

EMPTY = hallway.Area(robot="robot1")


def ranges_at(area, pose):
    ranges = np.empty(len(hallway.BEAMS_DEG))
    scan(area.segments, np.array(pose), np.radians(hallway.BEAMS_DEG), ranges)
    return ranges


def test_at_home_the_beams_are_what_a_ruler_says_and_a_box_shortens_the_one_that_meets_it():
    half, diagonal = hallway.HALF_WIDTH_M, hallway.HALF_WIDTH_M * math.sqrt(2)
    beside_corner = [WAYPOINTS[1][0] + half - hallway.HOME[0], diagonal, half, diagonal]
    behind = [hallway.HOME[0] - WAYPOINTS[0][0] + half, diagonal, half, diagonal]
    # Backwards to the right the beam leaves through the corner that the robot came from.
    expected = [*beside_corner, *behind]
    expected[5] = math.sqrt(2) * 1.5
    ours = ranges_at(EMPTY, hallway.HOME)
    np.testing.assert_allclose(ours[[0, 1, 2, 3, 4, 6, 7]], np.delete(expected, 5), rtol=1e-12)
    [box, *_] = hallway.AREAS[1].boxes
    x, y = np.array(WAYPOINTS[box.leg]) - (box.along_m, 0.0)
    with_box, without = (ranges_at(area, (x, y, math.pi)) for area in (hallway.AREAS[1], EMPTY))
    right, left = hallway.BEAMS_DEG.index(270), hallway.BEAMS_DEG.index(90)
    assert with_box[right] == pytest.approx(0.3)
    assert without[right] == pytest.approx(0.5)
    assert with_box[left] == pytest.approx(without[left])


@given(st.floats(0, 2 * math.pi), st.floats(-0.3, 0.3))
def test_beams_agree_with_stepping_along_them(heading, aside):
    pose = (4.0, aside, heading)
    ours = ranges_at(EMPTY, pose)
    corners = EMPTY.segments[:, :2]
    for angle, range_m in zip(np.radians(hallway.BEAMS_DEG), ours, strict=True):
        way = np.array((math.cos(heading + angle), math.sin(heading + angle)))
        met = np.array(pose[:2]) + range_m * way
        if np.hypot(*(corners - met).T).min() < 1e-5:
            continue  # whether a corner that is grazed is met is a matter of the last bit
        assert free(*(met - 1e-6 * way))
        assert not free(*(met + 1e-6 * way))


def free(x, y):
    """Whether a point is in the corridors, from the middle line alone."""
    for (ax, ay), (bx, by) in pairwise((*WAYPOINTS, WAYPOINTS[0])):
        low_x, high_x, low_y, high_y = min(ax, bx), max(ax, bx), min(ay, by), max(ay, by)
        if low_x - 0.5 < x < high_x + 0.5 and low_y - 0.5 < y < high_y + 0.5:
            return True
    return False


def test_the_whole_middle_line_is_free_in_every_area_and_winds_once():
    world, ring = hallway.World(seed=0), np.array((*WAYPOINTS, WAYPOINTS[0]))
    for (ax, ay), (bx, by) in pairwise(ring):
        for share in np.linspace(0, 1, 50):
            world.poses[:, :2] = (ax + share * (bx - ax), ay + share * (by - ay))
            world.step([STOP] * 3)
            assert world.clearance_m.min() > 2 * hallway.RADIUS_M
    around = np.concatenate([np.linspace(a, b, 40) for a, b in pairwise(ring)])
    angles = np.unwrap([winding_rad(x, y) for x, y in around])
    assert (np.diff(angles) >= -1e-9).all()
    assert angles[-1] - angles[0] == pytest.approx(math.tau)
    assert hallway.course_length_m() == 18.0


@given(st.floats(0.15, 11.9))
def test_a_range_is_measured_within_the_data_sheets_resolution(range_m):
    step = step_from_range(range_m)
    measured = hallway.range_from_step(step)
    assert abs(measured - range_m) <= (0.00026 if range_m <= 1.5 else 0.0051 * range_m)
    assert step_from_range(measured) == step


@given(st.one_of(st.floats(0, 0.149), st.floats(12.001, 1e9), st.just(math.inf)))
def test_what_the_lidar_cannot_see_has_no_echo(range_m):
    assert step_from_range(range_m) == NO_ECHO
    assert hallway.range_from_step(NO_ECHO) == math.inf


@given(st.booleans(), st.integers(-3000, 3000))
def test_a_command_and_its_number_say_the_same(moving, turn_mrad_s):
    command = hallway.Command(moving, turn_mrad_s)
    assert hallway.Command.from_number(command.number) == command
    assert hallway.Command.from_velocities(command.speed_m_s, command.turn_rad_s) == command


def test_wheels_of_different_speed_make_an_arc():
    poses = np.array([[0.0, 0.0, 0.0]])
    radius, base = 0.5, 0.16
    wheels = SPEED_M_S * np.array([[1 - base / 2 / radius, 1 + base / 2 / radius]])
    quarter_s = math.pi / 2 * radius / SPEED_M_S
    for _ in range(200):
        drive(poses, wheels, base, quarter_s / 200)
    np.testing.assert_allclose(poses, [[radius, radius, math.pi / 2]], atol=1e-5)


def test_robots_that_are_told_nothing_stay_and_straight_ahead_they_slip_by_millimetres_only():
    world = hallway.World(seed=3)
    before = world.poses.copy()
    for _ in range(100):
        world.step([STOP] * 3)
    np.testing.assert_array_equal(world.poses, before)
    seconds = 2.0
    for _ in range(round(seconds * 1e9 / STEP_NS)):
        world.step([hallway.Command(moving=True)] * 3)
    np.testing.assert_allclose(
        np.hypot(*(world.poses - before)[:, :2].T), SPEED_M_S * seconds, rtol=0.02
    )


# --- The nodes, and how late messages may be.


def view_at(x, y, heading):
    node = LocalisationNode()
    for beam, range_m in enumerate(ranges_at(EMPTY, (x, y, heading))):
        node.hear(beam, step_from_range(range_m))
    return node.view


@given(st.floats(2.0, 3.5), st.floats(-0.2, 0.2), st.floats(-0.3, 0.3))
def test_between_two_walls_heading_and_offset_are_known(x, aside, askew):
    view = view_at(x, aside, math.pi + askew)
    assert view.heading_rad == pytest.approx(askew, abs=0.01)
    assert view.offset_m == pytest.approx(-aside, abs=0.01)


@given(st.floats(-0.2, 0.2), st.floats(-0.3, 0.3))
def test_the_correction_turns_back_to_the_middle(aside, askew):
    command = command_for(Manoeuvre.FORWARD, view_at(2.5, aside, math.pi + askew))
    wanted = aside - askew
    if abs(wanted) > 0.03:
        assert math.copysign(1, command.turn_mrad_s) == math.copysign(1, wanted)


def test_before_its_first_turn_sensing_has_no_value_nor_has_localisation_before_its_last_beam():
    node = LocalisationNode()
    assert [node.hear(beam, 1000) for beam in range(8)] == [False] * 7 + [True]
    assert node.view is not None
    node = hallway.SensingNode()
    assert node.value(0) is None
    node.turned(range(8))
    assert [node.value(beam) for beam in range(8)] == list(range(8))


@given(
    st.lists(st.tuples(st.integers(0, 2), st.integers(0, 7), st.integers(400, 420)), max_size=200)
)
def test_values_that_repeat_change_no_decision(heard):
    """Local cache and cache control rely on it: planning is a function of values, not of messages."""
    every, changes, cache = Station(), Station(), LocalCache()
    for now_ns, (robot, beam, step) in enumerate(heard):
        every.hear(robot, beam, step)
        if cache.offer(f"{robot}/{beam}", step, now_ns=now_ns).passes:
            changes.hear(robot, beam, step)
        assert every.commands == changes.commands


def test_the_leader_turns_at_the_corner_and_ends_the_turn_along_the_next_wall():
    planning = PlanningNode()
    assert planning.decide(view_at(1.0, 4.0, 0.0)) is Manoeuvre.FORWARD
    assert planning.decide(view_at(2.45, 4.0, 0.0)) is Manoeuvre.FORWARD
    assert planning.decide(view_at(2.55, 4.0, 0.0)) is Manoeuvre.TURN_RIGHT
    assert planning.decide(view_at(2.8, 3.9, -0.7)) is Manoeuvre.TURN_RIGHT
    assert planning.decide(view_at(3.0, 3.5, -1.5)) is Manoeuvre.FORWARD
    assert planning.decide(view_at(3.0, 2.45, -math.pi / 2)) is Manoeuvre.TURN_LEFT


def test_nobody_moves_before_all_have_been_heard_and_an_obstacle_stops_all_and_says_whose():
    station = Station()
    for robot, beam in product(range(2), range(8)):
        station.hear(robot, beam, step_from_range(1.2))
    assert station.commands == [STOP] * 3
    station = Station()
    for robot, beam in product(range(3), range(8)):
        station.hear(robot, beam, step_from_range(1.2))
    assert all(command.moving for command in station.commands)
    assert station.hear(1, hallway.BEAMS_DEG.index(45), step_from_range(SAFE_M - 0.01))
    assert station.commands == [STOP] * 3
    assert station.stopped_by == 1


def test_the_verdict_names_the_robot():
    free, near, home = [0.3] * 3, [0.3, hallway.RADIUS_M, 0.3], [math.tau] * 3
    assert judge(near, home, stopped_by=None, now_s=1) == Verdict(end=End.CONTACT, robot=1)
    assert judge(free, home, stopped_by=2, now_s=1) == Verdict(end=End.STOP, robot=2)
    assert judge(free, home, stopped_by=None, now_s=1) == Verdict(end=End.SUCCESS)
    assert judge(free, [6.2, 6.2, 3.0], stopped_by=None, now_s=1) is None
    assert judge(free, [0.0] * 3, stopped_by=None, now_s=hallway.LIMIT_S) == Verdict(
        end=End.TIMEOUT
    )
