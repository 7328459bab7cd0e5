"""The life of goals as pure values: the table of the ROS 2 design, and what a server remembers."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.bus.actions.goals import (
    NO_GOAL_ID,
    TERMINAL,
    TRANSITIONS,
    CancelCode,
    GoalBook,
    GoalEvent,
    GoalStatus,
)
from sfglab.machine import IllegalInputError
from sfglab.messages import message_type, service_type

IDS = [bytes([n]) * 16 for n in range(1, 5)]
S, E = GoalStatus, GoalEvent


def test_statuses_and_codes_are_the_numbers_of_action_msgs():
    status = message_type("action_msgs/msg/GoalStatus")
    assert {s.name: s.value for s in GoalStatus} == {s.name: getattr(status, f"STATUS_{s.name}") for s in S}
    response = service_type("action_msgs/srv/CancelGoal").response
    assert {c: c.value for c in CancelCode} == {c: getattr(response, f"ERROR_{c.name}") for c in CancelCode}


def test_every_goal_can_be_brought_to_an_end_and_none_leaves_it():
    reached = {S.ACCEPTED}
    for _ in GoalStatus:
        reached |= {after for (before, _), after in TRANSITIONS.items() if before in reached}
    assert reached == set(GoalStatus) - {S.UNKNOWN}
    assert not {before for before, _ in TRANSITIONS} & TERMINAL
    for start in reached - TERMINAL:
        ends = {start}
        for _ in GoalStatus:
            ends |= {after for (before, _), after in TRANSITIONS.items() if before in ends}
        assert ends & TERMINAL == (TERMINAL if start is not S.UNKNOWN else set())


@given(st.lists(st.tuples(st.sampled_from(IDS), st.sampled_from([None, *GoalEvent])), max_size=60))
def test_any_history_follows_the_table_and_what_is_illegal_changes_nothing(history):
    book, expected, ended = GoalBook(10**12), {}, {}
    for now_ns, (goal_id, event) in enumerate(history):
        if event is None:
            assert book.accept(goal_id, now_ns) == (goal_id not in expected)
            expected.setdefault(goal_id, S.ACCEPTED)
        elif (after := TRANSITIONS.get((expected.get(goal_id, S.UNKNOWN), event))) is None:
            with pytest.raises(IllegalInputError, match=goal_id.hex()):
                book.apply(goal_id, event, now_ns)
        else:
            assert book.apply(goal_id, event, now_ns) is after
            expected[goal_id] = after
            if after in TERMINAL:
                ended[goal_id] = now_ns
        assert {goal.goal_id: goal.status for goal in book.goals()} == expected
        assert {g.goal_id: g.ended_ns for g in book.goals() if g.ended_ns is not None} == ended


@given(st.lists(st.booleans(), min_size=4, max_size=4), st.integers(1, 100), st.integers(0, 200))
def test_only_ended_goals_are_forgotten_and_only_after_the_timeout(end, timeout_ns, now_ns):
    book = GoalBook(timeout_ns)
    for number, (goal_id, ends) in enumerate(zip(IDS, end, strict=True)):
        book.accept(goal_id, 0)
        book.apply(goal_id, E.EXECUTE, 0)
        if ends:
            book.apply(goal_id, E.SUCCEED, number * 10)
    old = {IDS[n] for n in range(4) if end[n] and now_ns - n * 10 >= timeout_ns}
    assert set(book.expire(now_ns)) == old
    assert {goal.goal_id for goal in book.goals()} == set(IDS) - old
    assert all(book.status(goal_id) is S.UNKNOWN and goal_id not in book for goal_id in old)


PATHS = {
    S.ACCEPTED: (),
    S.EXECUTING: (E.EXECUTE,),
    S.CANCELING: (E.CANCEL_GOAL,),
    S.SUCCEEDED: (E.EXECUTE, E.SUCCEED),
}


@given(
    st.lists(st.sampled_from([None, *PATHS]), min_size=4, max_size=4),
    st.sampled_from([NO_GOAL_ID, *IDS]),
    st.integers(0, 5),
)
def test_a_request_to_cancel_means_what_action_msgs_says(statuses, goal_id, until_ns):
    book = GoalBook(10**9)
    for stamp_ns, (known, status) in enumerate(zip(IDS, statuses, strict=True), 1):
        if status is not None:
            book.accept(known, stamp_ns)
            for event in PATHS[status]:
                book.apply(known, event, stamp_ns)
    can = [known for known, status in zip(IDS, statuses, strict=True) if status in {S.ACCEPTED, S.EXECUTING}]
    plan = book.to_cancel(goal_id, until_ns)
    if goal_id == NO_GOAL_ID and until_ns == 0:
        wanted = can
    else:
        wanted = [known for known in can if known == goal_id or IDS.index(known) + 1 <= until_ns]
    assert list(plan.goal_ids) == wanted
    if goal_id == NO_GOAL_ID or until_ns or wanted:
        assert plan.code is CancelCode.NONE
    else:
        unknown = statuses[IDS.index(goal_id)] is None
        assert plan.code is (CancelCode.UNKNOWN_GOAL_ID if unknown else CancelCode.GOAL_TERMINATED)
