"""Sending trajectories to agents: goal, feedback, result, and a cancellation that waits for the brake."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

from sfglab.bus import BusError, ClientGoalHandle, GoalRejectedError, Node
from sfglab.errors import InvalidValueError
from sfglab.spatial.execution.orders import (
    FOLLOW_TRAJECTORY,
    OUTCOMES,
    ActionDialect,
    Ended,
    Feedback,
    Order,
    Outcome,
    action_name,
)
from sfglab.spatial.scene.objects import AgentObject

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.spatial.scene.tree import Scene


class ExecuteOptions(TypedDict, total=False):
    """How a trajectory is sent."""

    action: str  #: The action's name; ``/global/<agent>/execute_trajectory`` where it is not given.
    #: How orders are said in its type; `FOLLOW_TRAJECTORY` where it is not given.
    dialect: ActionDialect
    on_feedback: Callable[[Feedback], None]  #: Called with what the server says on the way.
    timeout_s: float  #: For finding the server, and again for its answer, in seconds (5).


class Execution:
    """One trajectory on its way; `send` makes it and sends it off.

    Raises:
        FqnError: No action is given, and it is not the name of an agent.
        BusTimeoutError: By what needs a server, or asks it: there is none, or it does not answer.
        ActionServerGoneError: By waiting for the end: the server went away before that.
    """

    def __init__(self, node: Node, agent: str, **options: Unpack[ExecuteOptions]) -> None:
        #: What the server said last; None before it said anything.
        self.latest: Feedback | None = None
        self._dialect = options.get("dialect", FOLLOW_TRAJECTORY)
        self._on_feedback = options.get("on_feedback")
        self._timeout_s = options.get("timeout_s", 5.0)
        name = options.get("action") or action_name(agent)
        self._client = node.create_action_client(self._dialect.type, name)
        self._handle: ClientGoalHandle | None = None
        self._answered = asyncio.Event()
        self._answered.set()  # nothing is asked yet

    async def ready(self) -> None:
        """Return once there is a server, so that what is sent now arrives at once."""
        await self._client.wait_for_server(self._timeout_s)

    async def begin(self, order: Order) -> None:
        """Send an order, once, and return when the server has answered."""
        goal = self._dialect.goal(order)
        self._answered.clear()
        try:
            with contextlib.suppress(GoalRejectedError):
                self._handle = await self._client.send_goal(goal, self._heard, self._timeout_s)
        finally:
            self._answered.set()

    async def result(self) -> Ended:
        """Return how it ended, waiting for the end."""
        if self._handle is None:
            return Ended(outcome=Outcome.REJECTED, text=OUTCOMES[Outcome.REJECTED].meaning)
        return self._dialect.result(await self._handle.result())

    async def cancel(self) -> None:
        """Ask the agent to stop; `result` then says when it stands. Once it ended, nothing happens.

        An agent may move before its answer is here: what is being sent is cancelled as soon as it is.
        """
        await self._answered.wait()
        if self._handle is not None:
            await self._handle.cancel_goal(self._timeout_s)

    def close(self) -> None:
        """Stop listening; the agent goes on."""
        self._client.close()

    def _heard(self, message: Any) -> None:
        self.latest = self._dialect.feedback(message)
        if self._on_feedback is not None:
            self._on_feedback(self.latest)


async def send(node: Node, order: Order, **options: Unpack[ExecuteOptions]) -> Execution:
    """Send an order and return once the server has answered; `Execution.close` ends it.

    Raises:
        BusTimeoutError: There is no server, or it does not answer.
    """
    execution = Execution(node, order.agent, **options)
    try:
        await execution.begin(order)
    except BaseException:
        execution.close()
        raise
    return execution


async def execute(node: Node, order: Order, **options: Unpack[ExecuteOptions]) -> Ended:
    """Send an agent along a trajectory; return how it ended, also where it was not taken.

    A task that awaits this and is cancelled cancels the goal, and ends only when the agent stands.

    ```python
    ended = await execute(node, Order(agent="go2", trajectory=trajectory), on_feedback=print)
    ```

    Raises:
        BusTimeoutError: There is no server, or it does not answer.
        ActionServerGoneError: It went away before the end.
    """
    execution = Execution(node, order.agent, **options)
    begun = asyncio.ensure_future(execution.begin(order))
    try:
        await asyncio.shield(begun)
        return await execution.result()
    except asyncio.CancelledError:
        with contextlib.suppress(BusError):  # a server that is gone moves nobody for us
            await begun
            await execution.cancel()
            await execution.result()
        raise
    finally:
        execution.close()


def scene_orders(
    scene: Scene, *, agents: tuple[str, ...] = (), start_ns: int = 0
) -> tuple[Order, ...]:
    """Return what a scene asks of its agents, the named ones or all that drive a trajectory.

    All share the time 0, `start_ns` in ns since the epoch; 0: when each server takes its order.

    Raises:
        InvalidValueError: There is no such agent, several have this name, or it has no trajectory.
    """
    found: dict[str, list[Order]] = {}
    for agent in scene.all_of(AgentObject):
        driven = scene.driven_by(agent.id)
        trajectory = None if driven is None else scene.world_trajectory(driven.id)
        if trajectory is not None:
            order = Order(
                agent=agent.name, trajectory=trajectory, frame_id=scene.frame_id, start_ns=start_ns
            )
            found.setdefault(agent.name, []).append(order)
    for name in agents or found:
        if len(found.get(name, ())) != 1:
            known = ", ".join(n for n, orders in found.items() if len(orders) == 1)
            allowed = (
                f"one that alone has this name and drives a trajectory: {known or 'there is none'}"
            )
            raise InvalidValueError("agent", name, allowed)
    return tuple(found[name][0] for name in agents or found)
