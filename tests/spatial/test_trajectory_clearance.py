"""How close trajectories come to each other and to bodies: known cases, and brute force as the judge."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trajectory_strategies import poses, positions, trajectories

from sfglab.spatial import Pose
from sfglab.spatial.trajectory.clearance import (
    Box,
    Cylinder,
    Sphere,
    closest_approach,
    closest_to_shape,
)
from sfglab.spatial.trajectory.motion import motion_of
from sfglab.spatial.trajectory.path import Interpolation, Trajectory, TrajectoryError, in_frame

S = 1_000_000_000
sizes = st.floats(0.1, 5)
shapes = st.one_of(
    st.builds(Box, size_m=st.tuples(sizes, sizes, sizes)),
    st.builds(Sphere, radius_m=sizes),
    st.builds(Cylinder, radius_m=sizes, height_m=sizes),
)


def straight(start, end, start_s=0.0, end_s=10.0):
    return Trajectory.of([(round(start_s * S), Pose.at(start)), (round(end_s * S), Pose.at(end))])


def dense(trajectory):
    knots = [w.time_ns / S for w in trajectory.waypoints]
    return np.unique(np.concatenate([np.linspace(knots[0], knots[-1], 2001), knots]))


def test_crossing_paths_are_closest_where_the_closed_form_says():
    east = straight((-5.0, 0.0, 0.0), (5.0, 0.0, 0.0))
    north = straight((1.0, -5.0, 0.0), (1.0, 5.0, 0.0))
    found = closest_approach(east, north)
    # relative place (-6, 5) + (1, -1) t: least at t = 5.5, where it is (-0.5, -0.5)
    assert found.time_s == pytest.approx(5.5)
    assert found.distance_m == pytest.approx(math.sqrt(0.5))
    assert found.position_a_m == pytest.approx((0.5, 0.0, 0.0))
    assert found.position_b_m == pytest.approx((1.0, 0.5, 0.0))
    assert found.tolerance_m == 0.0


def test_paths_that_cross_at_different_times_do_not_meet_and_who_stand_stay_apart():
    early = straight((-5.0, 0.0, 0.0), (5.0, 0.0, 0.0), 0.0, 10.0)
    late = straight((0.0, -5.0, 0.0), (0.0, 5.0, 0.0), 20.0, 30.0)
    assert closest_approach(early, late).distance_m == pytest.approx(5.0)
    a, b = Trajectory.standing(Pose()), Trajectory.of([(5 * S, Pose.at((3.0, 4.0, 0.0)))])
    assert closest_approach(a, b).distance_m == pytest.approx(5.0)


def test_agents_side_by_side_on_equal_splines_keep_their_distance():
    points = enumerate([(0, 0, 0), (2, 1, 0), (4, -1, 0), (6, 0, 0)])
    a = Trajectory.of([(i * S, Pose.at(p)) for i, p in points], Interpolation.CATMULL_ROM)
    found = closest_approach(a, in_frame(a, Pose.at((0.0, 0.0, 1.0))))
    assert found.distance_m == pytest.approx(1.0)
    assert 0.0 < found.tolerance_m <= 1e-4


@pytest.mark.parametrize(
    ("shape", "point", "distance_m"),
    [
        (Box(size_m=(2.0, 4.0, 6.0)), (2.0, 0.0, 0.0), 1.0),
        (Box(size_m=(2.0, 4.0, 6.0)), (4.0, 6.0, 0.0), 5.0),
        (Box(size_m=(2.0, 4.0, 6.0)), (0.0, 1.5, 0.0), -0.5),
        (Sphere(radius_m=1.0), (0.0, 3.0, 0.0), 2.0),
        (Sphere(radius_m=1.0), (0.0, 0.0, 0.0), -1.0),
        (Cylinder(radius_m=1.0, height_m=2.0), (0.0, 4.0, 5.0), 5.0),
        (Cylinder(radius_m=1.0, height_m=2.0), (0.0, 0.0, 0.75), -0.25),
    ],
)
def test_distances_to_bodies_are_known_outside_and_inside(shape, point, distance_m):
    assert shape.distances_m(np.array([point]))[0] == pytest.approx(distance_m)


@pytest.mark.parametrize("size", [0.0, -1.0, math.nan, math.inf])
def test_a_body_without_a_size_is_refused(size):
    for made in (
        lambda: Box(size_m=(1.0, size, 1.0)),
        lambda: Sphere(radius_m=size),
        lambda: Cylinder(radius_m=1.0, height_m=size),
    ):
        with pytest.raises(TrajectoryError, match="above zero"):
            made()


def test_passing_a_turned_box_is_closest_at_its_corner_and_through_a_body_where_deepest():
    corner = Pose.from_yaw((0.0, 0.0, 0.0), math.pi / 4)
    found = closest_to_shape(
        straight((-5.0, 2.0, 0.0), (5.0, 2.0, 0.0)), Box(size_m=(2.0, 2.0, 2.0)), corner
    )
    assert found.time_s == pytest.approx(5.0, abs=1e-6)
    assert found.clearance_m == pytest.approx(2.0 - math.sqrt(2.0))
    assert found.position_m == pytest.approx((0.0, 2.0, 0.0), abs=1e-6)
    found = closest_to_shape(
        straight((-5.0, 0.5, 0.0), (5.0, 0.5, 0.0)), Sphere(radius_m=2.0), Pose()
    )
    assert found.clearance_m == pytest.approx(-1.5)
    assert found.time_s == pytest.approx(5.0, abs=1e-5)


@settings(deadline=None, max_examples=30)
@given(trajectories(least=1, most=4), shapes, poses)
def test_no_sample_is_closer_to_a_body_than_what_is_reported(trajectory, shape, pose):
    found = closest_to_shape(trajectory, shape, pose, tolerance_m=1e-2)

    def gap(times):
        seen_m = motion_of(trajectory).positions(times) - pose.position_m
        return shape.distances_m(pose.rotation.inv().apply(seen_m))

    assert found.clearance_m <= gap(dense(trajectory)).min() + found.tolerance_m + 1e-7
    assert gap(np.array([found.time_s]))[0] == pytest.approx(found.clearance_m)


@settings(deadline=None, max_examples=30)
@given(trajectories(least=1))
def test_every_segment_stays_in_its_box(trajectory):
    motion = motion_of(trajectory)
    low, high = motion.boxes_m()
    for i, (start, end) in enumerate(pairwise(motion.times_s)):
        inside = motion.positions(np.linspace(start, end, 50, endpoint=False))
        assert np.all(inside >= low[i] - 1e-9)
        assert np.all(inside <= high[i] + 1e-9)


@given(shapes, positions)
def test_nothing_beyond_a_bodys_reach_is_inside(shape, point):
    if math.hypot(*point) > shape.reach_m:
        assert shape.distances_m(np.array([point]))[0] > 0.0
