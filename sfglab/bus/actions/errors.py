"""What can go wrong with goals, each with the data that a caller needs to react."""

from __future__ import annotations

from sfglab.bus.errors import BusError


class GoalRejectedError(BusError, RuntimeError):
    """A server does not take a goal.

    Attributes:
        action: The ROS action.
    """

    def __init__(self, action: str) -> None:
        self.action = action
        super().__init__(f"action {action!r}: the server rejected the goal, for reasons of its own")


class ActionServerGoneError(BusError, ConnectionError):
    """A server went away while something was expected from it.

    Attributes:
        action: The ROS action.
        goal_id: The goal's 16 bytes.
    """

    def __init__(self, action: str, goal_id: bytes) -> None:
        self.action = action
        self.goal_id = goal_id
        super().__init__(f"action {action!r}: the server has gone with goal {goal_id.hex()} unfinished here")


class UnknownGoalError(BusError, LookupError):
    """A server knows no such goal: it never accepted it, or has forgotten it after its result timeout.

    Attributes:
        action: The ROS action.
        goal_id: The goal's 16 bytes.
    """

    def __init__(self, action: str, goal_id: bytes) -> None:
        self.action = action
        self.goal_id = goal_id
        super().__init__(
            f"action {action!r}: goal {goal_id.hex()} is unknown to the server; "
            "it forgets goals once they have been over for its result timeout"
        )


class GoalTransitionError(BusError, RuntimeError):
    """Something that a goal's status does not allow.

    Attributes:
        goal_id: The goal's 16 bytes.
        status: The goal's status.
        event: What was to happen.
    """

    def __init__(self, goal_id: bytes, *, status: str, event: str, allowed: tuple[str, ...]) -> None:
        self.goal_id = goal_id
        self.status = status
        self.event = event
        choice = f"allowed are {', '.join(allowed)}" if allowed else "nothing is allowed any more"
        super().__init__(f"goal {goal_id.hex()} is {status}: given {event}, {choice}")
