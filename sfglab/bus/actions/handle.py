"""A goal as its server's callbacks hold it, and what they may say to it.

Refuses to know who listens and how anything is sent.
"""

from __future__ import annotations

import asyncio
from enum import Enum
from typing import TYPE_CHECKING, Any

from sfglab.bus.actions.goals import TERMINAL, GoalEvent, GoalStatus

if TYPE_CHECKING:
    from sfglab.bus.actions.engine import Goals


class GoalResponse(Enum):
    """What a goal callback says."""

    ACCEPT = "accept"
    REJECT = "reject"


class CancelResponse(Enum):
    """What a cancel callback says."""

    ACCEPT = "accept"
    REJECT = "reject"


class Running:
    """One accepted goal: what its handle, its task and the requests for its result share."""

    def __init__(self, goal_id: bytes, request: Any, result: asyncio.Future[Any]) -> None:
        self.goal_id = goal_id
        self.request = request
        self.result = result
        self.status = GoalStatus.ACCEPTED
        self.canceling = asyncio.Event()
        self.task: asyncio.Task[Any] | None = None


class ServerGoalHandle:
    """One accepted goal, on its server; given to the server's callbacks."""

    def __init__(self, goals: Goals, running: Running) -> None:
        self._goals = goals
        self._running = running

    @property
    def goal_id(self) -> bytes:
        """The goal's 16 bytes, chosen by the client."""
        return self._running.goal_id

    @property
    def request(self) -> Any:
        """The goal message."""
        return self._running.request

    @property
    def status(self) -> GoalStatus:
        """Where the goal is in its life."""
        return self._running.status

    @property
    def is_active(self) -> bool:
        """Whether the goal has not ended."""
        return self.status not in TERMINAL

    @property
    def is_cancel_requested(self) -> bool:
        """Whether a request to cancel was accepted and the goal has not ended."""
        return self.status is GoalStatus.CANCELING

    async def cancel_requested(self) -> None:
        """Return once a request to cancel was accepted."""
        await self._running.canceling.wait()

    def execute(self) -> None:
        """Run the execute callback in a task of its own; only once, and only for who deferred it.

        Raises:
            GoalTransitionError: The goal is executed already.
        """
        # A goal that was canceled while it waited is executed too: its callback has to end it.
        if self._running.task is not None or not self.is_cancel_requested:
            self._goals.apply(self._running, GoalEvent.EXECUTE)
        self._running.task = self._goals.calls.spawn(self._goals.run(self._running))

    def publish_feedback(self, feedback: Any) -> None:
        """Tell everybody who listens how far the goal has come.

        Args:
            feedback: A message of the action's feedback type.

        Raises:
            WrongTypeError: It is of another type.
        """
        self._goals.publish_feedback(self.goal_id, feedback)

    def succeed(self) -> None:
        """End the goal as SUCCEEDED; the execute callback then returns the result.

        Raises:
            GoalTransitionError: The goal has ended already, or was not executed yet.
        """
        self._goals.apply(self._running, GoalEvent.SUCCEED)

    def abort(self) -> None:
        """End the goal as ABORTED; see `succeed`."""
        self._goals.apply(self._running, GoalEvent.ABORT)

    def canceled(self) -> None:
        """End the goal as CANCELED, once a request to cancel was accepted; see `succeed`."""
        self._goals.apply(self._running, GoalEvent.CANCELED)
