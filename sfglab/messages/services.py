"""Requests and replies with the service header of rmw_cyclonedds, 16 bytes before the fields.

The header is `cdds_request_header_t`. rmw_fastrtps has no such header, so a client of one middleware cannot
call a service of the other.
"""

from __future__ import annotations

import struct
from copy import copy
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

from sfglab.messages.store import (
    MessageError,
    ServiceType,
    UnknownTypeError,
    message_type,
    names_before,
    service_type,
    type_store,
)

_ENCAPSULATION_BYTES = 4
_FRAME = {
    0: struct.Struct(">Qq"),
    1: struct.Struct("<Qq"),
}  # key: second octet of the encapsulation


class ServiceFrame(NamedTuple):
    """Parts of one request or reply: the header's two numbers, and the message."""

    client_guid: int  #: Id of the client; a reply repeats it.
    sequence: int  #: Number of the request; a reply repeats it.
    cdr: bytes  #: CDR of the request or response alone, as `deserialize` takes it.


def frame_service(frame: ServiceFrame) -> bytes:
    """Return the bytes for DDS, of the type that `sfglab.messages.dds.service_idl_struct` makes.

    They are encapsulation, GUID, sequence number and fields. The 16 bytes of the header keep every
    alignment.
    """
    header = _FRAME[1].pack(frame.client_guid, frame.sequence)
    return b"".join((frame.cdr[:_ENCAPSULATION_BYTES], header, frame.cdr[_ENCAPSULATION_BYTES:]))


def unframe_service(data: bytes) -> ServiceFrame:
    """Return client, sequence number and plain CDR of a request or reply from DDS, in either byte order.

    Raises:
        MessageError: The data are too short, or are no CDR.
    """
    start = _ENCAPSULATION_BYTES
    end = start + _FRAME[1].size
    if len(data) < end or data[0] != 0 or data[1] not in _FRAME:
        raise MessageError(
            f"service frame: given {len(data)} bytes, allowed: CDR bytes with a header of 16: "
            "does the peer run rmw_cyclonedds?"
        )
    client_guid, sequence = _FRAME[data[1]].unpack_from(data, start)
    return ServiceFrame(client_guid, sequence, data[:start] + data[end:])


_EVENT_INFO = "service_msgs/msg/ServiceEventInfo"  # since Iron


@cache
def service_hash(name: str) -> str:
    """Return a service's hash in the form that ROS 2 uses since Iron: of its request, response and event (REP 2016).

    Raises:
        UnknownTypeError: There is no such service.
    """
    from rosbags.interfaces import Nodetype

    service_type(name)
    event, request, response = (
        (Nodetype.NAME, f"{name}_{part}") for part in ("Event", "Request", "Response")
    )
    fields: dict[str, list[tuple[str, Any]]] = {
        _EVENT_INFO: [
            ("event_type", (Nodetype.BASE, ("uint8", 0))),
            ("stamp", (Nodetype.NAME, "builtin_interfaces/msg/Time")),
            ("client_gid", (Nodetype.ARRAY, ((Nodetype.BASE, ("char", 0)), 16))),
            ("sequence_number", (Nodetype.BASE, ("int64", 0))),
        ],
        event[1]: [
            ("info", (Nodetype.NAME, _EVENT_INFO)),
            ("request", (Nodetype.SEQUENCE, (request, 1))),
            ("response", (Nodetype.SEQUENCE, (response, 1))),
        ],
        name: [
            ("request_message", request),
            ("response_message", response),
            ("event_message", event),
        ],
    }
    store = copy(type_store())
    added: dict[str, Any] = {type_: ([], of) for type_, of in fields.items()}
    store.fielddefs = {**store.fielddefs, **added}
    return store.hash_rihs01(name)


_MARK = "_FeedbackMessage"


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionType:
    """Message types of an action (design.ros2.org, "Actions"), all dataclasses with `__msgtype__`."""

    name: str  #: Name of the action, such as `sfglab_interfaces/action/FollowTrajectory`.
    goal: type[Any]  #: Type of goals.
    result: type[Any]  #: Type of results.
    feedback: type[Any]  #: Type of feedback.
    send_goal: ServiceType  #: Service that requests a goal.
    get_result: ServiceType  #: Service that waits for the result of a goal.
    feedback_message: type[Any]  #: Type of the feedback topic: a goal's id and its feedback.


def action_type(name: str) -> ActionType:
    """Return an action type by its full name, `package/action/Name`.

    Raises:
        UnknownTypeError: There is no such action; the message lists similar names.
    """
    actions = names_before(_MARK, "action")
    if name not in actions:
        raise UnknownTypeError(name, actions)
    return ActionType(
        name=name,
        goal=message_type(f"{name}_Goal"),
        result=message_type(f"{name}_Result"),
        feedback=message_type(f"{name}_Feedback"),
        send_goal=service_type(f"{name}_SendGoal"),
        get_result=service_type(f"{name}_GetResult"),
        feedback_message=message_type(f"{name}{_MARK}"),
    )
