"""ROS 2 messages without an installation of ROS 2: types, definitions, and serialised bytes.

The types are all of ROS 2 Humble, FFMPEGPacket, CompressedVideo, and the interfaces of sfglab (the files in
`interfaces/`).
"""

from sfglab.messages.cdr import (
    CdrError,
    decoder,
    decoder_from_definition,
    deserialize,
    register_definition,
    serialize,
    serialize_into,
    serialized_size,
)
from sfglab.messages.rows import row_message, row_type
from sfglab.messages.services import (
    ActionType,
    ServiceFrame,
    action_type,
    frame_service,
    service_hash,
    unframe_service,
)
from sfglab.messages.store import (
    MessageError,
    UnknownTypeError,
    default_message,
    definition,
    message_type,
    message_types,
    ns_from_stamp,
    register_interfaces,
    service_type,
    stamp_from_ns,
    type_hash,
    type_name,
)
from sfglab.messages.type_names import TypeNameError, dds_type_name, ros_type_name

__all__ = [
    "ActionType",
    "CdrError",
    "MessageError",
    "ServiceFrame",
    "TypeNameError",
    "UnknownTypeError",
    "action_type",
    "dds_type_name",
    "decoder",
    "decoder_from_definition",
    "default_message",
    "definition",
    "deserialize",
    "frame_service",
    "message_type",
    "message_types",
    "ns_from_stamp",
    "register_definition",
    "register_interfaces",
    "ros_type_name",
    "row_message",
    "row_type",
    "serialize",
    "serialize_into",
    "serialized_size",
    "service_hash",
    "service_type",
    "stamp_from_ns",
    "type_hash",
    "type_name",
    "unframe_service",
]
