"""What the hallway's nodes decide, and that with perfect messages three robots come home."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.arp import LocalCache
from sfglab.arp.hallway import (
    BEAMS_DEG,
    LIMIT_S,
    RADIUS_M,
    SCAN_HZ,
    STEP_NS,
    STOP,
    ActuationNode,
    Area,
    End,
    Manoeuvre,
    SensingNode,
    Station,
    Verdict,
    World,
    judge,
    step_from_range,
)
from sfglab.arp.hallway.course import scan
from sfglab.arp.hallway.nodes import SAFE_M, LocalisationNode
from sfglab.arp.hallway.station import TRANSITIONS, PlanningNode, Sight, command_for

EMPTY = Area(robot="robot1")


def view_at(x, y, heading):
    ranges = np.empty(len(BEAMS_DEG))
    scan(EMPTY.segments, np.array((x, y, heading)), np.radians(BEAMS_DEG), ranges)
    node = LocalisationNode()
    for beam, range_m in enumerate(ranges):
        node.hear(beam, step_from_range(range_m))
    return node.view


def drive(seed, *, turns_late=0, limit_s=LIMIT_S):
    """Drive with every message delivered, all of them a number of LIDAR turns late."""
    world, station = World(seed=seed), Station()
    nodes, turns, steps, verdict = [ActuationNode() for _ in range(3)], [], 0, None
    while verdict is None:
        if steps % round(1e9 / SCAN_HZ / STEP_NS) == 0:
            turns.append([world.scan(robot) for robot in range(3)])
            for robot, scans in enumerate(turns[-1 - turns_late] if len(turns) > turns_late else ()):
                for beam, step in enumerate(scans):
                    station.hear(robot, beam, step)
            for node, command in zip(nodes, station.commands, strict=True):
                node.hear(command)
        world.step([node.command for node in nodes])
        steps += 1
        verdict = judge(
            world.clearance_m,
            world.wound_rad(),
            stopped_by=station.stopped_by,
            now_s=steps * STEP_NS / 1e9,
        )
    return verdict


@pytest.mark.parametrize("seed", range(5))
def test_with_perfect_messages_three_robots_come_home(seed):
    assert drive(seed) == Verdict(end=End.SUCCESS)


def test_half_a_second_late_is_borne_and_two_seconds_are_not():
    assert drive(1, turns_late=5).end is End.SUCCESS
    assert drive(1, turns_late=20).end in {End.CONTACT, End.STOP}


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


def test_a_localisation_says_nothing_before_its_last_beam():
    node = LocalisationNode()
    heard = [node.hear(beam, 1000) for beam in range(8)]
    assert heard == [False] * 7 + [True]
    assert node.view is not None


@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 7), st.integers(400, 420)), max_size=200))
def test_values_that_repeat_change_no_decision(heard):
    """What local cache and cache control rely on: planning is a function of the values, not of messages."""
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


def test_an_obstacle_before_any_robot_stops_all_and_says_whose():
    station = Station()
    for robot, beam in product(range(3), range(8)):
        station.hear(robot, beam, step_from_range(1.2))
    assert all(command.moving for command in station.commands)
    assert station.hear(1, BEAMS_DEG.index(45), step_from_range(SAFE_M - 0.01))
    assert station.commands == [STOP] * 3
    assert station.stopped_by == 1


def test_nobody_moves_before_all_have_been_heard():
    station = Station()
    for robot, beam in product(range(2), range(8)):
        station.hear(robot, beam, step_from_range(1.2))
    assert station.commands == [STOP] * 3


@given(st.sampled_from(Manoeuvre), st.sampled_from(Sight))
def test_a_stopped_leader_never_starts_again(manoeuvre, sight):
    assert (Manoeuvre.STOP, sight) not in TRANSITIONS
    assert TRANSITIONS.get((manoeuvre, sight), manoeuvre) in Manoeuvre


def test_sensing_has_no_value_before_the_first_turn():
    node = SensingNode()
    assert node.value(0) is None
    node.turned(range(8))
    assert [node.value(beam) for beam in range(8)] == list(range(8))


def test_the_verdict_names_the_robot():
    free, home = [0.3] * 3, [math.tau] * 3
    assert judge([0.3, RADIUS_M, 0.3], home, stopped_by=None, now_s=1) == Verdict(end=End.CONTACT, robot=1)
    assert judge(free, home, stopped_by=2, now_s=1) == Verdict(end=End.STOP, robot=2)
    assert judge(free, home, stopped_by=None, now_s=1) == Verdict(end=End.SUCCESS)
    assert judge(free, [6.2, 6.2, 3.0], stopped_by=None, now_s=1) is None
    assert judge(free, [0.0] * 3, stopped_by=None, now_s=LIMIT_S) == Verdict(end=End.TIMEOUT)
