"""Actions between nodes: the same facts on the live and the simulated bus, and the bytes on the wire."""

import asyncio
from collections import defaultdict
from contextlib import asynccontextmanager

import numpy as np
import pytest
from bus_messages import failures

from sfglab import bus
from sfglab.bus.actions.goals import goal_id_from, goal_info
from sfglab.machine import IllegalInputError
from sfglab.messages import action_type, service_type
from sfglab.messages.store import interface_texts, register_texts
from sfglab.qos import DEFAULT, LATCHED, SERVICES

ACTION = "sfglab_test_interfaces/action/Fibonacci"
TEXT = "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n"
register_texts(interface_texts(ACTION, TEXT))
Fibonacci = action_type(ACTION)
CANCEL, STATUS = "action_msgs/srv/CancelGoal", "action_msgs/msg/GoalStatusArray"
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
async def pair(node, execute):
    """A client of an action, its node and the server, which is of another node."""
    async with node("server") as there, node("client") as here:
        server = there.create_action_server(ACTION, "/agent/count", execute)
        client = here.create_action_client(ACTION, "agent/count")
        await client.wait_for_server()
        yield client, here, server


async def test_goals_run_beside_each_other_and_each_gives_its_feedback_in_order_and_its_result(
    node, until
):
    async with pair(node, compute) as (client, here, server):
        other = here.create_action_client(ACTION, "/agent/count")
        await other.wait_for_server()
        heard = [[] for _ in range(4)]  # ten messages, no more than the topic's depth
        calls = [
            (client, other)[order % 2].send_goal(goal(order + 1), messages.append)
            for order, messages in enumerate(heard)
        ]
        handles = await asyncio.gather(*calls)
        assert len({handle.goal_id for handle in handles}) == 4
        for count, (handle, messages) in enumerate(zip(handles, heard, strict=True), start=3):
            end = await handle.result()
            again = await client.result_of(handle.goal_id)  # kept, so it can be asked again
            values = numbers(end.result)
            assert (end.status, values) == (Status.SUCCEEDED, [0, 1, 1, 2, 3, 5][:count])
            assert numbers(again.result) == values
            await until(lambda got=messages, count=count: len(got) == count - 2)
            assert [numbers(m) for m in messages] == [values[:n] for n in range(3, count + 1)]
        server.close()
        assert await handle.result() == end, "a result that was received outlives its server"


async def test_a_goal_whose_id_is_taken_is_rejected_and_one_of_another_type_refused(
    node, monkeypatch
):
    async with pair(node, compute) as (client, here, _):
        monkeypatch.setattr(here.backend, "random_bytes", bytes)
        handle = await client.send_goal(goal(1))
        with pytest.raises(bus.GoalRejectedError, match="'/agent/count'"):
            await client.send_goal(goal(2))
        assert len(numbers((await handle.result()).result)) == 3
        with pytest.raises(bus.InvalidMessageError, match="Fibonacci_Goal"):
            await client.send_goal(sequence(Fibonacci.result, []))


async def test_a_goal_is_canceled_by_its_id_or_with_all_others_and_once(node):
    steps = Steps()
    async with pair(node, steps) as (client, here, _):
        handles = [await client.send_goal(goal(number)) for number in (1, 2)]
        await steps.begun.wait()
        stranger = here.create_client(CANCEL, "/agent/count/_action/cancel_goal")
        until_now = service_type(CANCEL).request(goal_info=goal_info(stamp_ns=1))
        assert (await stranger.call(until_now)).return_code == Code.REJECTED
        assert steps.handles[0].status is Status.EXECUTING
        assert await handles[0].cancel_goal() is Code.NONE
        everything = service_type(CANCEL).request(goal_info=goal_info())
        (other,) = (await stranger.call(everything)).goals_canceling
        assert goal_id_from(other.goal_id) == handles[1].goal_id
        for number, handle in enumerate(handles, start=1):
            end = await handle.result()
            assert (end.status, numbers(end.result)) == (Status.CANCELED, [number])
            assert await handle.cancel_goal() is Code.GOAL_TERMINATED
        assert await client.cancel(bytes(range(16))) is Code.UNKNOWN_GOAL_ID
        with pytest.raises(IllegalInputError, match="in CANCELED: given SUCCEED"):
            steps.handles[0].succeed()


async def test_a_callback_that_fails_or_says_nothing_aborts_its_goal(node, caplog):
    def execute(handle):
        if handle.request.order == 0:
            raise LookupError("lost")
        if handle.request.order == 1:
            raise asyncio.CancelledError
        return None if handle.request.order == 2 else goal(0)  # the last is no result

    async with pair(node, execute) as (client, *_):
        for order in range(4):
            end = await (await client.send_goal(goal(order))).result()
            assert (end.status, numbers(end.result)) == (Status.ABORTED, [])
    assert failures(caplog) == [LookupError, bus.InvalidMessageError]


async def test_the_results_of_the_last_goals_are_kept_and_of_older_ones_forgotten(
    node, monkeypatch
):
    monkeypatch.setattr("sfglab.bus.actions.server.KEPT_GOALS", 3)
    async with pair(node, compute) as (client, *_):
        first, *others = [await client.send_goal(goal(0)) for _ in range(4)]
        for handle in reversed(others):
            assert (await handle.result()).status is Status.SUCCEEDED
            assert await handle.cancel_goal() is Code.GOAL_TERMINATED
        with pytest.raises(bus.BusError, match=first.goal_id.hex()):
            await first.result()
        assert await first.cancel_goal() is Code.UNKNOWN_GOAL_ID


async def test_a_server_that_goes_aborts_its_goals_and_ends_the_waiting_of_its_clients(world, node):
    steps, said = Steps(), set()
    async with pair(node, steps) as (client, here, server):
        latched = here.create_subscription(STATUS, "/agent/count/_action/status", None, LATCHED)
        await latched.wait_for_publishers()
        handle = await client.send_goal(goal(1))
        await steps.begun.wait()
        server.close()
        server.close()
        with pytest.raises(
            bus.BusError, match=f"disappeared before goal {handle.goal_id.hex()} ended"
        ):
            await handle.result()
        with pytest.raises(bus.BusTimeoutError, match="action '/agent/count': a server"):
            await client.send_goal(goal(1), timeout_s=0.01)
        assert steps.handles[0].status is Status.ABORTED
        ended = (handle.goal_id, Status.ABORTED)
        while world.kind == "live" and ended not in said:  # others' last words may be lost
            (one,) = (await latched.take(60)).status_list
            said.add((goal_id_from(one.goal_info.goal_id), one.status))


async def test_a_client_that_goes_leaves_its_goals_running(node):
    steps = Steps()
    async with pair(node, steps) as (client, *_):
        async with node("first") as first:
            leaving = first.create_action_client(ACTION, "/agent/count")
            handle = await leaving.send_goal(goal(5))
            waiting = asyncio.create_task(handle.result())
            await steps.begun.wait()
        with pytest.raises(bus.ClosedError):
            await waiting
        steps.go_on.set()
        end = await client.result_of(handle.goal_id)
        assert (end.status, numbers(end.result)) == (Status.SUCCEEDED, [5])


async def test_the_topics_have_the_names_types_and_qualities_of_rcl_action(node, world, until):
    keeps_all, keeps_some = (f"<QoS reliable, volatile, keep_{n}>" for n in ("all", "last 100"))
    if world.kind == "zenoh":  # one token announces both endpoints, with ROS 2's profile
        keeps_all = keeps_some = str(SERVICES)
    wanted = {
        ("rt/count/_action/feedback", f"{ACTION}_FeedbackMessage"): {str(DEFAULT)},
        ("rt/count/_action/status", STATUS): {str(LATCHED)},
    }
    services = {"send_goal": f"{ACTION}_SendGoal", "get_result": f"{ACTION}_GetResult"}
    for name, type_ in (services | {"cancel_goal": CANCEL}).items():
        wanted[f"rq/count/_action/{name}Request", f"{type_}_Request"] = {keeps_all}
        # A server keeps fewer answers than a client takes.
        wanted[f"rr/count/_action/{name}Reply", f"{type_}_Response"] = {keeps_all, keeps_some}
    shown = defaultdict(set)
    async with node("both") as here:
        here.create_action_server(ACTION, "/count", compute)
        here.create_action_client(ACTION, "/count")
        await until(lambda: len(here.graph.endpoints()) == 15)
        for end in here.graph.endpoints():
            shown[end.dds_topic, end.type].add(str(end.qos))
    assert shown == wanted
