"""A simulated agent on a timed trajectory: its limits, its ends, and the goals that it refuses."""

import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from trajectory_strategies import poses, trajectories

from sfglab.bus import GoalStatus
from sfglab.spatial import Pose
from sfglab.spatial.execution.agent import GOAL_M, GOAL_RAD, AgentState, Follower, Limits
from sfglab.spatial.execution.orders import Order, Outcome, RefusalError, outcome_of
from sfglab.spatial.execution.server import AgentSetup, check_order
from sfglab.spatial.trajectory.path import Trajectory

S = 1_000_000_000
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


def follower(trajectory, held=None, *, pose=None, **more):
    state = AgentState(pose=pose or trajectory.waypoints[0].pose)
    given = {"limits": held or Limits(), "settle_s": 3600.0, "start_ns": 0} | more
    return Follower(trajectory, state=state, now_ns=0, **given)


def run_to_end(following, step_ns):
    for now_ns in range(step_ns, 10**15, step_ns):
        following.step(now_ns)
        if following.outcome is not None:
            return following
    pytest.fail("it never ended")


@settings(max_examples=30, deadline=None)
@given(trajectories(), limits, poses, st.lists(st.integers(10**6, 4 * 10**8), min_size=1))
def test_no_limit_is_ever_exceeded(path, held, at, steps):
    following = follower(path, held, pose=at)
    before, now_ns = following.state, 0
    for step in steps:
        now_ns += step
        following.step(now_ns)
        after, dt_s = following.state, step / S * (1 + 1e-6)
        change_m_s = math.dist(after.velocity_m_s, before.velocity_m_s)
        assert after.speed_m_s <= held.speed_m_s * (1 + 1e-9)
        assert change_m_s <= held.acceleration_m_s2 * dt_s
        assert before.pose.distance_m(after.pose) <= held.speed_m_s * dt_s
        assert before.pose.angle_rad(after.pose) <= held.yaw_rate_rad_s * dt_s + 1e-6
        before = after


@settings(max_examples=10, deadline=None)
@given(trajectories(), limits)
def test_an_agent_with_time_stands_at_the_last_pose_in_the_end(path, held):
    ended = run_to_end(follower(path, held), step_ns=200_000_000)
    last = path.waypoints[-1].pose
    assert (ended.outcome, ended.share) == (Outcome.SUCCEEDED, 1.0)
    assert ended.state.pose.same_as(last, within_m=GOAL_M, within_rad=GOAL_RAD)


@settings(max_examples=10, deadline=None)
@given(trajectories(), limits, st.integers(1, 20 * S))
def test_a_stopped_agent_brakes_as_hard_as_it_can_and_then_stands(path, held, now_ns):
    following = follower(path, held)
    following.step(now_ns)
    assume(following.outcome is None)
    begun, speed_m_s = following.state.pose, following.state.speed_m_s
    time_s = speed_m_s / held.acceleration_m_s2
    following.stop(Outcome.CANCELED)
    following.step(now_ns + round(0.9 * time_s * S))
    assert following.state.speed_m_s == pytest.approx(0.1 * speed_m_s, abs=1e-6)
    following.step(now_ns + round((time_s + 0.1) * S))
    assert (following.outcome, following.state.speed_m_s) == (Outcome.CANCELED, 0.0)
    assert begun.distance_m(following.state.pose) <= speed_m_s * time_s / 2 + 1e-6


def test_the_result_does_not_depend_on_how_time_is_cut_and_time_never_runs_backwards():
    path = line(0.0, 1.0, 3.0, 2.0)
    fine, coarse = (run_to_end(follower(path), step_ns=ms * 10**6) for ms in (20, 100))
    assert fine.state.pose.same_as(coarse.state.pose, within_m=1e-3)
    following = follower(path)
    following.step(3 * S // 2)
    at = following.state
    following.step(0)
    assert following.state == at


def test_an_agent_that_does_not_arrive_in_time_ends_with_that_outcome():
    following = follower(line(0.0, 5.0), Limits(speed_m_s=0.5), settle_s=1.0)
    assert run_to_end(following, 50_000_000).outcome is Outcome.GOAL_MISSED
    assert 4.0 < following.time_ns / S < 4.2


def test_an_agent_waits_until_the_trajectory_begins_and_turns_at_its_rate():
    turn = Trajectory.of([(0, Pose()), (2 * S, Pose.from_yaw((0.0, 0.0, 0.0), -1.0))])
    following = follower(turn, start_ns=5 * S)
    following.step(4 * S)
    assert (following.share, following.time_ns, following.state) == (0.0, -S, AgentState())
    following.step(6 * S)
    assert following.state.yaw_rate_rad_s == pytest.approx(-0.5)


def test_every_outcome_reads_back_from_status_and_code():
    read = {outcome: outcome_of(outcome.status, outcome.code) for outcome in Outcome}
    assert read.pop(Outcome.REJECTED) is outcome_of(GoalStatus.ABORTED, 99) is Outcome.FAILED
    assert all(outcome is found for outcome, found in read.items())


def check(*points, agent="go2", **more):
    given = Order(agent=agent, trajectory=line(*points), **more)
    check_order(given, "go2", AgentSetup(limits=Limits(speed_m_s=1.0)), Pose(), 100 * S)


TOO_FAR = "start: given a trajectory 0.600 m away, allowed: 0.5 m"


@pytest.mark.parametrize(
    ("points", "more", "outcome", "says"),
    [
        ((0, 1), {"agent": "spot"}, Outcome.UNKNOWN_AGENT, "given 'spot', allowed: 'go2'"),
        ((0, 1), {"frame_id": "odom"}, Outcome.UNKNOWN_FRAME, "allowed: 'map'"),
        ((0, 3), {}, Outcome.LIMITS_EXCEEDED, "speed at 1.000 s: given 3 m/s, allowed: 1"),
        ((0.6, 1), {}, Outcome.START_TOO_FAR, TOO_FAR),
        ((0, 1), {"start_ns": 1}, Outcome.INVALID_TRAJECTORY, "ended 97.000 s ago"),
        ((0, 1), {"start_ns": 98 * S}, Outcome.START_TOO_FAR, "1.000 m away"),
    ],
)
def test_orders_that_an_agent_cannot_carry_out_are_refused_with_the_reason(
    points, more, outcome, says
):
    with pytest.raises(RefusalError, match=says) as caught:
        check(*points, **more)
    assert caught.value.outcome is outcome
    assert str(caught.value) == f"{outcome.value}: {caught.value.text}"


def test_a_trajectory_that_has_begun_is_accepted_where_it_is_now():
    check(-1.0, 0.0, start_ns=98 * S)
    check(0.0, 1.0, start_ns=200 * S)
