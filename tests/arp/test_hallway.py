"""The hallway's walls, LIDAR and robots against what can be worked out by hand; and what its nodes decide."""

import math
from itertools import product
from random import Random

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from sfglab.arp import LocalCache, hallway
from sfglab.arp.hallway import STOP, End, Manoeuvre, Station, Verdict, judge
from sfglab.arp.hallway.course import drive, scan
from sfglab.arp.hallway.nodes import SAFE_M, LocalisationNode
from sfglab.arp.hallway.station import command_for

ANGLES = np.radians(hallway.BEAMS_DEG)


def ranges_at(area, pose):
    ranges = np.empty(8)
    scan(area.segments, np.array(pose), ANGLES, ranges)
    return ranges


@pytest.mark.parametrize("turns", range(8))
@pytest.mark.parametrize(
    ("place", "straight_m", "diagonals"),
    [
        ((3.0, 0.0), (2.5, 0.5, 3.5, 0.5), (0.3, 0.5, 0.5, 0.5)),
        ((2.0, 0.0), (3.5, 0.5, 2.5, 0.3), (0.5, 0.5, 0.5, 0.5)),
        ((0.0, 1.7), (0.3, 2.8, 0.5, 2.2), (0.5, 0.5, 0.5, 0.5)),
    ],
)
def test_beams_end_at_walls_and_boxes(place, straight_m, diagonals, turns):
    """By hand, in robot 2's area: east, north, west and south, and what is between; each place has a box."""
    expected = np.ravel(np.column_stack((straight_m, math.sqrt(2) * np.array(diagonals))))
    found = ranges_at(hallway.AREAS[1], (*place, turns * math.pi / 4))
    assert found == pytest.approx(np.roll(expected, -turns))


@given(st.floats(0.15, 11.9))
def test_a_range_is_measured_within_the_data_sheets_resolution(range_m):
    step = hallway.step_from_range(range_m)
    measured = hallway.range_from_step(step)
    assert abs(measured - range_m) <= (0.00026 if range_m <= 1.5 else 0.0051 * range_m)
    assert hallway.step_from_range(measured) == step


@pytest.mark.parametrize("range_m", [0, 0.149, 12.001, math.inf])
def test_what_the_lidar_cannot_see_has_no_echo(range_m):
    assert hallway.range_from_step(hallway.step_from_range(range_m)) == math.inf


@pytest.mark.parametrize("command", [STOP, hallway.Command(moving=True, turn_mrad_s=-300)])
def test_a_command_its_number_and_its_velocities_say_the_same(command):
    assert command.from_number(command.number) == command
    assert command.from_velocities(command.speed_m_s, command.turn_rad_s) == command


def test_wheels_of_different_speed_make_an_arc():
    """A quarter of a circle of 0.5 m in 200 steps; the wheels are 0.16 m apart."""
    poses = np.zeros((1, 3))
    for _ in range(200):
        drive(poses, np.array([[0.42, 0.58]]), 0.16, math.pi / 400)
    assert poses[0] == pytest.approx([0.5, 0.5, math.pi / 2], abs=1e-5)


# --- The nodes.


@given(st.floats(2.0, 3.5), st.floats(-0.2, 0.2), st.floats(-0.3, 0.3))
def test_between_two_walls_heading_and_offset_are_known_and_corrected(x, aside, askew):
    node = LocalisationNode()
    for beam, range_m in enumerate(ranges_at(hallway.Area(robot="a"), (x, aside, math.pi + askew))):
        node.hear(beam, hallway.step_from_range(range_m))
    found = node.view.heading_rad, node.view.offset_m
    assert found == pytest.approx((askew, -aside), abs=0.01)
    assume(abs(aside - askew) > 0.03)
    assert command_for(Manoeuvre.FORWARD, node.view).turn_mrad_s * (aside - askew) > 0


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
        heard = draw.randrange(3), draw.randrange(8), draw.choice([600, 1400, 2400])
        every.hear(*heard)
        if cache.offer(str(heard[:2]), heard[2], now_ns=0).passes:
            changes.hear(*heard)
        assert every.commands == changes.commands


def test_all_move_when_all_are_heard_each_in_its_own_way_and_an_obstacle_of_one_stops_all():
    assert station_that_heard(2).commands == [STOP] * 3
    station = station_that_heard(3)
    first, second, third = station.commands
    assert all(command.moving for command in station.commands)
    station.hear(2, hallway.BEAMS_DEG.index(90), hallway.step_from_range(0.25))
    assert station.commands[:2] == [first, second]
    assert station.commands[2] != third
    station.hear(1, hallway.BEAMS_DEG.index(45), hallway.step_from_range(SAFE_M - 0.01))
    assert (station.commands, station.stopped_by) == ([STOP] * 3, 1)


@pytest.mark.parametrize(
    ("clearance_m", "wound_rad", "stopped_by", "verdict"),
    [
        (hallway.RADIUS_M, 6.28, 2, Verdict(end=End.CONTACT, robot=1)),
        (0.3, 6.28, 2, Verdict(end=End.STOP, robot=2)),
        (0.3, 6.28, None, Verdict(end=End.SUCCESS)),
        (0.3, 3.0, None, None),
    ],
)
def test_the_verdict_names_the_robot(clearance_m, wound_rad, stopped_by, verdict):
    near, around = (0.3, clearance_m, 0.3), (6.28, 6.28, wound_rad)
    assert judge(near, around, stopped_by=stopped_by) == verdict
