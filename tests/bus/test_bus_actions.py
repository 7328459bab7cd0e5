"""Actions between nodes: the same facts on the live and the simulated bus, and the bytes on the wire."""

import asyncio
from contextlib import asynccontextmanager

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab import bus
from sfglab.bus.actions.goals import (
    KEPT_GOALS,
    NO_GOAL_ID,
    CancelCode,
    GoalStatus,
    goal_info,
    to_cancel,
)
from sfglab.machine import IllegalInputError
from sfglab.messages import message_type, register_action, service_type
from sfglab.qos import DEFAULT, LATCHED, Durability, History

ACTION = "sfglab_test_interfaces/action/Fibonacci"
Fibonacci = register_action(ACTION, "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n")
STATUS = "action_msgs/msg/GoalStatusArray"
Status, Code = bus.GoalStatus, bus.CancelCode


def goal(order):
    return Fibonacci.goal(order=order)


def numbers(message):
    return [int(n) for n in message.sequence]


def sequence(type_, values):
    return type_(sequence=np.array(values, np.int32))


class Steps:
    """An execute callback whose goals go on when the test lets them."""

    def __init__(self):
        self.handles = []
        self.begun = asyncio.Event()
        self.go_on = asyncio.Event()

    async def __call__(self, handle):
        self.handles.append(handle)
        self.begun.set()
        while not (self.go_on.is_set() or handle.is_cancel_requested):
            await asyncio.sleep(0.001)
        if handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.succeed()
        return sequence(Fibonacci.result, [handle.request.order])


async def compute(handle):
    values = [0, 1]
    for _ in range(handle.request.order):
        values.append(values[-1] + values[-2])
        handle.publish_feedback(sequence(Fibonacci.feedback, values))
    handle.succeed()
    return sequence(Fibonacci.result, values)


@asynccontextmanager
async def pair(node, execute, **options):
    async with (
        node("server", on_error=options.pop("on_error", None)) as there,
        node("client") as here,
    ):
        server = there.create_action_server(ACTION, "/agent/count", execute, **options)
        client = here.create_action_client(ACTION, "agent/count")
        await client.wait_for_server()
        yield there, here, server, client


async def heard(latched, wanted):
    """Return once the first goal of the topic has the wanted status."""
    while not (goals := (await latched.take(60)).status_list) or goals[0].status != wanted:
        pass


async def test_a_goal_gives_feedback_in_order_and_then_its_result(node, until):
    async with pair(node, compute) as (there, _, server, client):
        called = []
        before_ns = there.get_clock().now_ns()
        handle = await client.send_goal(goal(4), lambda feedback: called.append(numbers(feedback)))
        assert before_ns <= handle.accepted_ns <= there.get_clock().now_ns()
        await until(lambda: len(called) == 4)
        assert called == [[0, 1, 1], [0, 1, 1, 2], [0, 1, 1, 2, 3], [0, 1, 1, 2, 3, 5]]
        end = await handle.result()
        assert (end.status, numbers(end.result)) == (Status.SUCCEEDED, [0, 1, 1, 2, 3, 5])
        again = await client.result_of(handle.goal_id)  # kept, so it can be asked again
        assert numbers(again.result) == numbers(end.result)
        assert (client.action_name, server.action_name) == ("/agent/count", "/agent/count")
        assert server.last_error is None


async def test_goals_run_beside_each_other_and_hear_only_of_themselves(node, until):
    async with pair(node, compute) as (_, here, _, client):
        other = here.create_action_client(ACTION, "/agent/count")
        await other.wait_for_server()
        heard = {order: [] for order in range(1, 5)}  # ten messages, no more than the topic's depth
        handles = await asyncio.gather(
            *(
                (client, other)[order % 2].send_goal(goal(order), lambda m, to=to: to.append(m))
                for order, to in heard.items()
            )
        )
        assert len({handle.goal_id for handle in handles}) == len(heard)
        for (order, messages), handle in zip(heard.items(), handles, strict=True):
            assert len(numbers((await handle.result()).result)) == order + 2
            await until(lambda m=messages, n=order: len(m) == n)
            lengths = [len(numbers(message)) for message in messages]
            assert lengths == list(range(3, order + 3))


async def test_a_rejected_goal_is_an_error_whether_refused_failed_or_unanswered(node):
    reported = []
    answers = {0: lambda: bus.GoalResponse.REJECT, 1: lambda: True, 2: lambda: 1 / 0}

    async def decide(wanted):
        return answers[wanted.order]() if wanted.order in answers else bus.GoalResponse.ACCEPT

    async with pair(
        node,
        compute,
        goal_callback=decide,
        on_error=lambda error, where: reported.append((type(error), where)),
    ) as (_, _, _, client):
        for order in answers:
            with pytest.raises(bus.GoalRejectedError, match="'/agent/count'"):
                await client.send_goal(goal(order))
        where = f"action server {ACTION!r}"
        assert reported == [(ValueError, where), (ZeroDivisionError, where)]
        assert (await (await client.send_goal(goal(3))).result()).status is Status.SUCCEEDED
        with pytest.raises(bus.InvalidMessageError, match="Fibonacci_Goal"):
            await client.send_goal(sequence(Fibonacci.result, []))


async def test_a_goal_is_canceled_when_the_server_agrees_and_only_then(node):
    steps = Steps()
    willing = [bus.CancelResponse.REJECT, bus.CancelResponse.ACCEPT]
    async with pair(node, steps, cancel_callback=lambda _: willing.pop(0)) as (_, _, _, client):
        handle = await client.send_goal(goal(1))
        await steps.begun.wait()
        assert await handle.cancel_goal() is Code.REJECTED
        assert steps.handles[0].status is Status.EXECUTING
        assert await handle.cancel_goal() is Code.NONE
        end = await handle.result()
        assert (end.status, numbers(end.result)) == (Status.CANCELED, [1])
        assert await handle.cancel_goal() is Code.GOAL_TERMINATED
        unknown = await client.cancel_goals(bytes(range(16)))
        assert (unknown.code, unknown.goal_ids) == (Code.UNKNOWN_GOAL_ID, ())
        with pytest.raises(IllegalInputError, match="in CANCELED: given SUCCEED"):
            steps.handles[0].succeed()


async def test_all_goals_are_canceled_at_once_and_those_until_a_time_are_not(node):
    steps = Steps()
    async with pair(node, steps, cancel_callback=lambda _: bus.CancelResponse.ACCEPT) as (
        _,
        _,
        _,
        client,
    ):
        handles = [await client.send_goal(goal(order)) for order in range(4)]
        request = service_type("action_msgs/srv/CancelGoal").request
        until = request(goal_info=goal_info(stamp_ns=handles[1].accepted_ns))
        answer = await client._cancel.call(until)
        assert (answer.return_code, answer.goals_canceling) == (Code.REJECTED, [])
        every = await client.cancel_goals(NO_GOAL_ID)
        assert every.goal_ids == tuple(handle.goal_id for handle in handles)
        ends = [await handle.result() for handle in handles]
        assert [end.status for end in ends] == [Status.CANCELED] * 4
        nothing = await client.cancel_goals()
        assert (nothing.code, nothing.goal_ids) == (Code.NONE, ())


async def test_a_callback_that_fails_or_says_nothing_aborts_its_goal(node):
    reported = []

    def execute(handle):
        if handle.request.order == 0:
            raise LookupError("lost")
        if handle.request.order == 3:
            raise asyncio.CancelledError
        return None if handle.request.order == 1 else goal(0)  # the last is no result

    async with pair(node, execute, on_error=lambda error, _: reported.append(type(error))) as (
        *_,
        client,
    ):
        for order in range(4):
            end = await (await client.send_goal(goal(order))).result()
            assert (end.status, numbers(end.result)) == (Status.ABORTED, [])
        assert reported == [LookupError, bus.InvalidMessageError]


async def test_the_results_of_the_last_goals_are_kept_and_of_older_ones_forgotten(node):
    async with pair(node, compute) as (*_, client):
        handles = [await client.send_goal(goal(0)) for _ in range(KEPT_GOALS + 1)]
        for handle in reversed(handles):
            if handle is not handles[0]:
                assert (await handle.result()).status is Status.SUCCEEDED
        with pytest.raises(bus.BusError, match=handles[0].goal_id.hex()):
            await handles[0].result()
        assert await handles[0].cancel_goal() is Code.UNKNOWN_GOAL_ID
        assert await handles[1].cancel_goal() is Code.GOAL_TERMINATED


async def test_an_id_that_is_taken_is_rejected(node):
    async with pair(node, compute) as (_, here, _, client):
        handle = await client.send_goal(goal(1))
        again = here.create_client(Fibonacci.send_goal.name, "/agent/count/_action/send_goal")
        uuid = message_type("unique_identifier_msgs/msg/UUID")(
            uuid=np.frombuffer(handle.goal_id, np.uint8)
        )
        response = await again.call(Fibonacci.send_goal.request(goal_id=uuid, goal=goal(2)))
        assert not response.accepted
        assert len(numbers((await handle.result()).result)) == 3


async def test_a_server_that_goes_ends_the_waiting_of_its_clients(node):
    steps = Steps()
    async with node("client") as here:
        client = here.create_action_client(ACTION, "/agent/count")
        with pytest.raises(bus.BusTimeoutError, match="action '/agent/count': a server"):
            await client.send_goal(goal(1), timeout_s=0.01)
        async with node("server") as there:
            there.create_action_server(ACTION, "/agent/count", steps)
            handle = await client.send_goal(goal(1))
            with pytest.raises(bus.BusTimeoutError):
                await handle.result(timeout_s=0.05)
            result = asyncio.create_task(handle.result())
            await steps.begun.wait()
        with pytest.raises(bus.ActionServerGoneError, match=handle.goal_id.hex()):
            await result


async def test_a_server_that_closes_tells_that_its_goals_are_aborted(world, node):
    steps = Steps()
    async with pair(node, steps) as (_, here, server, client):
        latched = here.create_subscription(STATUS, "/agent/count/_action/status", None, LATCHED)
        await latched.wait_for_publishers()
        handle = await client.send_goal(goal(1))
        await steps.begun.wait()
        server.close()
        server.close()
        if world.kind == "live":  # another writer that ends takes with it what is on its way
            await heard(latched, Status.ABORTED)
        with pytest.raises(bus.ActionServerGoneError):
            await handle.result()
        with pytest.raises(bus.BusTimeoutError, match="a server"):
            await client.wait_for_server(0.1)
        assert steps.handles[0].status is Status.ABORTED


async def test_a_client_that_goes_leaves_its_goals_running(node):
    steps = Steps()
    async with node("server") as there:
        server = there.create_action_server(ACTION, "/agent/count", steps)
        async with node("first") as first:
            leaving = first.create_action_client(ACTION, "/agent/count")
            handle = await leaving.send_goal(goal(5))
            waiting = asyncio.create_task(handle.result())
            await steps.begun.wait()
            assert await handle.cancel_goal() is Code.REJECTED, (
                "as nobody cancels without a callback"
            )
        with pytest.raises(bus.ClosedError):
            await waiting
        async with node("second") as second:
            client = second.create_action_client(ACTION, "/agent/count")
            await client.wait_for_server()
            steps.go_on.set()
            end = await client.result_of(handle.goal_id)
            assert (end.status, numbers(end.result)) == (Status.SUCCEEDED, [5])
        assert server.last_error is None


async def test_the_topics_have_the_names_types_and_qualities_of_rcl_action(node, until):
    async with node("both") as here:
        here.create_action_server(ACTION, "/count", compute)
        here.create_action_client(ACTION, "/count")
        await until(lambda: len(here.graph.endpoints()) == 15)
        shown = {}
        for end in here.graph.endpoints():
            shown.setdefault((end.dds_topic, end.type), []).append(end.qos)
        services = {"send_goal": f"{ACTION}_SendGoal", "get_result": f"{ACTION}_GetResult"}
        services["cancel_goal"] = "action_msgs/srv/CancelGoal"
        wanted = {
            ("rt/count/_action/feedback", f"{ACTION}_FeedbackMessage"),
            ("rt/count/_action/status", STATUS),
        }
        for name, type_ in services.items():
            wanted.add((f"rq/count/_action/{name}Request", f"{type_}_Request"))
            wanted.add((f"rr/count/_action/{name}Reply", f"{type_}_Response"))
        assert set(shown) == wanted
        status = shown[("rt/count/_action/status", STATUS)]
        status *= 2  # our clients do not read it, rclpy's do
        for (topic, _), (one, other) in shown.items():
            answers = topic.startswith("rr/")  # which a server keeps fewer of than a client takes
            assert (one == other, {one.reliability, other.reliability}) == (
                not answers,
                {DEFAULT.reliability},
            )
            latched = topic == "rt/count/_action/status"
            assert (one.durability is Durability.TRANSIENT_LOCAL) == latched
            keeps = {History.KEEP_ALL} if topic.startswith("rq/") else {History.KEEP_LAST}
            assert {one.history, other.history} == keeps | (
                {History.KEEP_ALL} if answers else set()
            )
            if not topic.startswith(("rq/", "rr/")):
                assert one.depth == (1 if latched else 10)


async def test_feedback_and_status_are_these_bytes(node):
    async with node("server") as there, node("client") as here:
        there.create_action_server(ACTION, "/count", compute)
        raw = here.create_subscription(
            Fibonacci.feedback_message, "/count/_action/feedback", raw=True
        )
        statuses = here.create_subscription(
            STATUS, "/count/_action/status", None, LATCHED, raw=True
        )
        client = here.create_action_client(ACTION, "/count")
        await raw.wait_for_publishers()
        await statuses.wait_for_publishers()
        handle = await client.send_goal(goal(1))
        header, one = b"\0\1\0\0", (1).to_bytes(4, "little")
        values = b"\3\0\0\0" + bytes(4) + one + one
        assert bytes(await raw.take(60)) == header + handle.goal_id + values
        sec, nanosec = divmod(handle.accepted_ns, 10**9)
        stamp = sec.to_bytes(4, "little") + nanosec.to_bytes(4, "little")
        ended = header + one + handle.goal_id + stamp + bytes([Status.SUCCEEDED, 0, 0, 0])
        while bytes(await statuses.take(60)) != ended:
            pass


IDS = [bytes([n]) * 16 for n in range(1, 5)]
S = GoalStatus


def test_statuses_and_codes_are_the_numbers_of_action_msgs():
    status = message_type("action_msgs/msg/GoalStatus")
    assert {s.name: s.value for s in GoalStatus} == {
        s.name: getattr(status, f"STATUS_{s.name}") for s in S
    }
    response = service_type("action_msgs/srv/CancelGoal").response
    assert {c: c.value for c in CancelCode} == {
        c: getattr(response, f"ERROR_{c.name}") for c in CancelCode
    }


STATES = st.lists(st.sampled_from([None, *GoalStatus]), min_size=4, max_size=4)


@given(STATES, st.sampled_from([NO_GOAL_ID, *IDS]))
def test_a_request_to_cancel_means_what_action_msgs_says(statuses, goal_id):
    known = {one: status for one, status in zip(IDS, statuses, strict=True) if status is not None}
    can = [one for one, status in known.items() if status in {S.ACCEPTED, S.EXECUTING}]
    plan = to_cancel(known, goal_id, 0)
    assert list(plan.goal_ids) == [one for one in can if goal_id in {one, NO_GOAL_ID}]
    if goal_id == NO_GOAL_ID or plan.goal_ids:
        assert plan.code is CancelCode.NONE
    else:
        wanted = CancelCode.GOAL_TERMINATED if goal_id in known else CancelCode.UNKNOWN_GOAL_ID
        assert plan.code is wanted
