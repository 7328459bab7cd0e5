"""An action's client: asks for goals, listens to what becomes of them, and fetches their results.

Whoever waits is woken by the goal's end, its server's end, or a timeout of one's own.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import uuid
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.bus.actions import goals
from sfglab.bus.actions.goals import NO_GOAL_ID, TERMINAL, CancelCode, Canceling, GoalStatus
from sfglab.bus.errors import (
    ActionServerGoneError,
    BusError,
    GoalRejectedError,
    discovery_timeout_error,
)
from sfglab.bus.loop import Calls, Signal
from sfglab.bus.pubsub import Subscription, checked_type
from sfglab.component import end_tasks
from sfglab.messages import action_type, ns_from_stamp, service_type, type_name

if TYPE_CHECKING:
    from sfglab.bus.api import Transport
    from sfglab.bus.backend import Backend
    from sfglab.bus.service import Client

FeedbackCallback = Callable[[Any], Awaitable[None] | None]

# What `feedback()` keeps of a goal until it is read.
_FEEDBACK_DEPTH = 100
# Of how many ended goals feedback that comes late is still taken.
_ENDED_DEPTH = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalResult:
    """How a goal ended."""

    status: GoalStatus  #: SUCCEEDED, CANCELED or ABORTED.
    result: Any  #: The result message.


class Sent:
    """What is known about one goal that was sent."""

    def __init__(self, loop: asyncio.AbstractEventLoop, callback: FeedbackCallback | None) -> None:
        self.status = GoalStatus.UNKNOWN
        self.feedback: deque[Any] = deque(maxlen=_FEEDBACK_DEPTH)
        self.callback = callback
        self.result: GoalResult | None = None
        self.ended = False  # all feedback is here
        self.changed = Signal(loop)


class Router:
    """Gives statuses and feedback to the goals they are about; apart so that it never holds the node."""

    def __init__(self, calls: Calls) -> None:
        self.closed = False
        self.sent: dict[bytes, Sent] = {}
        self._calls = calls

    def close(self) -> None:
        """End whoever reads feedback."""
        self.closed = True
        for sent in self.sent.values():
            sent.changed.notify()

    def open(self, goal_id: bytes, sent: Sent) -> None:
        """Begin to listen for a goal, and end it for those that ended long ago."""
        ended = [known for known, goal in self.sent.items() if goal.status in TERMINAL]
        for known in itertools.islice(ended, max(0, len(ended) - _ENDED_DEPTH)):
            del self.sent[known]
        self.sent[goal_id] = sent

    def on_feedback(self, message: Any) -> None:
        """Give feedback to its goal; what is about goals of other clients is ignored."""
        sent = self.sent.get(goals.goal_id_from(message.goal_id))
        if sent is None:
            return
        sent.feedback.append(message.feedback)
        sent.changed.notify()
        if sent.callback is not None:
            self._calls.run(sent.callback, message.feedback)

    def on_status(self, message: Any) -> None:
        """Give statuses to their goals."""
        for goal_id, status in goals.read_statuses(message).items():
            self.note(goal_id, status)

    def note(self, goal_id: bytes, status: GoalStatus) -> None:
        """Take note of a status; one that is older than what is known of an ended goal changes nothing."""
        sent = self.sent.get(goal_id)
        if sent is None or sent.status in TERMINAL:
            return
        sent.status = status
        sent.changed.notify()


class ClientGoalHandle:
    """One accepted goal, at the client that sent it; made by `ActionClient.send_goal`."""

    def __init__(self, client: ActionClient, goal_id: bytes, sent: Sent, accepted_ns: int) -> None:
        self.goal_id = goal_id  #: The goal's 16 bytes.
        #: When the server accepted it, by its clock (Unix time, nanoseconds).
        self.accepted_ns = accepted_ns
        self._client = client
        self._sent = sent

    @property
    def status(self) -> GoalStatus:
        """The latest status that is known here; ACCEPTED at least."""
        return max(self._sent.status, GoalStatus.ACCEPTED)

    async def feedback(self) -> AsyncIterator[Any]:
        """Yield the feedback until the goal or this client ends; of what waits to be read the newest 100.

        Raises:
            ActionServerGoneError: The server went away before the end.
        """
        sent = self._sent
        while True:
            while sent.feedback:
                yield sent.feedback.popleft()
            if sent.ended or self._client.closed:
                return
            if sent.status in TERMINAL:
                await self._settle()
            else:
                await self._client.unless_gone(
                    self.goal_id, sent.changed.wait_until(self._has_news, None)
                )

    def _has_news(self) -> bool:
        return bool(self._sent.feedback) or self._sent.status in TERMINAL or self._client.closed

    async def _settle(self) -> None:
        """Let feedback arrive that was sent before the reply, but on another topic; only repairs come later."""
        with contextlib.suppress(BusError):
            await self.result()
        self._sent.ended = True

    async def result(self, timeout_s: float | None = None) -> GoalResult:
        """Return how the goal ended, waiting for its end as long as there is a server; may be asked repeatedly.

        Raises:
            BusTimeoutError: The goal did not end in time.
            ActionServerGoneError: The server went away; asking again may find it back.
            BusError: The server has forgotten the goal.
        """
        if self._sent.result is None:
            self._sent.result = await self._client.result_of(self.goal_id, timeout_s)
        return self._sent.result

    async def cancel_goal(self, timeout_s: float = 5.0) -> CancelCode:
        """Ask the server to cancel the goal, and return what it says: NONE means that the goal is CANCELING.

        Raises:
            BusTimeoutError: No answer in time.
        """
        return (await self._client.cancel_goals(self.goal_id, timeout_s=timeout_s)).code


class ActionClient:
    """An action's client; made by `Node.create_action_client`. Goals may run beside each other."""

    def __init__(
        self, node: Any, backend: Backend, type_: str, *, name: str, transport: Transport
    ) -> None:
        action, topics = action_type(type_), goals.action_topics(name)
        self.action_name = name  #: The fully resolved ROS action.
        self._backend = backend
        self._action = action
        self._router = router = Router(backend.calls(f"action client {name!r}"))
        # In this order: discovery tells a server of readers one after another, and it answers only to whom it
        # knows to listen for the answer, and begins after that. So by then it knows who listens for feedback.
        self._topics: tuple[Subscription, ...] = (
            node.create_subscription(
                goals.STATUS, topics.status, router.on_status, goals.STATUS_QOS
            ),
            node.create_subscription(
                action.feedback_message, topics.feedback, router.on_feedback, goals.FEEDBACK_QOS
            ),
        )
        client = partial(node.create_client, transport=transport)
        self._cancel: Client = client(goals.CANCEL_GOAL, topics.cancel_goal)
        self._result: Client = client(action.get_result.name, topics.get_result)
        self._send: Client = client(action.send_goal.name, topics.send_goal)
        backend.register(router)

    @property
    def closed(self) -> bool:
        """Whether the client, or its node, has ended."""
        return self._router.closed

    async def wait_for_server(self, timeout_s: float = 5.0) -> None:
        """Return once a server is ready.

        Raises:
            BusTimeoutError: There was none within `timeout_s`.
        """
        try:
            async with asyncio.timeout(timeout_s):
                for service in (self._cancel, self._result, self._send):
                    await service.wait_for_service(timeout_s)
                for topic in self._topics:
                    await topic.wait_for_publishers(timeout_s=timeout_s)
        except TimeoutError as error:
            raise discovery_timeout_error(
                f"action {self.action_name!r}: a server", timeout_s
            ) from error

    async def send_goal(
        self, goal: Any, feedback_callback: FeedbackCallback | None = None, timeout_s: float = 5.0
    ) -> ClientGoalHandle:
        """Send a goal and return its handle once the server, to be found within the time-out, has accepted it.

        The callback, plain or async, is given each feedback message.

        Raises:
            GoalRejectedError: The server does not take it.
            BusTimeoutError: No server, or no answer in time; it may then run all the same, see `cancel_goals`.
            InvalidMessageError: The goal is of another type.
        """
        checked_type(goal, type_=type_name(self._action.goal), where=self.action_name)
        await self.wait_for_server(timeout_s)
        goal_id = uuid.UUID(bytes=self._backend.random_bytes(16), version=4).bytes
        sent = Sent(self._backend.loop, feedback_callback)
        self._router.open(goal_id, sent)
        response = None
        try:
            request = self._action.send_goal.request(goal_id=goals.uuid_message(goal_id), goal=goal)
            response = await self._send.call(request, timeout_s)
        finally:
            if response is None or not response.accepted:
                self._router.sent.pop(goal_id, None)
        if not response.accepted:
            why = "the server rejected the goal, for reasons of its own"
            raise GoalRejectedError(f"action {self.action_name!r}: {why}")
        return ClientGoalHandle(self, goal_id, sent, ns_from_stamp(response.stamp))

    async def cancel_goals(
        self, goal_id: bytes = NO_GOAL_ID, *, until_ns: int = 0, timeout_s: float = 5.0
    ) -> Canceling:
        """Ask the server to cancel goals, whoever sent them.

        Args:
            goal_id: One goal; `NO_GOAL_ID`: none in particular. Without id and time, all goals.
            until_ns: All goals that were accepted until then, by the server's clock (Unix time, ns); 0: none.
            timeout_s: How long to wait for the answer, in seconds.

        Raises:
            BusTimeoutError: No answer in time.
        """
        request = service_type(goals.CANCEL_GOAL).request(
            goal_info=goals.goal_info(goal_id, until_ns)
        )
        response = await self._cancel.call(request, timeout_s)
        ids = tuple(goals.read_goal_info(info)[0] for info in response.goals_canceling)
        return Canceling(code=CancelCode(response.return_code), goal_ids=ids)

    async def result_of(self, goal_id: bytes, timeout_s: float | None = None) -> GoalResult:
        """Return how a goal ended, whoever sent it; see `ClientGoalHandle.result`."""
        request = self._action.get_result.request(goal_id=goals.uuid_message(goal_id))
        response = await self.unless_gone(goal_id, self._result.call(request, timeout_s))
        status = GoalStatus(response.status)
        if status is GoalStatus.UNKNOWN:
            raise BusError(
                f"action {self.action_name!r}: goal {goal_id.hex()} is unknown to the server; "
                "it forgets goals once they have been over for its result timeout"
            )
        self._router.note(goal_id, status)
        return GoalResult(status=status, result=response.result)

    async def unless_gone(self, goal_id: bytes, what: Coroutine[Any, Any, Any]) -> Any:
        """Return what a coroutine about a goal returns, unless the server goes away before that.

        Raises:
            ActionServerGoneError: It did, or there was none.
        """
        tasks = asyncio.create_task(what), asyncio.create_task(self._result.wait_until_gone())
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            if not tasks[0].done():
                goal = f"goal {goal_id.hex()} unfinished here"
                raise ActionServerGoneError(
                    f"action {self.action_name!r}: the server has gone with {goal}"
                )
            return tasks[0].result()
        finally:
            await end_tasks(*tasks)

    def close(self) -> None:
        """End the client and its pending calls; its goals go on. Again is harmless."""
        if self.closed:
            return
        self._backend.end(self._router)
        for client in (self._send, self._result, self._cancel):
            client.close()
        for topic in self._topics:
            topic.close()
