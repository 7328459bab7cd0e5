"""Server of an action: responds to requests, runs goals, and publishes their feedback and statuses."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.bus.actions import goals
from sfglab.bus.actions.goals import (
    KEPT_GOALS,
    TERMINAL,
    TRANSITIONS,
    GoalEvent,
    GoalStatus,
    is_allowed,
)
from sfglab.bus.loop import awaited
from sfglab.bus.pubsub import Publisher, checked_type, topic_endpoint
from sfglab.bus.service import Service
from sfglab.machine import step
from sfglab.messages import (
    action_type,
    default_message,
    message_type,
    ns_from_stamp,
    service_type,
    stamp_from_ns,
    type_name,
)

if TYPE_CHECKING:
    from sfglab.bus.backend import Backend


class ServerGoalHandle:
    """Handle of an accepted goal at its server; given to the server's callbacks."""

    def __init__(
        self, server: ActionServer, goal_id: bytes, request: Any, accepted_ns: int
    ) -> None:
        self.goal_id = goal_id  #: Id of the goal, 16 bytes, chosen by the client.
        self.request = request  #: Goal message.
        #: Time of acceptance by the server's clock, Unix time, ns.
        self.accepted_ns = accepted_ns
        self.status = GoalStatus.ACCEPTED  #: State of the goal.
        #: Result of the goal; requests for the result wait for it.
        self.result: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        #: Task that executes the goal; None before its start.
        self.task: asyncio.Task[Any] | None = None
        self._server = server

    @property
    def is_active(self) -> bool:
        """Whether the goal has not ended."""
        return self.status not in TERMINAL

    @property
    def is_cancel_requested(self) -> bool:
        """Whether a cancel request was accepted and the goal has not ended."""
        return self.status is GoalStatus.CANCELING

    def publish_feedback(self, feedback: Any) -> None:
        """Publish feedback on the goal.

        Raises:
            InvalidMessageError: The message does not have the feedback type of the action.
        """
        self._server.publish_feedback(self.goal_id, feedback)

    def succeed(self) -> None:
        """End the goal as SUCCEEDED; the execute callback then returns the result.

        Raises:
            IllegalInputError: The goal has ended already.
        """
        self._server.apply(self, GoalEvent.SUCCEED)

    def abort(self) -> None:
        """End the goal as ABORTED; see `succeed`."""
        self._server.apply(self, GoalEvent.ABORT)

    def canceled(self) -> None:
        """End the goal as CANCELED, once a cancel request was accepted; see `succeed`."""
        self._server.apply(self, GoalEvent.CANCELED)


ExecuteCallback = Callable[[ServerGoalHandle], Any]


class ActionServer:
    """Server of an action; made by `Node.create_action_server`.

    All goals are accepted and run concurrently. The execute callback receives a `ServerGoalHandle`, ends the
    goal through it, and returns the result, None for zeros. It refuses a goal by aborting it, and watches
    `is_cancel_requested`. If the callback raises or does not end the goal, the goal is aborted. The results
    of the last 100 goals are kept.
    """

    def __init__(
        self, backend: Backend, type_: str, *, name: str, execute: ExecuteCallback
    ) -> None:
        action = action_type(type_)
        topics = goals.action_topics(name)
        self.action_name = name  #: Fully resolved ROS action.
        self._backend = backend
        self._action = action
        self._execute = execute
        self._closed = False
        self._calls = backend.calls(f"action server {action.name!r}")
        self._goals: dict[bytes, ServerGoalHandle] = {}
        self._ended: deque[bytes] = deque()
        endpoint = topic_endpoint(action.feedback_message, topics["feedback"], goals.FEEDBACK_QOS)
        self._feedback = Publisher(backend, endpoint)
        endpoint = topic_endpoint(goals.STATUS, topics["status"], goals.STATUS_QOS)
        self._status = Publisher(backend, endpoint)
        self._publish_status()  # an empty list shows that no goal runs
        service = partial(Service, backend)
        self._services = (
            service(goals.CANCEL_GOAL, name=topics["cancel_goal"], handler=self._on_cancel_goal),
            service(action.get_result.name, name=topics["get_result"], handler=self._on_get_result),
            service(
                action.send_goal.name,
                name=topics["send_goal"],
                handler=self._on_send_goal,
                answered=self._on_answered,
            ),
        )
        backend.register(self._abort)

    def apply(self, goal: ServerGoalHandle, event: GoalEvent) -> None:
        """Apply an event to a goal, and publish the statuses.

        Raises:
            IllegalInputError: The state of the goal does not allow the event.
        """
        goal.status = step(f"goal {goal.goal_id.hex()}", TRANSITIONS, goal.status, event)
        self._publish_status()

    def publish_feedback(self, goal_id: bytes, feedback: Any) -> None:
        """Publish feedback on a goal; without effect after the server's end."""
        where = self._feedback.topic_name
        checked_type(feedback, type_=type_name(self._action.feedback), where=where)
        if not self._closed:
            type_ = self._action.feedback_message
            self._feedback.publish(type_(goal_id=goals.uuid_message(goal_id), feedback=feedback))

    def close(self) -> None:
        """Abort running goals and close the server; repeated calls are harmless."""
        self._backend.end(self._abort)
        for end in (*self._services, self._feedback, self._status):
            end.close()

    def _abort(self) -> None:
        """Abort running goals; subscribers of the status are notified, unless the node closes."""
        if self._backend.loop.is_closed():
            return
        self._closed = self._backend.closed
        for goal in self._goals.values():
            if is_allowed(goal.status, GoalEvent.ABORT):
                self.apply(goal, GoalEvent.ABORT)
            goal.result.cancel()
            if goal.task is not None:
                goal.task.cancel()
        self._closed = True

    def _on_send_goal(self, request: Any) -> Any:
        """Return the response that accepts a goal, or rejects one with the id of another."""
        goal_id = goals.goal_id_from(request.goal_id)
        is_new = goal_id not in self._goals
        stamp_ns = self._backend.clock.now_ns()
        if is_new:
            self._goals[goal_id] = ServerGoalHandle(self, goal_id, request.goal, stamp_ns)
            self._publish_status()
        return self._action.send_goal.response(accepted=is_new, stamp=stamp_from_ns(stamp_ns))

    def _on_answered(self, request: Any) -> None:
        """Start a goal after the response to its client; by then the feedback reader is discovered as well."""
        goal = self._goals.get(goals.goal_id_from(request.goal_id))
        if goal is None or goal.task is not None or self._closed:
            return
        # A goal that was canceled before its start is executed as well because its callback has to end it.
        if not goal.is_cancel_requested:
            self.apply(goal, GoalEvent.EXECUTE)
        goal.task = self._calls.spawn(self._run(goal))

    async def _on_get_result(self, request: Any) -> Any:
        """Return the result of a goal once it has ended; UNKNOWN and zeros for a goal that is not kept."""
        goal = self._goals.get(goals.goal_id_from(request.goal_id))
        response = self._action.get_result.response
        if goal is None:
            result = default_message(self._action.result)
            return response(status=int(GoalStatus.UNKNOWN), result=result)
        # Several requests may wait for the result. The shield prevents one that ends from ending it for the
        # others.
        result = await asyncio.shield(goal.result)
        return response(status=int(goal.status), result=result)

    def _on_cancel_goal(self, request: Any) -> Any:
        """Let each selected goal be CANCELING, and return these goals."""
        info = request.goal_info
        statuses = {goal_id: goal.status for goal_id, goal in self._goals.items()}
        goal_id, stamp_ns = goals.goal_id_from(info.goal_id), ns_from_stamp(info.stamp)
        code, selected = goals.to_cancel(statuses, goal_id, stamp_ns)
        infos = []
        for known in selected:
            goal = self._goals[known]
            self.apply(goal, GoalEvent.CANCEL_GOAL)
            infos.append(goals.goal_info(known, goal.accepted_ns))
        response = service_type(goals.CANCEL_GOAL).response
        return response(return_code=int(code), goals_canceling=infos)

    async def _run(self, goal: ServerGoalHandle) -> None:
        """Execute a goal to its end; the goal is aborted if the callback does not end it."""
        result = None
        try:
            result = await awaited(self._execute(goal))
            if result is not None:
                checked_type(result, type_=type_name(self._action.result), where=self._action.name)
        except Exception as error:  # noqa: BLE001 - reported; the client gets an aborted goal
            self._calls.report(error)
            result = None
        finally:
            if not self._closed:
                self._finish(goal, result)

    def _finish(self, goal: ServerGoalHandle, result: Any) -> None:
        if goal.is_active:
            self.apply(goal, GoalEvent.ABORT)
        goal.result.set_result(default_message(self._action.result) if result is None else result)
        self._ended.append(goal.goal_id)
        if len(self._ended) > KEPT_GOALS:
            del self._goals[self._ended.popleft()]

    def _publish_status(self) -> None:
        if self._closed:
            return
        type_ = message_type("action_msgs/msg/GoalStatus")
        listed = []
        for goal in self._goals.values():
            info = goals.goal_info(goal.goal_id, goal.accepted_ns)
            listed.append(type_(goal_info=info, status=int(goal.status)))
        self._status.publish(message_type(goals.STATUS)(status_list=listed))
