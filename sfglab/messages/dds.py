"""Message types for Cyclone DDS: `IdlStruct` classes, made from the same definitions as all other types.

The package's `__init__` does not import this module, because it loads the DDS library.
"""

from __future__ import annotations

import functools
import keyword
from typing import TYPE_CHECKING, Any

from cyclonedds.idl import IdlStruct, make_idl_struct, types

from sfglab.messages.store import fields_of, message_type, service_type, type_name
from sfglab.messages.type_names import announced_type_name, dds_type_name

if TYPE_CHECKING:
    from sfglab.messages.field_types import FieldType

_PRIMITIVES: dict[str, Any] = {
    "bool": bool,
    "byte": types.uint8,
    "char": types.uint8,
    **{name: getattr(types, name) for name in ("int8", "int16", "int32", "int64")},
    **{
        name: getattr(types, name)
        for name in ("uint8", "uint16", "uint32", "uint64", "float32", "float64")
    },
}
# rmw_cyclonedds, serdata.hpp: cdds_request_header_t.
_SERVICE_HEADER = {"rmw_client_guid": types.uint64, "rmw_sequence": types.int64}
_HALVES = ("Request", "Response")


def _generic(constructor: Any) -> Any:
    """Return the constructor without the library's annotation, according to which it cannot be subscripted."""
    return constructor


def _element(type_: FieldType) -> Any:
    if type_.is_message:
        return _struct(type_.base)
    if type_.is_number:
        return _PRIMITIVES[type_.base]
    return _generic(types.bounded_str)[type_.longest] if type_.longest else str


def _annotation(type_: FieldType) -> Any:
    element = _element(type_)
    if type_.is_array:
        return _generic(types.array)[element, type_.length]
    if type_.is_list:
        return _generic(types.sequence)[(element, type_.length) if type_.length else element]
    return element


def _made(name: str, header: dict[str, Any]) -> type[IdlStruct]:
    fields = header | {field: _annotation(type_) for field, type_ in fields_of(name).items()}
    # A dataclass cannot have such a field. Raw CDR does not need a dataclass; typed (de)serialisation is
    # disabled for these types.
    plain = not any(keyword.iskeyword(field) or hasattr(IdlStruct, field) for field in fields)
    return make_idl_struct(name.rpartition("/")[2], dds_type_name(name), fields, dataclassify=plain)


@functools.cache
def _struct(name: str) -> type[IdlStruct]:
    return _made(name, {})


def idl_struct(type_or_name: type[Any] | str) -> type[IdlStruct]:
    """Return the Cyclone DDS type, for raw CDR, of a message, a request or a reply; it is made on first use.

    Raises:
        UnknownTypeError: There is no such type.
    """
    name = type_name(type_or_name)
    message_type(name)
    return _struct(name)


@functools.cache
def service_idl_struct(name: str) -> tuple[type[IdlStruct], type[IdlStruct]]:
    """Return the Cyclone DDS types of a service's request and reply, with the header of rmw_cyclonedds.

    The first fields are `rmw_client_guid` (uint64) and `rmw_sequence` (int64), as in the result of
    `frame_service`.

    Raises:
        UnknownTypeError: There is no such service.
    """
    service = service_type(name)
    names = type_name(service.request), type_name(service.response)
    return _made(names[0], _SERVICE_HEADER), _made(names[1], _SERVICE_HEADER)


def service_half_idl_struct(name: str) -> type[IdlStruct]:
    """Return one of the types of `service_idl_struct`, such as that of `sfglab_interfaces/srv/GetMetadata_Request`.

    Raises:
        UnknownTypeError: There is no such service.
    """
    service, _, half = name.rpartition("_")
    return service_idl_struct(service)[_HALVES.index(half) if half in _HALVES else 0]


@functools.cache
def opaque_idl_struct(name: str) -> type[IdlStruct]:
    """Return a Cyclone DDS type for a type name, in the form of ROS or of DDS, which forwards any CDR unchanged.

    It matches endpoints that announce no type description: those of ROS 2 and other opaque endpoints.
    """
    return make_idl_struct("Opaque", announced_type_name(name), {"first_octet": types.uint8})
