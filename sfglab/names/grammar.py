"""Grammar of ROS 2 names: characters, length, resolution of relative names, and names on DDS.

Sources: design.ros2.org, "Topic and Service Names", "Topic and Service name mapping to DDS", "Actions";
length limits of rmw and RTPS. The module does not depend on the schema of paper A.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum
from itertools import chain

from sfglab.errors import InvalidValueError

TF = "/tf"  #: Transform topic: routed by Table 1 of paper A, but outside the schema.
#: Static transform topic: routed by Table 1 of paper A, but outside the schema.
TF_STATIC = "/tf_static"

# rmw/validate_full_topic_name.h, 255 - 8 with the leading slash; a namespace leaves room for 2 more.
_RMW_MAX_LENGTH = 247
# RTPS 2.5, clause 9.6.3: a topic name is string<256> including its terminator.
_DDS_MAX_LENGTH = 255
_SERVICE_MANGLING = len("rq") + len("Request")
_LONGEST_ACTION_TAIL = len("/_action/cancel_goal")

ROS_NAME = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")
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

    Its place is the wrong part: scope, agent, component, stream, resource, suffix, custom, namespace, node,
    or name for the whole.
    """


class ResourceKind(Enum):
    """Kind of a ROS name; topics, services and actions have separate name spaces."""

    TOPIC = "topic"
    SERVICE = "service"
    ACTION = "action"


MAX_NAME_LENGTH = {
    ResourceKind.TOPIC: _RMW_MAX_LENGTH,
    ResourceKind.SERVICE: _DDS_MAX_LENGTH - _SERVICE_MANGLING,
    ResourceKind.ACTION: _DDS_MAX_LENGTH - _SERVICE_MANGLING - _LONGEST_ACTION_TAIL,
}
"""Longest allowed ROS names: 247 characters for topics, 246 for services, 226 for actions.

rmw reserves 8 characters for prefixes. However, `rq` and `Request` take 9, and the names of actions get
a further part, of which the longest counts.
"""


def validate_ros_name(name: str, kind: ResourceKind = ResourceKind.TOPIC) -> str:
    """Return an absolute ROS name unchanged if it is valid; unlike in rmw, repeated underscores are invalid.

    Raises:
        FqnError: With segment `name`.
    """
    if not ROS_NAME.fullmatch(name) or "__" in name:
        raise FqnError("name", name, _NAME_RULE)
    limit = MAX_NAME_LENGTH[kind]
    if len(name) > limit:
        raise FqnError(
            "name", name, f"at most {limit} characters for a {kind.value}, this has {len(name)}"
        )
    return name


def is_wire_ros_name(name: str) -> bool:
    """Return whether a ROS 2 node could have made this absolute name (`rmw_validate_full_topic_name`)."""
    return ROS_NAME.fullmatch(name) is not None


def resolve(name: str, namespace: str = "/", *, node_name: str) -> str:
    """Return the absolute form of a name in a node, like `Node.resolve_topic_name` of rclpy.

    `/x` stays, `x` becomes `<namespace>/x`, `~/x` becomes `<namespace>/<node>/x`. There are no
    substitutions such as `{node}`. `""` is the root namespace, and a missing first slash is added. The
    limits are those of topics.

    Raises:
        FqnError: With segment `namespace`, `node` or `name`.
    """
    root = "" if namespace in ("", "/") else "/" + namespace.removeprefix("/")
    longest = _RMW_MAX_LENGTH - 2
    if root and (not ROS_NAME.fullmatch(root) or "__" in root or len(root) > longest):
        raise FqnError("namespace", namespace, f"'/' or {_NAME_RULE}; at most {longest} characters")
    if not _TOKEN.fullmatch(node_name) or "__" in node_name or len(node_name) > _DDS_MAX_LENGTH:
        rule = f"ASCII letters, digits and single underscores, no leading digit, at most {_DDS_MAX_LENGTH} characters"
        raise FqnError("node", node_name, rule)
    if name.startswith("/"):
        return validate_ros_name(name)
    if name == "~" or name.startswith("~/"):
        return validate_ros_name(f"{root}/{node_name}{name[1:]}")
    return validate_ros_name(f"{root}/{name}")


def check_words(segment: str, text: str) -> str:
    """Return the text of a schema's segment unchanged if its characters are allowed.

    Raises:
        FqnError: With this segment.
    """
    if not isinstance(text, str) or not _WORDS.fullmatch(text):
        raise FqnError(segment, text, _WORDS_RULE)
    return text


# --- Names on DDS ---------------------------------------------------------------------------------------------

_REQUEST = "Request"
_REPLY = "Reply"


class DdsRole(Enum):
    """Role of a DDS topic in ROS 2; the value is its prefix."""

    TOPIC = "rt"
    REQUEST = "rq"
    REPLY = "rr"


_TAIL = {DdsRole.TOPIC: "", DdsRole.REQUEST: _REQUEST, DdsRole.REPLY: _REPLY}


@dataclass(frozen=True, slots=True, kw_only=True)
class WireName:
    """Role and ROS name of a DDS topic."""

    role: DdsRole  #: Topic, or requests or replies of a service.
    name: str  #: Absolute ROS name; for parts of an action it contains `/_action/`.


def dds_topic(name: str) -> str:
    """Return the DDS topic of a ROS topic: `/chatter` is `rt/chatter`.

    Raises:
        FqnError: The name is not a valid absolute topic name.
    """
    return _mangled(DdsRole.TOPIC, validate_ros_name(name))


def dds_service(name: str) -> tuple[str, str]:
    """Return a service's request and reply topics: `/add` is `rq/addRequest` and `rr/addReply`.

    Raises:
        FqnError: The name is not a valid absolute service name.
    """
    validate_ros_name(name, ResourceKind.SERVICE)
    return _mangled(DdsRole.REQUEST, name), _mangled(DdsRole.REPLY, name)


def dds_names(name: str, kind: ResourceKind) -> tuple[str, ...]:
    """Return all DDS topics of a topic (1), a service (2) or an action (8, below `<name>/_action/`).

    Raises:
        FqnError: The name is not valid for its kind.
    """
    if kind is ResourceKind.TOPIC:
        return (dds_topic(name),)
    if kind is ResourceKind.SERVICE:
        return dds_service(name)
    below = f"{validate_ros_name(name, kind)}/_action/"
    services = (dds_service(below + part) for part in ("send_goal", "cancel_goal", "get_result"))
    return (
        *chain.from_iterable(services),
        dds_topic(f"{below}feedback"),
        dds_topic(f"{below}status"),
    )


def ros_name_from_dds(dds_name: str) -> WireName | None:
    """Return role and ROS name of a DDS topic, as lenient as rmw; None if the topic is not one of ROS 2."""
    for role, tail in _TAIL.items():
        if dds_name.startswith(role.value + "/") and dds_name.endswith(tail):
            name = dds_name.removeprefix(role.value).removesuffix(tail)
            return WireName(role=role, name=name) if is_wire_ros_name(name) else None
    return None


def router_breaks(segment: str, *, followed: bool) -> bool:
    """Return whether a segment of a service's name makes a DDS router confuse request and reply.

    The router derives the reply topic from the request topic by replacing *every* `rq/` by `rr/` and every
    `Request` by `Reply`, or the reverse (eProsima DDS-Pipe, RpcTopic.cpp). No other texts are affected:
    neither word can arise across two segments, because its capital R is only at its beginning.
    """
    return _REQUEST in segment or _REPLY in segment or (followed and segment.endswith(("rq", "rr")))


def router_hazards(name: str, kind: ResourceKind = ResourceKind.SERVICE) -> tuple[str, ...]:
    """Return the segments of a service's or action's name that a DDS router breaks, in order."""
    if kind is ResourceKind.TOPIC:
        return ()
    *firsts, last = name.split("/")
    hazards = [segment for segment in firsts if router_breaks(segment, followed=True)]
    if router_breaks(last, followed=kind is ResourceKind.ACTION):
        hazards.append(last)
    return tuple(hazards)


def _mangled(role: DdsRole, name: str) -> str:
    return f"{role.value}{name}{_TAIL[role]}"
