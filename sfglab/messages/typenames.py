"""Names of ROS 2 types and what DDS calls them: pure text in, pure text out.

Knows the mapping of rosidl (`pkg/msg/Type` <-> `pkg::msg::dds_::Type_`). Refuses to know which types exist.
"""

from __future__ import annotations

import re

from sfglab.errors import SfglabError

# rosidl_adapter's rules for packages and messages (Humble); services add _Request, _Response and _Event.
_PACKAGE = r"[a-z](?:_?[a-z0-9]+)*"
_NAME = r"[A-Za-z][A-Za-z0-9]*(?:_[A-Za-z0-9]+)*"
_ROS = re.compile(rf"(?P<package>{_PACKAGE})/(?P<kind>msg|srv|action)/(?P<name>{_NAME})")
_DDS = re.compile(rf"(?P<package>{_PACKAGE})::(?P<kind>msg|srv|action)::dds_::(?P<name>{_NAME})_")


class TypeNameError(SfglabError, ValueError):
    """Text that is not the name of a type in the expected form.

    Attributes:
        name: What was given.
    """

    def __init__(self, name: str, *, expected: str) -> None:
        self.name = name
        super().__init__(f"type name: given {name!r}, allowed is the form {expected!r}")


def dds_type_name(name: str) -> str:
    """Return the name under which ROS 2 announces a type in DDS (rosidl_typesupport_introspection).

    Args:
        name: A ROS 2 name such as `std_msgs/msg/String` or `std_srvs/srv/Empty_Request`.

    Returns:
        For example `std_msgs::msg::dds_::String_`.

    Raises:
        TypeNameError: The name has another form.
    """
    if not (match := _ROS.fullmatch(name)):
        raise TypeNameError(name, expected="package/msg/Name")
    return "{package}::{kind}::dds_::{name}_".format_map(match.groupdict())


def ros_type_name(name: str) -> str:
    """Return the ROS 2 name of a type that was announced in DDS: the inverse of `dds_type_name`.

    Args:
        name: A DDS name such as `std_msgs::msg::dds_::String_`.

    Returns:
        For example `std_msgs/msg/String`.

    Raises:
        TypeNameError: No ROS 2 type is announced under such a name.
    """
    if not (match := _DDS.fullmatch(name)):
        raise TypeNameError(name, expected="package::msg::dds_::Name_")
    return "{package}/{kind}/{name}".format_map(match.groupdict())
