"""The hallway's walls, LIDAR and robots: geometry against what can be worked out by hand."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.arp.hallway import (
    AREAS,
    BEAMS_DEG,
    HALF_WIDTH_M,
    HOME,
    RADIUS_M,
    STEP_NS,
    STOP,
    WAYPOINTS,
    Area,
    Command,
    World,
    course_length_m,
    range_from_step,
    step_from_range,
)
from sfglab.arp.hallway.course import drive, scan, winding_rad
from sfglab.arp.hallway.nodes import NO_ECHO, SPEED_M_S

EMPTY = Area(robot="robot1")


def ranges_at(area, pose):
    ranges = np.empty(len(BEAMS_DEG))
    scan(area.segments, np.array(pose), np.radians(BEAMS_DEG), ranges)
    return ranges


def test_at_home_the_eight_beams_are_what_a_ruler_says():
    half, diagonal = HALF_WIDTH_M, HALF_WIDTH_M * math.sqrt(2)
    beside_corner = [WAYPOINTS[1][0] + half - HOME[0], diagonal, half, diagonal]
    behind = [HOME[0] - WAYPOINTS[0][0] + half, diagonal, half, diagonal]
    # Backwards to the right the beam leaves through the corner that the robot came from.
    expected = [*beside_corner, *behind]
    expected[5] = math.sqrt(2) * 1.5
    ours = ranges_at(EMPTY, HOME)
    np.testing.assert_allclose(ours[[0, 1, 2, 3, 4, 6, 7]], np.delete(expected, 5), rtol=1e-12)


def test_a_box_shortens_the_beam_that_meets_it_and_no_other_side():
    [box, *_] = AREAS[1].boxes
    x, y = np.array(WAYPOINTS[box.leg]) - (box.along_m, 0.0)
    with_box, without = (ranges_at(area, (x, y, math.pi)) for area in (AREAS[1], EMPTY))
    right, left = BEAMS_DEG.index(270), BEAMS_DEG.index(90)
    assert with_box[right] == pytest.approx(0.3)
    assert without[right] == pytest.approx(0.5)
    assert with_box[left] == pytest.approx(without[left])


@given(st.floats(0, 2 * math.pi), st.floats(-0.3, 0.3))
def test_beams_agree_with_stepping_along_them(heading, aside):
    pose = (4.0, aside, heading)
    ours = ranges_at(EMPTY, pose)
    corners = EMPTY.segments[:, :2]
    for angle, range_m in zip(np.radians(BEAMS_DEG), ours, strict=True):
        way = np.array((math.cos(heading + angle), math.sin(heading + angle)))
        met = np.array(pose[:2]) + range_m * way
        if np.hypot(*(corners - met).T).min() < 1e-5:
            continue  # whether a corner that is grazed is met is a matter of the last bit
        assert free(*(met - 1e-6 * way))
        assert not free(*(met + 1e-6 * way))


def free(x, y):
    """Whether a point is in the corridors, from the middle line alone."""
    ring = (*WAYPOINTS, WAYPOINTS[0])
    for (ax, ay), (bx, by) in pairwise(ring):
        low_x, high_x, low_y, high_y = min(ax, bx), max(ax, bx), min(ay, by), max(ay, by)
        if low_x - 0.5 < x < high_x + 0.5 and low_y - 0.5 < y < high_y + 0.5:
            return True
    return False


def test_the_whole_middle_line_is_free_in_every_area():
    world = World(seed=0)
    ring = (*WAYPOINTS, WAYPOINTS[0])
    for (ax, ay), (bx, by) in pairwise(ring):
        for share in np.linspace(0, 1, 50):
            world.poses[:, :2] = (ax + share * (bx - ax), ay + share * (by - ay))
            world.step([STOP] * 3)
            assert world.clearance_m.min() > 2 * RADIUS_M


def test_a_round_winds_once():
    ring = np.array((*WAYPOINTS, WAYPOINTS[0]))
    around = np.concatenate([np.linspace(a, b, 40) for a, b in pairwise(ring)])
    angles = np.unwrap([winding_rad(x, y) for x, y in around])
    assert (np.diff(angles) >= -1e-9).all()
    assert angles[-1] - angles[0] == pytest.approx(math.tau)
    assert course_length_m() == 18.0


@given(st.floats(0.15, 11.9))
def test_a_range_is_measured_within_the_data_sheets_resolution(range_m):
    step = step_from_range(range_m)
    measured = range_from_step(step)
    assert abs(measured - range_m) <= (0.00026 if range_m <= 1.5 else 0.0051 * range_m)
    assert step_from_range(measured) == step


@given(st.one_of(st.floats(0, 0.149), st.floats(12.001, 1e9), st.just(math.inf)))
def test_what_the_lidar_cannot_see_has_no_echo(range_m):
    assert step_from_range(range_m) == NO_ECHO
    assert range_from_step(NO_ECHO) == math.inf


@given(st.booleans(), st.integers(-3000, 3000))
def test_a_command_and_its_number_say_the_same(moving, turn_mrad_s):
    command = Command(moving, turn_mrad_s)
    assert Command.from_number(command.number) == command
    assert Command.from_velocities(command.speed_m_s, command.turn_rad_s) == command


def test_wheels_of_different_speed_make_an_arc():
    poses = np.array([[0.0, 0.0, 0.0]])
    radius, base = 0.5, 0.16
    wheels = SPEED_M_S * np.array([[1 - base / 2 / radius, 1 + base / 2 / radius]])
    quarter_s = math.pi / 2 * radius / SPEED_M_S
    for _ in range(200):
        drive(poses, wheels, base, quarter_s / 200)
    np.testing.assert_allclose(poses, [[radius, radius, math.pi / 2]], atol=1e-5)


def test_robots_that_are_told_nothing_stay():
    world = World(seed=3)
    before = world.poses.copy()
    for _ in range(100):
        world.step([STOP] * 3)
    np.testing.assert_array_equal(world.poses, before)


def test_straight_ahead_slips_by_millimetres_only():
    world = World(seed=3)
    before = world.poses.copy()
    seconds = 2.0
    for _ in range(round(seconds * 1e9 / STEP_NS)):
        world.step([Command(moving=True)] * 3)
    way = np.hypot(*(world.poses - before)[:, :2].T)
    np.testing.assert_allclose(way, SPEED_M_S * seconds, rtol=0.02)


def test_the_same_seed_gives_the_same_world_to_the_bit():
    def run():
        world = World(seed=5)
        for _ in range(50):
            world.step([Command(moving=True, turn_mrad_s=10)] * 3)
        return world.poses.tobytes(), [world.scan(robot) for robot in range(3)]

    assert run() == run()
