"""`.action` texts: three parts, and the messages that carry them to and fro.

Pure text in, pure text out. Refuses to know which types exist.
"""

from __future__ import annotations

import re

from sfglab.errors import SfglabError

_ACTION_RULE = re.compile(r"^---[ \t]*$", re.MULTILINE)
_ACTION_PARTS = ("Goal", "Result", "Feedback")
_GOAL_ID = "unique_identifier_msgs/UUID goal_id\n"
_ACTION_WRAPPERS = {
    "SendGoal_Request": _GOAL_ID + "{name}_Goal goal\n",
    "SendGoal_Response": "bool accepted\nbuiltin_interfaces/Time stamp\n",
    "GetResult_Request": _GOAL_ID,
    "GetResult_Response": "int8 status\n{name}_Result result\n",
    "FeedbackMessage": _GOAL_ID + "{name}_Feedback feedback\n",
}


class ActionTextError(SfglabError, ValueError):
    """A text that does not define an action.

    Attributes:
        name: The action's name.
        parts: How many parts the text has.
    """

    def __init__(self, name: str, *, parts: int) -> None:
        self.name = name
        self.parts = parts
        super().__init__(f"action {name!r}: given {parts} part(s), allowed are 3 with lines of `---` between")


def action_texts(name: str, text: str) -> dict[str, str]:
    """Return the message texts of an action: its three parts, and what carries them to and fro.

    Args:
        name: The full name, such as `pkg/action/Name`.
        text: The `.action` text: goal, result and feedback with lines of three dashes between them.

    Returns:
        By full name, in an order in which each needs only those before; the wrappers are those of the ROS 2
        design (design.ros2.org, "Actions") as rosidl_parser adds them.

    Raises:
        ActionTextError: It has another number of parts.
    """
    parts = _ACTION_RULE.split(text)
    if len(parts) != len(_ACTION_PARTS):
        raise ActionTextError(name, parts=len(parts))
    texts = {f"{name}_{kind}": part.strip("\n") for kind, part in zip(_ACTION_PARTS, parts, strict=True)}
    return texts | {f"{name}_{kind}": wrapper.format(name=name) for kind, wrapper in _ACTION_WRAPPERS.items()}
