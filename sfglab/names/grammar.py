"""The grammar of ROS 2 names: characters, length, and how relative names become absolute.

Knows the rules of the ROS 2 design article "Topic and Service Names" (design.ros2.org), the length limits of
rmw and RTPS, and the error that every module of `sfglab.names` raises. Refuses to know the schema of paper A.
"""

from __future__ import annotations

import re
from enum import Enum

from sfglab.errors import InvalidValueError

TF = "/tf"
"""The transform topic: routed by Table 1 of paper A, but outside the schema."""

TF_STATIC = "/tf_static"
"""The static transform topic: routed by Table 1 of paper A, but outside the schema."""

# rmw/validate_full_topic_name.h, RMW_TOPIC_MAX_NAME_LENGTH = 255 - 8, counted with the leading slash.
_RMW_MAX_LENGTH = 247
# RTPS 2.5, clause 9.6.3: a topic name is string<256> including its terminator.
_DDS_MAX_LENGTH = 255
_SERVICE_MANGLING = len("rq") + len("Request")
_LONGEST_ACTION_TAIL = len("/_action/cancel_goal")

_NAME = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")
_TOKEN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_WORDS = re.compile(r"[A-Za-z][A-Za-z0-9]*(?:_[A-Za-z0-9]+)*")
_NAME_RULE = (
    "an absolute name such as '/chatter': each part behind a '/' of ASCII letters, digits and single "
    "underscores, not starting with a digit"
)
_WORDS_RULE = (
    "ASCII letters and digits in words joined by single underscores, starting with a letter "
    "(a leading underscore marks ROS 2's own hidden names)"
)


class FqnError(InvalidValueError):
    """A name, or one segment of it, that the rules do not allow.

    Its place is what is wrong: scope, agent, component, stream, resource, suffix, custom, namespace, node, or
    name for the whole.
    """


class ResourceKind(Enum):
    """What a ROS name denotes; topics, services and actions have separate name spaces."""

    TOPIC = "topic"
    SERVICE = "service"
    ACTION = "action"


_MAX_LENGTH = {
    ResourceKind.TOPIC: _RMW_MAX_LENGTH,
    ResourceKind.SERVICE: _DDS_MAX_LENGTH - _SERVICE_MANGLING,
    ResourceKind.ACTION: _DDS_MAX_LENGTH - _SERVICE_MANGLING - _LONGEST_ACTION_TAIL,
}


def max_name_length(kind: ResourceKind) -> int:
    """Return the longest allowed ROS name in characters, leading slash included.

    247 for topics (rmw), 246 for services and 226 for actions: rmw reserves 8 characters for prefixes, but
    `rq` and `Request` take 9, and an action appends `/_action/cancel_goal` before that.
    """
    return _MAX_LENGTH[kind]


def validate_ros_name(name: str, kind: ResourceKind = ResourceKind.TOPIC) -> str:
    """Return an absolute ROS name unchanged if it is valid.

    Follows the design article, which is stricter than rmw in one point: rmw tolerates repeated underscores.

    Args:
        name: Absolute name, for example `/tf` or `/local/go2/arm/_action/status`.
        kind: What the name denotes; it decides the length limit.

    Returns:
        The same name.

    Raises:
        FqnError: With segment `name`.
    """
    if not _NAME.fullmatch(name) or "__" in name:
        raise FqnError("name", name, _NAME_RULE)
    limit = max_name_length(kind)
    if len(name) > limit:
        raise FqnError("name", name, f"at most {limit} characters for a {kind.value}, this has {len(name)}")
    return name


def is_wire_ros_name(name: str) -> bool:
    """Tell whether any ROS 2 node could have made this absolute name.

    As lenient as rmw (`rmw_validate_full_topic_name`), length apart, because the other end was not our code.
    """
    return _NAME.fullmatch(name) is not None


def resolve(name: str, namespace: str = "/", *, node_name: str) -> str:
    """Return the absolute form of a name as a node sees it, like `Node.resolve_topic_name` of rclpy.

    `/x` stays, `x` becomes `<namespace>/x`, `~/x` becomes `<namespace>/<node>/x`. Substitutions such as
    `{node}` and remapping rules are not supported.

    Args:
        name: Absolute, relative or private name.
        namespace: The node's namespace; like rclpy, `""` is the root and a missing first slash is added.
        node_name: The node's name without namespace.

    Returns:
        The absolute name, within the limits of a topic; services and actions have less room.

    Raises:
        FqnError: With segment `namespace`, `node` or `name`.
    """
    root = "" if namespace in ("", "/") else "/" + namespace.removeprefix("/")
    if root and (not _NAME.fullmatch(root) or "__" in root):
        raise FqnError("namespace", namespace, f"'/' or {_NAME_RULE}")
    if not _TOKEN.fullmatch(node_name) or "__" in node_name:
        raise FqnError("node", node_name, "ASCII letters, digits and single underscores, no leading digit")
    if name.startswith("/"):
        return validate_ros_name(name)
    if name == "~" or name.startswith("~/"):
        return validate_ros_name(f"{root}/{node_name}{name[1:]}")
    if not _NAME.fullmatch(f"/{name}"):
        raise FqnError("name", name, f"'x', '~/x' or {_NAME_RULE}")
    return validate_ros_name(f"{root}/{name}")


def check_words(segment: str, text: str) -> str:
    """Return a schema segment's text unchanged if its characters are allowed, else raise `FqnError`."""
    if not _WORDS.fullmatch(text):
        raise FqnError(segment, text, _WORDS_RULE)
    return text
