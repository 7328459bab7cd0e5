"""A simulated agent on a timed trajectory: its limits, its ends, and the goals that it refuses."""

import math
from itertools import pairwise

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from trajectory_strategies import poses, trajectories

from sfglab.bus import GoalStatus
from sfglab.errors import InvalidValueError
from sfglab.spatial import Pose
from sfglab.spatial.execution.agent import AgentState, Follower, Limits, Tolerances
from sfglab.spatial.execution.orders import OUTCOMES, Order, Outcome, RefusalError, outcome_of
from sfglab.spatial.execution.server import AgentSetup, check_order
from sfglab.spatial.trajectory.path import Trajectory

S = 1_000_000_000
EASY = Tolerances(settle_s=3600.0)
limits = st.builds(
    Limits,
    speed_m_s=st.floats(0.3, 5.0),
    acceleration_m_s2=st.floats(0.3, 10.0),
    yaw_rate_rad_s=st.floats(0.3, 6.0),
)


def line(*points):
    """Waypoints a second apart along x, with a wait at the start and the end."""
    xs = (points[0], *points, points[-1])
    return Trajectory.of((i * S, Pose.at((x, 0.0, 0.0))) for i, x in enumerate(xs))


def follower(trajectory, held=None, *, pose=None, tolerances=EASY, start_ns=0):
    state = AgentState(pose=pose or trajectory.waypoints[0].pose)
    given = {"limits": held or Limits(), "tolerances": tolerances}
    return Follower(trajectory, state=state, now_ns=0, start_ns=start_ns, **given)


def run_to_end(following, step_ns):
    for number in range(1, 100_000):
        following.step(number * step_ns)
        if following.outcome is not None:
            return following
    pytest.fail("it never ended")


def rounding(vector):
    """Error of a difference to this vector, though both are exact to their last digit."""
    return 2 * math.ulp(math.hypot(*vector))


@settings(max_examples=30, deadline=None)
@given(
    trajectories(),
    limits,
    poses,
    st.lists(st.integers(1, 400_000_000), min_size=1, max_size=60),
)
@example(  # after a step of 2 ns a velocity's own rounding is more than a billionth of what it may change
    Trajectory.of((t_ns, Pose.at((0.0, 0.0, 0.0))) for t_ns in (0, 1_000_000)),
    Limits(speed_m_s=1.0, acceleration_m_s2=4.5, yaw_rate_rad_s=1.0),
    Pose.at((0.0, 0.0, 1.0)),
    [27_777_777, 2],
)
def test_no_limit_is_ever_exceeded(path, held, at, steps):
    following = follower(path, held, pose=at)
    before, now_ns = following.state, 0
    for step in steps:
        now_ns += step
        following.step(now_ns)
        after, dt_s = following.state, step / S
        change = math.dist(after.velocity_m_s, before.velocity_m_s)
        assert after.speed_m_s <= held.speed_m_s * (1 + 1e-9)
        assert change <= held.acceleration_m_s2 * dt_s * (1 + 1e-9) + rounding(before.velocity_m_s)
        assert before.pose.angle_rad(after.pose) <= held.yaw_rate_rad_s * dt_s * (1 + 1e-6) + 1e-6
        way = before.pose.distance_m(after.pose)
        assert way <= held.speed_m_s * dt_s * (1 + 1e-9) + rounding(before.pose.position_m)
        before = after


@settings(max_examples=10, deadline=None)
@given(trajectories(), limits)
def test_an_agent_with_time_stands_at_the_last_pose_in_the_end(path, held):
    ended = run_to_end(follower(path, held), step_ns=200_000_000)
    last = path.waypoints[-1].pose
    assert (ended.outcome, ended.share) == (Outcome.SUCCEEDED, 1.0)
    assert ended.state.pose.distance_m(last) <= EASY.goal_m
    assert ended.state.pose.angle_rad(last) <= EASY.goal_rad


@settings(max_examples=10, deadline=None)
@given(trajectories(), limits, st.floats(0.0, 20.0))
def test_a_stopped_agent_brakes_at_once_and_as_hard_as_it_can(path, held, after_s):
    following, now_ns = follower(path, held), round(after_s * S)
    following.step(now_ns)
    if following.outcome is not None:
        return
    begun, speeds = following.state, [following.state.speed_m_s]
    following.stop(Outcome.CANCELED)
    while following.outcome is None:
        now_ns += 20_000_000
        following.step(now_ns)
        speeds.append(following.state.speed_m_s)
    assert (following.outcome, speeds[-1]) == (Outcome.CANCELED, 0.0)
    assert all(b < a for a, b in pairwise(speeds)) or speeds == [0.0, 0.0]
    way_m = begun.pose.distance_m(following.state.pose)
    assert way_m <= speeds[0] ** 2 / (2 * held.acceleration_m_s2) + 1e-6
    stands = following.state
    following.step(now_ns + S)
    assert following.state == stands


def test_the_result_does_not_depend_on_how_time_is_cut_and_time_never_runs_backwards():
    path = line(0.0, 1.0, 3.0, 2.0)
    fine, coarse = (run_to_end(follower(path), step_ns=ms * 10**6) for ms in (20, 100))
    assert fine.state.pose.same_as(coarse.state.pose, within_m=1e-3)
    following = follower(path)
    following.step(3 * S // 2)
    at = following.state
    for earlier_ns in (3 * S // 2, 0):
        following.step(earlier_ns)
        assert following.state == at


def test_an_agent_that_does_not_arrive_in_time_ends_with_that_outcome():
    tolerances = Tolerances(settle_s=1.0)
    following = follower(line(0.0, 5.0), Limits(speed_m_s=0.5), tolerances=tolerances)
    assert run_to_end(following, 50_000_000).outcome is Outcome.GOAL_MISSED
    assert 4.0 < following.time_ns / S < 4.2


@pytest.mark.parametrize("limit", [0.0, -1.0, math.nan, math.inf])
def test_a_limit_is_a_finite_number_above_zero(limit):
    with pytest.raises(InvalidValueError, match=r"limits, acceleration_m_s2: .* above zero"):
        Limits(acceleration_m_s2=limit)


def test_an_agent_waits_at_the_start_until_the_trajectory_begins():
    following = follower(line(0.0, 1.0), start_ns=5 * S)
    following.step(4 * S)
    assert (following.share, following.time_ns, following.state.speed_m_s) == (0.0, -S, 0.0)


def test_the_yaw_rate_is_that_of_the_turn():
    path = Trajectory.of([(0, Pose()), (2 * S, Pose.from_yaw((0.0, 0.0, 0.0), -1.0))])
    following = follower(path)
    following.step(S)
    assert following.state.yaw_rate_rad_s == pytest.approx(-0.5)


def test_every_outcome_reads_back_from_status_and_code():
    assert OUTCOMES.keys() == set(Outcome)
    for outcome, ending in OUTCOMES.items():
        if outcome is not Outcome.REJECTED:
            assert outcome_of(ending.status, ending.code) is outcome
    assert outcome_of(GoalStatus.ABORTED, 99) is Outcome.FAILED


def order(*points, agent="go2", **more):
    return Order(agent=agent, trajectory=line(*points), **more)


def check(given):
    setup = AgentSetup(limits=Limits(speed_m_s=1.0))
    check_order(given, "go2", setup, Pose(), 100 * S)


@pytest.mark.parametrize(
    ("given", "outcome", "says"),
    [
        (order(0.0, 1.0, agent="spot"), Outcome.UNKNOWN_AGENT, "given 'spot', allowed: 'go2'"),
        (order(0.0, 1.0, frame_id="odom"), Outcome.UNKNOWN_FRAME, "allowed: 'map'"),
        (order(0.0, 3.0), Outcome.LIMITS_EXCEEDED, "speed at 1.000 s: given 3 m/s, allowed: 1"),
        (
            order(0.6, 1.0),
            Outcome.START_TOO_FAR,
            "start: given a trajectory 0.600 m away, allowed: 0.5 m",
        ),
        (order(0.0, 1.0, start_ns=1), Outcome.INVALID_TRAJECTORY, "ended 97.000 s ago"),
        (order(0.0, 1.0, start_ns=98 * S), Outcome.START_TOO_FAR, "1.000 m away"),
    ],
)
def test_orders_that_an_agent_cannot_carry_out_are_refused_with_the_reason(given, outcome, says):
    with pytest.raises(RefusalError, match=says) as caught:
        check(given)
    assert caught.value.outcome is outcome
    assert str(caught.value) == f"{outcome.value}: {caught.value.text}"


def test_a_trajectory_that_has_begun_is_accepted_where_it_is_now():
    check(order(-1.0, 0.0, start_ns=98 * S))
    check(order(0.0, 1.0, start_ns=200 * S))
