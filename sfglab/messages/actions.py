"""Actions as types: goal, result and feedback, and the services and messages that carry them.

Knows which types make an action (design.ros2.org, "Actions"). Refuses to know goals that run.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.messages.action_text import action_texts
from sfglab.messages.store import (
    UnknownTypeError,
    message_type,
    message_types,
    register,
    service_type,
)

if TYPE_CHECKING:
    from sfglab.messages.store import ServiceType


_MARK = "_FeedbackMessage"


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionType:
    """An action as message types, all dataclasses with `__msgtype__`."""

    name: str  #: Such as `sfglab_interfaces/action/FollowTrajectory`.
    goal: type[Any]  #: What is to be done.
    result: type[Any]  #: What came of it.
    feedback: type[Any]  #: How far it has come.
    send_goal: ServiceType  #: The service that asks for a goal.
    get_result: ServiceType  #: The service that waits for its result.
    feedback_message: type[Any]  #: What is published: a goal's id and its feedback.


def action_type(name: str) -> ActionType:
    """Return an action type by its full name.

    Args:
        name: `package/action/Name`.

    Raises:
        UnknownTypeError: There is no such action; the message lists similar names.
    """
    types = message_types()
    if f"{name}{_MARK}" not in types:
        actions = [n.removesuffix(_MARK) for n in types if "/action/" in n and n.endswith(_MARK)]
        raise UnknownTypeError(name, near=tuple(difflib.get_close_matches(str(name), actions, n=3)))
    return ActionType(
        name=name,
        goal=message_type(f"{name}_Goal"),
        result=message_type(f"{name}_Result"),
        feedback=message_type(f"{name}_Feedback"),
        send_goal=service_type(f"{name}_SendGoal"),
        get_result=service_type(f"{name}_GetResult"),
        feedback_message=message_type(f"{name}{_MARK}"),
    )


def register_action(name: str, text: str) -> ActionType:
    """Add an action to the store, or return it if it is there already.

    Args:
        name: `package/action/Name`.
        text: The content of its `.action` file; the types that it uses must be in the store.

    Returns:
        The action's types.

    Raises:
        ActionTextError: The text has not three parts.
        TypeConflictError: The name belongs to an action with other fields.
    """
    for part, definition in action_texts(name, text).items():
        register(part, definition)
    return action_type(name)
