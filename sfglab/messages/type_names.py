"""Names of types, as ROS 2 writes them and as it announces them in DDS.

The module converts the two forms. It does not depend on the types that exist (`store`).
"""

from __future__ import annotations

import re

from sfglab.messages.store import MessageError

# rosidl_adapter's rules for packages and messages (Humble); services add _Request, _Response and _Event.
# The pattern is unambiguous, so that matching names of unknown peers takes linear time.
_PACKAGE = r"[a-z](?:_?[a-z0-9])*"
_NAME = r"[A-Za-z][A-Za-z0-9]*(?:_[A-Za-z0-9]+)*"
_ROS = re.compile(rf"(?P<package>{_PACKAGE})/(?P<kind>msg|srv|action)/(?P<name>{_NAME})")
_DDS = re.compile(rf"(?P<package>{_PACKAGE})::(?P<kind>msg|srv|action)::dds_::(?P<name>{_NAME})_")


class TypeNameError(MessageError):
    """A text that is not the name of a type in the expected form."""


def dds_type_name(name: str) -> str:
    """Return the name under which ROS 2 announces a type in DDS (rosidl_typesupport_introspection).

    `std_msgs/msg/String` gives `std_msgs::msg::dds_::String_`. Requests and responses have such names as
    well, such as `std_srvs/srv/Empty_Request`.

    Raises:
        TypeNameError: The name has another form.
    """
    if not (match := _ROS.fullmatch(name)):
        raise TypeNameError(f"type name: given {name!r}, allowed: the form 'package/msg/Name'")
    return "{package}::{kind}::dds_::{name}_".format_map(match.groupdict())


def announced_type_name(name: str) -> str:
    """Return the name under which a type is announced in DDS, from this name or from its name in ROS 2."""
    return dds_type_name(name) if _ROS.fullmatch(name) else name


def ros_type_name(name: str) -> str:
    """Return the ROS 2 name of a type that was announced in DDS: the inverse of `dds_type_name`.

    Raises:
        TypeNameError: No ROS 2 type is announced under such a name.
    """
    if not (match := _DDS.fullmatch(name)):
        raise TypeNameError(
            f"type name: given {name!r}, allowed: the form 'package::msg::dds_::Name_'"
        )
    return "{package}/{kind}/{name}".format_map(match.groupdict())
