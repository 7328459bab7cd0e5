"""An action's server: answers requests, runs goals, and says what becomes of them.

Knows callbacks, tasks and what is sent when. Which status follows which is the table of `goals`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

from sfglab.bus.actions import goals
from sfglab.bus.actions.goals import (
    TERMINAL,
    CancelCode,
    GoalBook,
    GoalEvent,
    GoalStatus,
    is_allowed,
)
from sfglab.bus.loop import awaited
from sfglab.bus.pubsub import Publisher, checked_type, topic_endpoint
from sfglab.bus.service import Service
from sfglab.messages import (
    ActionType,
    action_type,
    default_message,
    service_type,
    stamp_from_ns,
    type_name,
)
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.bus.api import Transport
    from sfglab.bus.backend import Backend


class GoalResponse(Enum):
    """What a goal callback says."""

    ACCEPT = "accept"
    REJECT = "reject"


class CancelResponse(Enum):
    """What a cancel callback says."""

    ACCEPT = "accept"
    REJECT = "reject"


class ServerGoalHandle:
    """One accepted goal, on its server; given to the server's callbacks."""

    def __init__(
        self, goals: Goals, goal_id: bytes, request: Any, result: asyncio.Future[Any]
    ) -> None:
        self.goal_id = goal_id  #: The goal's 16 bytes, chosen by the client.
        self.request = request  #: The goal message.
        self.result = result  #: What requests for the result wait for.
        self.status = GoalStatus.ACCEPTED  #: Where the goal is in its life.
        self.task: asyncio.Task[Any] | None = None  #: Executes it.
        self._goals = goals

    @property
    def is_active(self) -> bool:
        """Whether the goal has not ended."""
        return self.status not in TERMINAL

    @property
    def is_cancel_requested(self) -> bool:
        """Whether a request to cancel was accepted and the goal has not ended."""
        return self.status is GoalStatus.CANCELING

    def execute(self) -> None:
        """Run the execute callback in a task of its own; only once, and only for who deferred it.

        Raises:
            IllegalInputError: The goal is executed already.
        """
        # A goal that was canceled while it waited is executed too: its callback has to end it.
        if self.task is not None or not self.is_cancel_requested:
            self._goals.apply(self, GoalEvent.EXECUTE)
        self.task = self._goals.calls.spawn(self._goals.run(self))

    def publish_feedback(self, feedback: Any) -> None:
        """Tell everybody who listens how far the goal has come.

        Raises:
            InvalidMessageError: The message is of another type than the action's feedback.
        """
        self._goals.publish_feedback(self.goal_id, feedback)

    def succeed(self) -> None:
        """End the goal as SUCCEEDED; the execute callback then returns the result.

        Raises:
            IllegalInputError: The goal has ended already, or was not executed yet.
        """
        self._goals.apply(self, GoalEvent.SUCCEED)

    def abort(self) -> None:
        """End the goal as ABORTED; see `succeed`."""
        self._goals.apply(self, GoalEvent.ABORT)

    def canceled(self) -> None:
        """End the goal as CANCELED, once a request to cancel was accepted; see `succeed`."""
        self._goals.apply(self, GoalEvent.CANCELED)


# rcl_action's default in Humble, 15 minutes; later releases have 10 s.
_RESULT_TIMEOUT_S = 900.0

GoalCallback = Callable[[Any], Awaitable[GoalResponse] | GoalResponse]
CancelCallback = Callable[[ServerGoalHandle], Awaitable[CancelResponse] | CancelResponse]
ExecuteCallback = Callable[[ServerGoalHandle], Any]


class ActionServerOptions(TypedDict, total=False):
    """What an action server can be told beside what it does."""

    #: Plain or async: given a goal message, says whether to take it (all).
    goal_callback: GoalCallback
    #: Given the handle of an accepted goal, to call its `execute` some time. The default does so at once, so
    #: goals run beside each other.
    handle_accepted_callback: Callable[[ServerGoalHandle], None]
    #: Plain or async: given a handle, says whether it may be canceled. The default, as rclpy's, refuses.
    cancel_callback: CancelCallback
    #: How long a goal and its result are remembered after its end, s (900).
    result_timeout_s: float
    transport: Transport  #: Of its services; see `Node.create_service` ("dds").


class Goals:
    """The goals of a server, and its answers to requests about them; apart so that it never holds the node."""

    def __init__(self, backend: Backend, action: ActionType, execute: ExecuteCallback) -> None:
        self.closed = False  #: Whether the server, or its node, has ended.
        self.calls = backend.calls(f"action server {action.name!r}")  #: Runs the user's callbacks.
        self._backend = backend
        self._action = action
        self._execute = execute
        self._running: dict[bytes, ServerGoalHandle] = {}
        self._waiting: dict[
            bytes, ServerGoalHandle
        ] = {}  # accepted, but their clients were not told yet

    def open(self, feedback: Publisher, status: Publisher, options: ActionServerOptions) -> None:
        """Begin to publish, with an empty list of goals for whoever wants to know that none runs."""
        timeout_s = options.get("result_timeout_s", _RESULT_TIMEOUT_S)
        self._options = options
        self._book = GoalBook(round(timeout_s * NS_PER_S))
        self._feedback = feedback
        self._status = status
        self._publish_status()

    def apply(self, goal: ServerGoalHandle, event: GoalEvent) -> None:
        """Let something happen to a goal, and tell all who listen to the status.

        Raises:
            IllegalInputError: It may not happen now.
        """
        goal.status = self._book.apply(goal.goal_id, event, self._steady_ns())
        self._publish_status()

    def publish_feedback(self, goal_id: bytes, feedback: Any) -> None:
        """Send a goal's feedback; nothing once the server has ended."""
        checked_type(
            feedback, type_=type_name(self._action.feedback), where=self._feedback.topic_name
        )
        if not self.closed:
            type_ = self._action.feedback_message
            self._feedback.publish(type_(goal_id=goals.uuid_message(goal_id), feedback=feedback))

    async def on_send_goal(self, request: Any) -> Any:
        """Return whether the goal of a request is taken."""
        self._expire()
        goal_id = goals.goal_id_from(request.goal_id)
        taken = goal_id not in self._book and await self._takes(request.goal)
        stamp_ns = self._backend.clock.now_ns()
        # Two requests with one id may both have passed the callback; the book accepts one.
        if accepted := taken and self._book.accept(goal_id, stamp_ns):
            result = self._backend.loop.create_future()
            self._running[goal_id] = ServerGoalHandle(self, goal_id, request.goal, result)
            self._waiting[goal_id] = self._running[goal_id]
            self._publish_status()
        return self._action.send_goal.response(accepted=accepted, stamp=stamp_from_ns(stamp_ns))

    def on_answered(self, request: Any) -> None:
        """Begin with a goal whose client was told; by then it is known to listen for feedback, too."""
        goal = self._waiting.pop(goals.goal_id_from(request.goal_id), None)
        if goal is not None and not self.closed:
            begin = self._options.get("handle_accepted_callback", ServerGoalHandle.execute)
            self.calls.run(begin, goal)

    async def on_get_result(self, request: Any) -> Any:
        """Return a goal's result once it has ended; UNKNOWN and zeros for a goal that is not remembered."""
        self._expire()
        goal = self._running.get(goals.goal_id_from(request.goal_id))
        response = self._action.get_result.response
        if goal is None:
            return response(
                status=int(GoalStatus.UNKNOWN), result=default_message(self._action.result)
            )
        # Shielded: several may wait for it, and one of them that ends must not end it for the others.
        result = await asyncio.shield(goal.result)
        return response(status=int(goal.status), result=result)

    async def on_cancel_goal(self, request: Any) -> Any:
        """Ask the user about each goal that a request is about, and return which go to CANCELING."""
        self._expire()
        plan = self._book.to_cancel(*goals.read_goal_info(request.goal_info))
        chosen = [self._running[goal_id] for goal_id in plan.goal_ids]
        canceling = {goal.goal_id for goal in chosen if await self._cancels(goal)}
        code = CancelCode.REJECTED if plan.goal_ids and not canceling else plan.code
        booked = [known for known in self._book.goals() if known.goal_id in canceling]
        infos = [goals.goal_info(known.goal_id, known.accepted_ns) for known in booked]
        return service_type(goals.CANCEL_GOAL).response(
            return_code=int(code), goals_canceling=infos
        )

    async def run(self, goal: ServerGoalHandle) -> None:
        """Execute a goal to its end; a callback that does not say how it ends has failed."""
        result = None
        try:
            result = await awaited(self._execute(goal))
            if result is not None:
                checked_type(result, type_=type_name(self._action.result), where=self._action.name)
        except Exception as error:  # noqa: BLE001 - reported; the client gets an aborted goal
            self.calls.report(error)
            result = None
        finally:
            if not self.closed:
                self._finish(goal, result)

    def close(self) -> None:
        """Abort what runs; whoever listens to the status hears of it, unless the node closes."""
        if self._backend.loop.is_closed():
            return
        self.closed = self._backend.closed
        for goal in self._running.values():
            if is_allowed(goal.status, GoalEvent.ABORT):
                self.apply(goal, GoalEvent.ABORT)
            goal.result.cancel()
            if goal.task is not None:
                goal.task.cancel()
        self.closed = True

    def _finish(self, goal: ServerGoalHandle, result: Any) -> None:
        if goal.status not in TERMINAL:
            self.apply(goal, GoalEvent.ABORT)
        goal.result.set_result(default_message(self._action.result) if result is None else result)

    async def _takes(self, goal: Any) -> bool:
        callback = self._options.get("goal_callback")
        return (
            callback is None
            or await self._asked(callback, goal, GoalResponse) is GoalResponse.ACCEPT
        )

    async def _cancels(self, goal: ServerGoalHandle) -> bool:
        callback = self._options.get("cancel_callback")
        if (
            callback is None
            or await self._asked(callback, goal, CancelResponse) is not CancelResponse.ACCEPT
        ):
            return False
        if not is_allowed(goal.status, GoalEvent.CANCEL_GOAL):
            return False  # it ended, or another request was faster, while the callback was asked
        self.apply(goal, GoalEvent.CANCEL_GOAL)
        return True

    async def _asked(
        self, callback: Callable[[Any], Any], about: Any, answers: type[Enum]
    ) -> Enum | None:
        """Return a callback's answer; None, which refuses, when it fails or gives another, both reported."""
        try:
            return answers(await awaited(callback(about)))
        except Exception as error:  # noqa: BLE001 - reported
            self.calls.report(error)
            return None

    def _expire(self) -> None:
        for goal_id in self._book.expire(self._steady_ns()):
            del self._running[goal_id]

    def _publish_status(self) -> None:
        if not self.closed:
            self._status.publish(goals.status_array(self._book.goals()))

    def _steady_ns(self) -> int:
        return round(self._backend.loop.time() * NS_PER_S)


class ActionServer:
    """An action's server; made by `Node.create_action_server`.

    Goals run beside each other. The execute callback is given a `ServerGoalHandle`, by which it says how the
    goal ends, and returns the result, None for zeros. When it raises, or says nothing, the goal is aborted.
    """

    def __init__(
        self,
        node: Any,
        backend: Backend,
        type_: str,
        *,
        name: str,
        execute: ExecuteCallback,
        **options: Unpack[ActionServerOptions],
    ) -> None:
        action, topics = action_type(type_), goals.action_topics(name)
        self.action_name = name  #: The fully resolved ROS action.
        self._backend = backend
        self._goals = Goals(backend, action, execute)
        # Without the node, as they are reachable from what its backend holds.
        told = topic_endpoint(action.feedback_message, topics.feedback, goals.FEEDBACK_QOS)
        feedback = Publisher(None, backend, told)
        status = Publisher(
            None, backend, topic_endpoint(goals.STATUS, topics.status, goals.STATUS_QOS)
        )
        self._goals.open(feedback, status, options)
        service = partial(Service, node, backend, transport=options.get("transport", "dds"))
        self._endpoints: tuple[Service | Publisher, ...] = (
            service(goals.CANCEL_GOAL, name=topics.cancel_goal, handler=self._goals.on_cancel_goal),
            service(
                action.get_result.name, name=topics.get_result, handler=self._goals.on_get_result
            ),
            service(
                action.send_goal.name,
                name=topics.send_goal,
                handler=self._goals.on_send_goal,
                answered=self._goals.on_answered,
            ),
            feedback,
            status,
        )
        backend.register(self._goals)

    @property
    def last_error(self) -> BaseException | None:
        """The latest exception of a callback, None if there was none."""
        return self._goals.calls.last_error

    def close(self) -> None:
        """Abort the goals that run and end the server; again is harmless."""
        if self._goals.closed:
            return
        self._backend.end(self._goals)
        for endpoint in self._endpoints:
            endpoint.close()
