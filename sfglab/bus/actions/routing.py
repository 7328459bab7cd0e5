"""What a client knows of the goals that it sent, and how news find the goal they are about.

It is apart from `ActionClient` because what DDS calls must never hold the node.
"""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.bus.actions.goals import TERMINAL, CancelCode, GoalStatus
from sfglab.bus.actions.wire import goal_id_from, read_statuses
from sfglab.bus.bridge import Signal

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Awaitable, Callable

    from sfglab.bus.calls import Calls

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


@dataclass(frozen=True, slots=True, kw_only=True)
class CancelReply:
    """What came of a request to cancel."""

    code: CancelCode  #: NONE when goals are being canceled, or there was none to cancel; else why not.
    goal_ids: tuple[bytes, ...] = ()  #: The goals that are being canceled.


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
    """Gives statuses and feedback to the goals they are about; never holds the node."""

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
        sent = self.sent.get(goal_id_from(message.goal_id))
        if sent is None:
            return
        sent.feedback.append(message.feedback)
        sent.changed.notify()
        if sent.callback is not None:
            self._calls.run(sent.callback, message.feedback)

    def on_status(self, message: Any) -> None:
        """Give statuses to their goals."""
        for goal_id, status in read_statuses(message).items():
            self.note(goal_id, status)

    def note(self, goal_id: bytes, status: GoalStatus) -> None:
        """Take note of a status; one that is older than what is known of an ended goal changes nothing."""
        sent = self.sent.get(goal_id)
        if sent is None or sent.status in TERMINAL:
            return
        sent.status = status
        sent.changed.notify()
