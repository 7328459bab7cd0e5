"""Sending of trajectories to agents: goal, feedback, result, and a cancellation that waits until the agent stands."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Any

from sfglab.bus import ClientGoalHandle, GoalRejectedError, Node
from sfglab.errors import InvalidValueError
from sfglab.spatial.execution.orders import (
    FOLLOW_TRAJECTORY,
    Ended,
    Feedback,
    Order,
    Outcome,
    action_name,
    ended_of,
    feedback_of,
    goal_message,
)
from sfglab.spatial.scene.model import TrajectoryObject

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.spatial.scene.tree import Scene


class Execution:
    """Execution of one trajectory by an agent: `begin` sends the order, `result` waits for the end.

    ```python
    execution = Execution(node, "go2", on_feedback=print)
    await execution.begin(Order(agent="go2", trajectory=trajectory))
    ended = await execution.result()
    ```

    Args:
        node: Node of the client.
        agent: Name of the agent.
        action: Name of the action; by default ``/global/<agent>/execute_trajectory``.
        on_feedback: Called with each feedback.
        timeout_s: Timeout for finding the server, and for its response, s.

    Raises:
        FqnError: No action is given, and the name is not allowed for an agent.
        BusTimeoutError: A method needs a server, and there is none, or it does not respond.
        BusError: The server disappeared before the end.
    """

    def __init__(
        self,
        node: Node,
        agent: str,
        *,
        action: str = "",
        on_feedback: Callable[[Feedback], None] | None = None,
        timeout_s: float = 5.0,
    ) -> None:
        self._on_feedback = on_feedback
        self._timeout_s = timeout_s
        name = action or action_name(agent)
        self._client = node.create_action_client(FOLLOW_TRAJECTORY, name)
        self._handle: ClientGoalHandle | None = None
        self._answered = asyncio.Event()
        self._answered.set()  # no goal was sent yet

    async def ready(self) -> None:
        """Return once a server is discovered, so that a goal arrives without delay."""
        await self._client.wait_for_server(self._timeout_s)

    async def begin(self, order: Order) -> None:
        """Send an order, once, and return when the server has responded."""
        goal = goal_message(order)
        self._answered.clear()
        try:
            with contextlib.suppress(GoalRejectedError):
                self._handle = await self._client.send_goal(goal, self._received, self._timeout_s)
        finally:
            self._answered.set()

    async def result(self) -> Ended:
        """Wait for the end and return it."""
        if self._handle is None:
            return Ended(outcome=Outcome.REJECTED, text=Outcome.REJECTED.meaning)
        return ended_of(await self._handle.result())

    async def cancel(self) -> None:
        """Stop the agent; `result` then returns when the agent stands. The method has no effect after the end.

        The agent may move before its response to a new goal arrives. Such a goal is cancelled when the response
        arrives.
        """
        await self._answered.wait()
        if self._handle is not None:
            await self._handle.cancel_goal(self._timeout_s)

    def close(self) -> None:
        """Close the client; the agent continues its trajectory."""
        self._client.close()

    def _received(self, message: Any) -> None:
        if self._on_feedback is not None:
            self._on_feedback(feedback_of(message))


def scene_orders(
    scene: Scene, *, agents: tuple[str, ...] = (), start_ns: int = 0
) -> tuple[Order, ...]:
    """Return the orders of a scene to the named agents, by default to all that follow a trajectory.

    All orders have the same time 0: `start_ns`, as Unix time in ns. With 0, each trajectory begins when its server
    accepts the goal.

    Raises:
        InvalidValueError: There is no such agent, several have this name, or it has no trajectory.
    """
    orders = []
    for driven in scene.all_of(TrajectoryObject):
        order = trajectory_order(scene, driven.id, start_ns=start_ns)
        if order is not None:
            orders.append(order)
    names = [order.agent for order in orders]
    known = [name for name in names if names.count(name) == 1]
    for name in agents or names:
        if name not in known:
            own = ", ".join(known) or "none"
            allowed = f"an agent with a trajectory and a name of its own: {own}"
            raise InvalidValueError("agent", name, allowed)
    return tuple(orders[names.index(name)] for name in agents or names)


def trajectory_order(scene: Scene, trajectory: int, *, start_ns: int = 0) -> Order | None:
    """Return the order of one trajectory to its agent; None if it has no agent or no waypoint."""
    agent = scene.of_kind(trajectory, TrajectoryObject).agent
    path = scene.world_trajectory(trajectory)
    if agent is None or path is None:
        return None
    name = scene.get(agent).name
    return Order(agent=name, trajectory=path, frame_id=scene.frame_id, start_ns=start_ns)
