"""Client of an action: sends goals, receives their feedback, and fetches their results.

A wait ends when the goal ends, when its server disappears, or after a timeout.
"""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.bus.actions import goals
from sfglab.bus.actions.goals import KEPT_GOALS, CancelCode, GoalStatus
from sfglab.bus.errors import (
    BusError,
    GoalRejectedError,
    discovery_timeout_error,
)
from sfglab.bus.pubsub import Subscription, checked_type, topic_endpoint
from sfglab.bus.service import Client
from sfglab.component import end_tasks
from sfglab.messages import action_type, service_type, type_name

if TYPE_CHECKING:
    from sfglab.bus.backend import Backend

FeedbackCallback = Callable[[Any], Awaitable[None] | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalResult:
    """Status and result of an ended goal."""

    status: GoalStatus  #: SUCCEEDED, CANCELED or ABORTED.
    result: Any  #: Result message.


class ClientGoalHandle:
    """Handle of an accepted goal at the client that sent it; made by `ActionClient.send_goal`."""

    def __init__(self, client: ActionClient, goal_id: bytes) -> None:
        self.goal_id = goal_id  #: Id of the goal, 16 bytes.
        self._client = client
        self._ended: GoalResult | None = None

    async def result(self) -> GoalResult:
        """Wait for the goal's end as long as there is a server; return its result, also repeatedly.

        A result that was received is returned also without a server.

        Raises:
            BusError: The server disappeared, or has forgotten the goal. After a disappearance a later call may
                find it again.
        """
        if self._ended is None:
            self._ended = await self._client.result_of(self.goal_id)
        return self._ended

    async def cancel_goal(self, timeout_s: float = 5.0) -> CancelCode:
        """Request cancellation of the goal, and return the response: NONE means that the goal is CANCELING.

        Raises:
            BusTimeoutError: The server did not respond in time.
        """
        return await self._client.cancel(self.goal_id, timeout_s)


class ActionClient:
    """Client of an action; made by `Node.create_action_client`. Goals may run concurrently."""

    def __init__(self, backend: Backend, type_: str, *, name: str) -> None:
        action = action_type(type_)
        topics = goals.action_topics(name)
        self.action_name = name  #: Fully resolved ROS action.
        self._backend = backend
        self._action = action
        self._calls = backend.calls(f"action client {name!r}")
        self._callbacks: dict[bytes, FeedbackCallback] = {}
        # The feedback subscription is created first because discovery announces readers to a server in order.
        # The server responds only to a client whose reply reader it has discovered, and begins the goal after
        # that. By then it has also discovered the feedback reader.
        endpoint = topic_endpoint(action.feedback_message, topics["feedback"], goals.FEEDBACK_QOS)
        self._feedback = Subscription(backend, endpoint, self._on_feedback, raw=False)
        self._cancel = Client(backend, goals.CANCEL_GOAL, name=topics["cancel_goal"])
        self._result = Client(backend, action.get_result.name, name=topics["get_result"])
        self._send = Client(backend, action.send_goal.name, name=topics["send_goal"])

    async def wait_for_server(self, timeout_s: float = 5.0) -> None:
        """Return once a server is ready.

        Raises:
            BusTimeoutError: No server was ready within `timeout_s`.
        """
        try:
            async with asyncio.timeout(timeout_s):
                for service in (self._cancel, self._result, self._send):
                    await service.wait_for_service(timeout_s)
                await self._feedback.wait_for_publishers(timeout_s=timeout_s)
        except TimeoutError as error:
            what = f"action {self.action_name!r}: a server"
            raise discovery_timeout_error(what, timeout_s) from error

    async def send_goal(
        self, goal: Any, feedback_callback: FeedbackCallback | None = None, timeout_s: float = 5.0
    ) -> ClientGoalHandle:
        """Send a goal and return its handle once a server, found within the time-out, has accepted it.

        The callback, plain or async, receives each feedback message. Only the newest 100 goals have a callback.

        Raises:
            GoalRejectedError: The server rejected the goal.
            BusTimeoutError: No server was found, or it did not respond in time. The goal may run nevertheless.
            InvalidMessageError: The goal has another type.
        """
        checked_type(goal, type_=type_name(self._action.goal), where=self.action_name)
        await self.wait_for_server(timeout_s)
        goal_id = uuid.UUID(bytes=self._backend.random_bytes(16), version=4).bytes
        if feedback_callback is not None:
            self._callbacks[goal_id] = feedback_callback
        if len(self._callbacks) > KEPT_GOALS:
            del self._callbacks[next(iter(self._callbacks))]
        request = self._action.send_goal.request(goal_id=goals.uuid_message(goal_id), goal=goal)
        response = await self._send.call(request, timeout_s)
        if not response.accepted:
            self._callbacks.pop(goal_id, None)
            why = "the server rejected the goal; its log has the reason"
            raise GoalRejectedError(f"action {self.action_name!r}: {why}")
        return ClientGoalHandle(self, goal_id)

    async def cancel(self, goal_id: bytes, timeout_s: float = 5.0) -> CancelCode:
        """Request cancellation of a goal of any client, given by its 16-byte id, and return the response.

        Raises:
            BusTimeoutError: The server did not respond within `timeout_s`, seconds.
        """
        request = service_type(goals.CANCEL_GOAL).request(goal_info=goals.goal_info(goal_id))
        response = await self._cancel.call(request, timeout_s)
        return CancelCode(response.return_code)

    async def result_of(self, goal_id: bytes) -> GoalResult:
        """Wait for the end of a goal of any client, given by its 16-byte id, and return its result.

        Raises:
            BusError: The server disappeared, there is none, or it does not know the goal.
        """
        request = self._action.get_result.request(goal_id=goals.uuid_message(goal_id))
        response = await self._unless_gone(goal_id, self._result.call(request, None))
        status = GoalStatus(response.status)
        if status is GoalStatus.UNKNOWN:
            raise BusError(
                f"action {self.action_name!r}: goal {goal_id.hex()} is unknown to the server; "
                "it keeps only the newest results, so request a result soon after its goal"
            )
        return GoalResult(status=status, result=response.result)

    def close(self) -> None:
        """Close the client and end its pending calls; its goals go on. Repeated calls are harmless."""
        for end in (self._send, self._result, self._cancel, self._feedback):
            end.close()

    def _on_feedback(self, message: Any) -> None:
        """Pass feedback to the callback of its goal; feedback on goals of other clients is ignored."""
        callback = self._callbacks.get(goals.goal_id_from(message.goal_id))
        if callback is not None:
            self._calls.run(callback, message.feedback)

    async def _unless_gone(self, goal_id: bytes, what: Coroutine[Any, Any, Any]) -> Any:
        """Return the result of a coroutine about a goal, unless the server disappears before.

        Raises:
            BusError: The server disappeared, or there was none.
        """
        tasks = asyncio.create_task(what), asyncio.create_task(self._result.wait_until_gone())
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            if not tasks[0].done():
                goal = f"goal {goal_id.hex()} ended"
                raise BusError(
                    f"action {self.action_name!r}: the server disappeared before {goal}; send it again"
                )
            return tasks[0].result()
        finally:
            await end_tasks(*tasks)
