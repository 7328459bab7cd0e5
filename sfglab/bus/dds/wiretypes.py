"""The Cyclone DDS type for samples that are only passed on: the real one where it is known, else an opaque one.

A real one is needed to match endpoints that describe their type, as those of sfglab do; those of ROS 2 announce
a name only, and match an opaque type of that name as well.
"""

from __future__ import annotations

import logging
from functools import cache
from typing import Any

from sfglab.messages import UnknownTypeError

_log = logging.getLogger("sfglab.bus")
_SERVICE_PREFIXES = ("rq/", "rr/")


def wire_type(dds_topic: str, type_: str) -> type[Any]:
    """Return the Cyclone DDS type of a topic's samples.

    Args:
        dds_topic: The topic on the wire; below "rq/" and "rr/" samples begin with the frame of a service.
        type_: As `EndpointInfo.type` names it. One that is not known here is opaque: its samples pass as they
            are, which is said once.
    """
    from sfglab.messages.dds import idl_struct, service_half_idl_struct

    service = dds_topic.startswith(_SERVICE_PREFIXES)
    try:
        return service_half_idl_struct(type_) if service else idl_struct(type_)
    except UnknownTypeError:
        return _opaque(type_)


@cache
def _opaque(type_: str) -> type[Any]:
    """Return a type that passes anything; cached, so that it is warned of once."""
    from sfglab.messages.dds import opaque_idl_struct

    _log.warning(
        "forwarding: type %s is not known here; its samples pass as they are between ROS 2 nodes, but not to "
        "and from nodes of sfglab that know the type",
        type_,
    )
    return opaque_idl_struct(type_)
