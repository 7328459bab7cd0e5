"""A simulated agent on a timed trajectory: within its limits whatever is asked, and there in the end."""

import math
from itertools import pairwise

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from trajectory_strategies import poses, trajectories

from sfglab.bus import GoalStatus
from sfglab.errors import InvalidValueError
from sfglab.spatial import Pose
from sfglab.spatial.execution.agent import (
    TRANSITIONS,
    AgentState,
    Dynamics,
    Follower,
    Limits,
    Phase,
    Tolerances,
)
from sfglab.spatial.execution.orders import (
    OUTCOMES,
    Order,
    Outcome,
    RefusalError,
    Rules,
    judge,
    outcome_of,
)
from sfglab.spatial.trajectory.path import Trajectory

S = 1_000_000_000
EASY = Tolerances(path_m=None, settle_s=3600.0)
limits = st.builds(
    Limits,
    speed_m_s=st.floats(0.3, 5.0),
    acceleration_m_s2=st.floats(0.3, 10.0),
    yaw_rate_rad_s=st.floats(0.3, 6.0),
)
steps_ns = st.lists(st.integers(0, 400_000_000), min_size=1, max_size=60)


def line(*points, rest_s=1.0):
    """Waypoints a second apart along x, with a wait at the start and the end."""
    xs = (points[0], *points, points[-1])
    return Trajectory.of((round(i * rest_s * S), Pose.at((x, 0.0, 0.0))) for i, x in enumerate(xs))


def follower(trajectory, *, state=None, dynamics=None, tolerances=EASY, start_ns=0):
    state = state or AgentState(pose=trajectory.waypoints[0].pose)
    given = {"dynamics": dynamics or Dynamics(), "tolerances": tolerances}
    return Follower(trajectory, state=state, now_ns=0, start_ns=start_ns, **given)


def run_to_end(following, step_ns=50_000_000, limit=100_000):
    now_ns = 0
    for _ in range(limit):
        now_ns += step_ns
        progress = following.step(now_ns)
        if progress.outcome is not None:
            return progress
    pytest.fail("it never ended")


def rounding(vector):
    """What a difference to this vector can be wrong by, though both are exact to their last digit."""
    return 2 * math.ulp(math.hypot(*vector))


@settings(max_examples=30, deadline=None)
@given(trajectories(), limits, poses, steps_ns)
@example(  # after a step of 2 ns a velocity's own rounding is more than a billionth of what it may change
    Trajectory.of((t_ns, Pose.at((0.0, 0.0, 0.0))) for t_ns in (0, 1_000_000)),
    Limits(speed_m_s=1.0, acceleration_m_s2=4.5, yaw_rate_rad_s=1.0),
    Pose.at((0.0, 0.0, 1.0)),
    [27_777_777, 2],
)
def test_no_limit_is_ever_exceeded_whatever_is_asked_and_however_time_goes_on(
    path, held, at, steps
):
    following = follower(path, state=AgentState(pose=at), dynamics=Dynamics(limits=held))
    before, now_ns, last_ns = following.progress.state, 0, 0
    for step in steps:
        now_ns += step
        after = following.step(now_ns).state
        dt_s = (now_ns - last_ns) / S
        change = math.dist(after.velocity_m_s, before.velocity_m_s)
        assert after.speed_m_s <= held.speed_m_s * (1 + 1e-9)
        assert change <= held.acceleration_m_s2 * dt_s * (1 + 1e-9) + rounding(before.velocity_m_s)
        assert before.pose.angle_rad(after.pose) <= held.yaw_rate_rad_s * dt_s * (1 + 1e-6) + 1e-6
        way = before.pose.distance_m(after.pose)
        assert way <= held.speed_m_s * dt_s * (1 + 1e-9) + rounding(before.pose.position_m)
        before, last_ns = after, now_ns


@settings(max_examples=10, deadline=None)
@given(trajectories(), limits)
def test_an_agent_that_may_take_its_time_stands_at_the_last_pose_in_the_end(path, held):
    progress = run_to_end(follower(path, dynamics=Dynamics(limits=held)), step_ns=200_000_000)
    last = path.waypoints[-1].pose
    assert progress.outcome is Outcome.SUCCEEDED
    assert progress.share == 1.0
    assert progress.state.pose.distance_m(last) <= EASY.goal_m
    assert progress.state.pose.angle_rad(last) <= EASY.goal_rad


@pytest.mark.parametrize("points", [(0, 0.9), (0, 0.5, 0.8), (0, 0.3, 0.3, 0.0)])
def test_an_agent_falls_behind_by_no_more_than_accelerating_to_the_plans_speed_takes(points):
    path = line(*(4 * x for x in points), rest_s=4.0)
    held = Dynamics(limits=Limits(speed_m_s=1.0, acceleration_m_s2=1.0))
    progress = run_to_end(follower(path, dynamics=held), 20_000_000)
    assert progress.outcome is Outcome.SUCCEEDED
    # v^2 / (2 a), twice the speed at a corner, and the lag
    assert 0.01 < progress.largest_error_m <= 2.0 + 0.1


@settings(max_examples=10, deadline=None)
@given(trajectories(), limits, st.floats(0.0, 20.0))
def test_an_agent_that_is_stopped_brakes_at_once_and_as_hard_as_it_can(path, held, after_s):
    following = follower(path, dynamics=Dynamics(limits=held))
    begun = following.step(round(after_s * S))
    if begun.outcome is not None:
        return
    following.stop(Outcome.CANCELED)
    speed, speeds, now_ns = begun.state.speed_m_s, [], round(after_s * S)
    while (progress := following.step(now_ns := now_ns + 20_000_000)).outcome is None:
        speeds.append(progress.state.speed_m_s)
        assert progress.phase is Phase.BRAKING
    assert progress.outcome is Outcome.CANCELED
    assert progress.state.speed_m_s == 0.0
    assert all(b < a for a, b in pairwise([speed, *speeds]))
    assert len(speeds) * 0.02 <= speed / held.acceleration_m_s2 + 0.04
    assert (
        begun.state.pose.distance_m(progress.state.pose)
        <= speed**2 / (2 * held.acceleration_m_s2) + 1e-6
    )
    assert following.step(now_ns + S).state == progress.state


def test_the_result_does_not_depend_on_how_time_is_cut():
    path = line(0.0, 1.0, 3.0, 2.0)
    ends = [
        run_to_end(follower(path), step_ns=step).state.pose for step in (20_000_000, 100_000_000)
    ]
    assert ends[0].same_as(ends[1], within_m=1e-3)


def test_time_that_stands_or_runs_backwards_moves_nobody():
    following = follower(line(0.0, 1.0))
    at = following.step(1_500_000_000).state
    assert following.step(1_500_000_000).state == at
    assert following.step(0).state == at


def test_an_agent_that_is_too_far_from_where_it_should_be_brakes_and_says_so():
    held = Dynamics(limits=Limits(speed_m_s=0.5, acceleration_m_s2=1.0))
    progress = run_to_end(
        follower(line(0.0, 5.0), dynamics=held, tolerances=Tolerances(path_m=0.5))
    )
    assert progress.outcome is Outcome.PATH_LEFT
    assert progress.state.speed_m_s == 0.0
    assert 0.5 < progress.largest_error_m < 0.6


def test_an_agent_that_does_not_arrive_in_time_says_so():
    held = Dynamics(limits=Limits(speed_m_s=0.5))
    tolerances = Tolerances(path_m=None, settle_s=1.0)
    progress = run_to_end(follower(line(0.0, 5.0), dynamics=held, tolerances=tolerances))
    assert progress.outcome is Outcome.GOAL_MISSED
    assert 4.0 < progress.time_ns / S < 4.2


def test_an_agent_waits_at_the_start_until_the_trajectory_begins():
    progress = follower(line(0.0, 1.0), start_ns=5 * S).step(4 * S)
    assert (progress.share, progress.time_ns, progress.state.speed_m_s) == (0.0, -S, 0.0)


def test_every_phase_can_be_left_and_ends():
    assert TRANSITIONS.keys() == set(Phase)
    reached = {Phase.DRIVING}
    for _ in Phase:
        reached |= {to for phase in reached for to in TRANSITIONS[phase].values()}
    assert reached == set(Phase)
    assert not TRANSITIONS[Phase.ENDED]
    assert all(TRANSITIONS[phase] for phase in Phase if phase is not Phase.ENDED)


def test_every_outcome_reads_back_from_status_and_code():
    assert OUTCOMES.keys() == set(Outcome)
    for outcome, ending in OUTCOMES.items():
        if outcome is not Outcome.REJECTED:
            assert outcome_of(ending.status, ending.code) is outcome
    assert outcome_of(GoalStatus.ABORTED, 99) is Outcome.FAILED


@pytest.mark.parametrize(
    "wrong", [{"lag_s": -1.0}, {"gain_per_s": 0.0}, {"gain_per_s": 9.0}, {"lag_s": math.inf}]
)
def test_dynamics_that_no_agent_has_are_refused(wrong):
    with pytest.raises(InvalidValueError, match="allowed"):
        Dynamics(**wrong)


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.nan, math.inf])
def test_limits_that_are_no_numbers_above_zero_are_refused(wrong):
    with pytest.raises(InvalidValueError, match="limits, speed_m_s"):
        Limits(speed_m_s=wrong)


def test_the_yaw_rate_is_that_of_the_turn():
    path = Trajectory.of([(0, Pose()), (2 * S, Pose.from_yaw((0.0, 0.0, 0.0), -1.0))])
    progress = follower(path).step(S)
    assert progress.state.yaw_rate_rad_s == pytest.approx(-0.5)


RULES = Rules(agent="go2", frame_id="map", speed_m_s=1.0, start_m=0.5)


def order(*points, agent="go2", **more):
    return Order(agent=agent, trajectory=line(*points), **more)


@pytest.mark.parametrize(
    ("given", "outcome", "says"),
    [
        (order(0.0, 1.0, agent="spot"), Outcome.UNKNOWN_AGENT, "given 'spot', allowed: 'go2'"),
        (order(0.0, 1.0, frame_id="odom"), Outcome.UNKNOWN_FRAME, "allowed: 'map'"),
        (order(0.0, 3.0), Outcome.LIMITS_EXCEEDED, "speed: given 3 m/s at 1.000 s, allowed: 1 m/s"),
        (order(0.6, 1.0), Outcome.START_TOO_FAR, "0.600 m away, allowed: 0.5 m"),
        (order(0.0, 1.0, start_ns=1), Outcome.INVALID_TRAJECTORY, "ended 97.000 s ago"),
        (order(0.0, 1.0, start_ns=98 * S), Outcome.START_TOO_FAR, "1.000 m away"),
    ],
)
def test_what_an_agent_does_not_take_is_refused_with_the_reason(given, outcome, says):
    with pytest.raises(RefusalError, match=says) as caught:
        judge(given, RULES, Pose(), 100 * S)
    assert caught.value.outcome is outcome
    assert OUTCOMES[outcome].refused
    assert str(caught.value) == f"{outcome.value}: {caught.value.text}"


def test_a_trajectory_that_has_begun_is_taken_where_it_is_by_now():
    judge(order(-1.0, 0.0, start_ns=98 * S), RULES, Pose(), 100 * S)
    judge(order(0.0, 1.0, start_ns=200 * S), RULES, Pose(), 100 * S)
