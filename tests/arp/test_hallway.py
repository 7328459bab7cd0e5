"""The hallway's walls, LIDAR and robots against what can be worked out by hand; and what its nodes decide."""

import math
from itertools import product
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.arp import LocalCache, hallway
from sfglab.arp.hallway import STOP, End, Manoeuvre, Station, Verdict, judge
from sfglab.arp.hallway.course import drive, scan
from sfglab.arp.hallway.nodes import NO_ECHO, SAFE_M, LocalisationNode
from sfglab.arp.hallway.station import command_for

ANGLES = np.radians(hallway.BEAMS_DEG)


DIAGONAL_M = math.sqrt(0.5)


def ranges_at(area, pose):
    ranges = np.empty(8)
    scan(area.segments, np.array(pose), ANGLES, ranges)
    return ranges


@pytest.mark.parametrize("turns", range(8))
@pytest.mark.parametrize(
    ("place", "straight_m", "diagonal_m"),
    [
        ((3.0, 0.0), (2.5, 0.5, 3.5, 0.5), (0.3 * math.sqrt(2), *[DIAGONAL_M] * 3)),
        ((2.0, 0.0), (3.5, 0.5, 2.5, 0.3), [DIAGONAL_M] * 4),
        ((0.0, 1.7), (0.3, 2.8, 0.5, 2.2), [DIAGONAL_M] * 4),
    ],
)
def test_beams_end_at_walls_and_boxes(place, straight_m, diagonal_m, turns):
    """By hand, in robot 2's area: east, north, west and south, and what is between; each place has a box."""
    expected = np.ravel(np.column_stack((straight_m, diagonal_m)))
    found = ranges_at(hallway.AREAS[1], (*place, turns * math.pi / 4))
    assert found == pytest.approx(np.roll(expected, -turns))


@given(st.floats(0.15, 11.9))
def test_a_range_is_measured_within_the_data_sheets_resolution(range_m):
    step = hallway.step_from_range(range_m)
    measured = hallway.range_from_step(step)
    assert abs(measured - range_m) <= (0.00026 if range_m <= 1.5 else 0.0051 * range_m)
    assert hallway.step_from_range(measured) == step


def test_what_the_lidar_cannot_see_has_no_echo():
    unseen = [hallway.step_from_range(range_m) for range_m in (0, 0.149, 12.001, math.inf)]
    assert unseen == [NO_ECHO] * 4
    assert hallway.range_from_step(NO_ECHO) == math.inf


@given(st.booleans(), st.integers(-3000, 3000))
def test_a_command_its_number_and_its_velocities_say_the_same(moving, turn_mrad_s):
    command = hallway.Command(moving, turn_mrad_s)
    assert command.from_number(command.number) == command
    assert command.from_velocities(command.speed_m_s, command.turn_rad_s) == command


def test_wheels_of_different_speed_make_an_arc():
    poses, radius_m, base_m = np.zeros((1, 3)), 0.5, 0.16
    quarter_m = math.pi / 2 * np.array([[radius_m - base_m / 2, radius_m + base_m / 2]])
    for _ in range(200):
        drive(poses, quarter_m, base_m, 1 / 200)
    np.testing.assert_allclose(poses, [[radius_m, radius_m, math.pi / 2]], atol=1e-5)


# --- The nodes.


def view_at(*pose):
    node = LocalisationNode()
    for beam, range_m in enumerate(ranges_at(hallway.Area(robot="robot1"), pose)):
        node.hear(beam, hallway.step_from_range(range_m))
    return node.view


@given(st.floats(2.0, 3.5), st.floats(-0.2, 0.2), st.floats(-0.3, 0.3))
def test_between_two_walls_heading_and_offset_are_known_and_corrected(x, aside, askew):
    view = view_at(x, aside, math.pi + askew)
    assert (view.heading_rad, view.offset_m) == pytest.approx((askew, -aside), abs=0.01)
    wanted_rad_s = aside - askew
    if abs(wanted_rad_s) > 0.03:
        assert command_for(Manoeuvre.FORWARD, view).turn_mrad_s * wanted_rad_s > 0


def station_that_heard(robots):
    """Return a station that has heard all beams of so many robots, with nothing near."""
    station = Station()
    for robot, beam in product(range(robots), range(8)):
        station.hear(robot, beam, hallway.step_from_range(1.2))
    return station


@pytest.mark.parametrize("seed", range(20))
def test_values_that_repeat_change_no_decision(seed):
    """Local cache and cache control rely on it: planning is a function of values, not of messages."""
    draw, cache = Random(seed), LocalCache()
    every, changes = station_that_heard(3), station_that_heard(3)
    for _ in range(500):
        robot, beam, step = draw.randrange(3), draw.randrange(8), draw.choice([600, 1400, 2400])
        every.hear(robot, beam, step)
        if cache.offer(f"{robot}/{beam}", step, now_ns=0).passes:
            changes.hear(robot, beam, step)
        assert every.commands == changes.commands


def test_all_move_when_all_are_heard_each_in_its_own_way_and_an_obstacle_of_one_stops_all():
    assert station_that_heard(2).commands == [STOP] * 3
    station = station_that_heard(3)
    before = station.commands
    assert all(command.moving for command in before)
    station.hear(2, hallway.BEAMS_DEG.index(90), hallway.step_from_range(0.25))
    assert station.commands[:2] == before[:2]
    assert station.commands[2] != before[2]
    station.hear(1, hallway.BEAMS_DEG.index(45), hallway.step_from_range(SAFE_M - 0.01))
    assert (station.commands, station.stopped_by) == ([STOP] * 3, 1)


@pytest.mark.parametrize(
    ("clearance_m", "wound_rad", "stopped_by", "now_s", "end", "robot"),
    [
        (hallway.RADIUS_M, 6.28, 2, 1, End.CONTACT, 1),
        (0.3, 6.28, 2, 1, End.STOP, 2),
        (0.3, 6.28, None, hallway.LIMIT_S, End.SUCCESS, -1),
        (0.3, 3.0, None, hallway.LIMIT_S, End.TIMEOUT, -1),
    ],
)
def test_the_verdict_names_the_robot(clearance_m, wound_rad, stopped_by, now_s, end, robot):
    near, around = (0.3, clearance_m, 0.3), (6.28, 6.28, wound_rad)
    found = judge(near, around, stopped_by=stopped_by, now_s=now_s)
    assert found == Verdict(end=end, robot=robot)
