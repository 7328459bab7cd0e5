"""ROS 2 messages without ROS: types, definitions, and bytes as they are on the wire.

All messages of ROS 2 Humble, the video formats FFMPEGPacket and CompressedVideo, and our own interfaces (the
files under `interfaces/`). `sfglab.messages.dds` makes the types for Cyclone DDS and is imported separately.
"""

from __future__ import annotations

from sfglab.messages.action_text import ActionTextError
from sfglab.messages.actions import ActionType, action_type, register_action
from sfglab.messages.cdr import (
    CdrError,
    decoder,
    decoder_from_definition,
    deserialize,
    serialize,
    serialize_into,
    serialized_size,
)
from sfglab.messages.rows import RowTypeError, row_message, row_type
from sfglab.messages.services import ServiceFrame, ServiceFrameError, frame_service, unframe_service
from sfglab.messages.stamps import StampError, ns_from_stamp, stamp_from_ns
from sfglab.messages.store import (
    ServiceType,
    TypeConflictError,
    UnknownTypeError,
    default_message,
    definition,
    message_type,
    message_types,
    service_type,
    type_name,
)
from sfglab.messages.typenames import TypeNameError, dds_type_name, ros_type_name

__all__ = [
    "ActionTextError",
    "ActionType",
    "CdrError",
    "RowTypeError",
    "ServiceFrame",
    "ServiceFrameError",
    "ServiceType",
    "StampError",
    "TypeConflictError",
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
    "register_action",
    "ros_type_name",
    "row_message",
    "row_type",
    "serialize",
    "serialize_into",
    "serialized_size",
    "service_type",
    "stamp_from_ns",
    "type_name",
    "unframe_service",
]
