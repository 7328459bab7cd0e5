"""Trajectories for property tests: moderate numbers, waits, turns on the spot, dense and far apart times."""

import math

import numpy as np
from hypothesis import strategies as st

from sfglab.spatial import Pose
from sfglab.spatial.trajectory.path import Interpolation, Trajectory

coordinates = st.one_of(st.integers(-5, 5).map(float), st.floats(-20, 20))
positions = st.tuples(coordinates, coordinates, coordinates)
_some = np.random.default_rng(6).normal(size=(30, 4))
_yaws = [(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)) for yaw in (0.0, 0.5, -1.0, 2.0, 3.0)]
quats = st.sampled_from([*_yaws, *map(tuple, _some.tolist())])
poses = st.builds(Pose.at, positions, quats)
both = st.sampled_from(Interpolation)
steps_ns = st.one_of(
    st.integers(1_000_000, 10_000_000_000), st.sampled_from([500_000_000, 1_000_000_000])
)


@st.composite
def trajectories(draw, least=2, most=6, interpolation=both):
    count = draw(st.integers(least, most))
    time_ns = draw(st.integers(0, 5_000_000_000))
    found = [(time_ns, draw(poses))]
    for _ in range(count - 1):
        time_ns += draw(steps_ns)
        again = Pose(position_m=found[-1][1].position_m, quat_xyzw=draw(poses).quat_xyzw)
        found.append((time_ns, draw(st.one_of(poses, poses, st.just(again)))))
    return Trajectory.of(found, draw(interpolation))
