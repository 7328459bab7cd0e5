"""ROS names on DDS: `rt/`, `rq/`, `rr/`, the names behind an action, and what a DDS router does to them.

Works for every valid ROS name, in the schema or not. Source: design.ros2.org, "Topic and Service name mapping
to DDS" and "Actions".
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from sfglab.names.grammar import ResourceKind, is_wire_ros_name, validate_ros_name

_REQUEST = "Request"
_REPLY = "Reply"


class DdsRole(Enum):
    """What a DDS topic carries for ROS 2; the value is its prefix."""

    TOPIC = "rt"
    REQUEST = "rq"
    REPLY = "rr"


_TAIL = {DdsRole.TOPIC: "", DdsRole.REQUEST: _REQUEST, DdsRole.REPLY: _REPLY}


@dataclass(frozen=True, slots=True, kw_only=True)
class WireName:
    """The ROS side of a DDS topic name."""

    role: DdsRole  #: Topic, or one half of a service.
    name: str  #: Absolute ROS name; of an action's parts with `/_action/` in it.


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionNames:
    """The DDS topics of one action: three services as (request, reply) pairs, and two topics."""

    send_goal: tuple[str, str]
    cancel_goal: tuple[str, str]
    get_result: tuple[str, str]
    feedback: str
    status: str


def dds_topic(name: str) -> str:
    """Return the DDS topic of a ROS topic: `/chatter` is `rt/chatter`.

    Raises:
        FqnError: If the name is not a valid absolute topic name.
    """
    return _mangled(DdsRole.TOPIC, validate_ros_name(name))


def dds_service(name: str) -> tuple[str, str]:
    """Return a service's request and reply topics: `/add` is `rq/addRequest` and `rr/addReply`.

    Raises:
        FqnError: If the name is not a valid absolute service name.
    """
    validate_ros_name(name, ResourceKind.SERVICE)
    return _mangled(DdsRole.REQUEST, name), _mangled(DdsRole.REPLY, name)


def dds_action(name: str) -> ActionNames:
    """Return the eight DDS topics of an action, all below `<name>/_action/`.

    Raises:
        FqnError: If the name is not a valid absolute action name.
    """
    validate_ros_name(name, ResourceKind.ACTION)
    below = f"{name}/_action/"
    return ActionNames(
        send_goal=dds_service(f"{below}send_goal"),
        cancel_goal=dds_service(f"{below}cancel_goal"),
        get_result=dds_service(f"{below}get_result"),
        feedback=dds_topic(f"{below}feedback"),
        status=dds_topic(f"{below}status"),
    )


def dds_names(name: str, kind: ResourceKind) -> tuple[str, ...]:
    """Return every DDS topic that a topic (1), service (2) or action (8) uses.

    Raises:
        FqnError: If the name is not valid for its kind.
    """
    if kind is ResourceKind.TOPIC:
        return (dds_topic(name),)
    if kind is ResourceKind.SERVICE:
        return dds_service(name)
    action = dds_action(name)
    services = action.send_goal + action.cancel_goal + action.get_result
    return (*services, action.feedback, action.status)


def ros_name_from_dds(dds_name: str) -> WireName | None:
    """Return the ROS side of a DDS topic name, or None where the topic is not ROS 2's.

    The inverse of `dds_topic` and `dds_service`. Topics such as `ros_discovery_info`, or `rq/` without
    `Request` at its end, give None. Accepts what rmw accepts, so repeated underscores pass.
    """
    for role, tail in _TAIL.items():
        if dds_name.startswith(role.value + "/") and dds_name.endswith(tail):
            name = dds_name.removeprefix(role.value).removesuffix(tail)
            return WireName(role=role, name=name) if is_wire_ros_name(name) else None
    return None


def router_breaks(segment: str, *, followed: bool) -> bool:
    """Tell whether a segment of a service's name makes a DDS router confuse request and reply.

    The router derives one half of a service from the other by replacing *every* `rq/` by `rr/` and every
    `Request` by `Reply`, or the reverse (eProsima DDS-Pipe, RpcTopic.cpp). A segment in front of another
    must therefore not end in `rq` or `rr`, and none may contain `Request` or `Reply`. Nothing else breaks:
    neither word can arise across a border, because its capital R stands only at its beginning.

    Args:
        segment: One part of the name, without slashes.
        followed: Whether another segment follows, that is, whether a `/` stands behind this one.
    """
    return _REQUEST in segment or _REPLY in segment or (followed and segment.endswith(("rq", "rr")))


def router_hazards(name: str, kind: ResourceKind = ResourceKind.SERVICE) -> tuple[str, ...]:
    """Return the segments of a name that a DDS router breaks, in order; empty where it is routed safely.

    Topics are never mangled; of an action also the last segment is followed by another (`/_action`).

    Args:
        name: Absolute ROS name.
        kind: What the name denotes.
    """
    if kind is ResourceKind.TOPIC:
        return ()
    segments = name.split("/")[1:]
    last = len(segments) if kind is ResourceKind.SERVICE else len(segments) + 1
    return tuple(
        segment
        for place, segment in enumerate(segments, start=1)
        if router_breaks(segment, followed=place < last)
    )


def _mangled(role: DdsRole, name: str) -> str:
    return f"{role.value}{name}{_TAIL[role]}"
