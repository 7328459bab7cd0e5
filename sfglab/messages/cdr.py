"""Serialisation of messages as plain CDR, little endian, the form that ROS 2 uses on the network and in logs.

The module handles the encapsulation header (RTPS 2.5, clause 10.2) and its padding. It does not depend on
the source of the bytes.
"""

from __future__ import annotations

import functools
import struct
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.messages.store import (
    MessageError,
    add_types,
    check_new,
    default_message,
    fields_of,
    is_known,
    is_known_as,
    parse_definition,
    type_name,
    type_store,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from rosbags.interfaces import Msgdef
    from rosbags.typesys.store import Typestore
    from typing_extensions import Buffer

_HEADER = b"\x00\x01\x00\x00"  # CDR_LE, no options
_IMAGE = "sensor_msgs/msg/Image"
_ALIGNMENT = 4  # Cyclone DDS rejects lengths that are not a multiple of it


class CdrError(MessageError):
    """Bytes that are not a message of the type, or a message that cannot become bytes."""

    def __init__(self, type_name: str, reason: str, *, size_bytes: int | None = None) -> None:
        self.type_name = type_name  #: Type of the message.
        self.size_bytes = size_bytes  #: Length of the bytes; None for an error of serialisation.
        self.reason = reason  #: Cause, as a phrase.
        what = (
            "cannot serialise" if size_bytes is None else f"cannot read {size_bytes} bytes of CDR"
        )
        super().__init__(f"{type_name}: {what}: {reason}")


def _misfit(message: Any) -> str:
    """Return the path to a field that cannot be written, its value and its type; empty if all can be."""
    name = type_name(type(message))
    for field, type_ in fields_of(name).items():
        value = getattr(message, field)
        if _is_writable(default_message(name, **{field: value})):
            continue
        if type_.is_message:
            for index, part in enumerate(value if isinstance(value, list) else [value]):
                fits = getattr(part, "__msgtype__", None) == type_.base
                if fits and (reason := _misfit(part)):
                    step = f"{field}[{index}]" if type_.is_list else field
                    return f"{step}.{reason}"
        if type_.is_list and not type_.is_number and isinstance(value, list):
            for index, part in enumerate(value):
                alone = [part] * (type_.length or 1)
                if not _is_writable(default_message(name, **{field: alone})):
                    return f"{field}[{index}]: given {_shown(part)}, allowed: {type_.base}"
        allowed = type_.base
        if type_.is_list:
            size = type_.length or ""
            kind = "a contiguous NumPy array" if type_.is_number else "a list"
            allowed = f"{type_.base}[{size}] as {kind}"
        return f"{field}: given {_shown(value)}, allowed: {allowed}"
    return ""


def _shown(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype} and shape {value.shape}"
    return f"{value!r:.60}"


def _is_writable(message: Any) -> bool:
    definition, store = _known(message.__class__)
    try:
        size = definition.getsize_cdr(0, message, store)
        definition.serialize_cdr_le(memoryview(bytearray(size)), 0, message, store)
    except _writing_errors():
        return False
    return True


def _write_error(message: Any, cause: Exception) -> CdrError:
    return CdrError(type_name(type(message)), _misfit(message) or str(cause))


def _writing_errors() -> tuple[type[Exception], ...]:
    from rosbags.serde import SerdeError

    return (SerdeError, struct.error, ValueError, TypeError, AttributeError, OverflowError)


@functools.cache
def _known(message_class: Any) -> tuple[Msgdef[Any], Typestore]:
    """Return the definition of a type, with which rosbags writes it, and its store; looked up once per type."""
    store = type_store()
    return store.get_msgdef(type_name(message_class)), store


def serialized_size(message: Any) -> int:
    """Return the number of bytes that `serialize` and `serialize_into` write, with 4-byte header and padding.

    Raises:
        CdrError: A field has a value of the wrong kind.
        UnknownTypeError: The object is no message.
    """
    definition, store = _known(message.__class__)
    try:
        end = definition.getsize_cdr(0, message, store)
    except _writing_errors() as exc:
        raise _write_error(message, exc) from exc
    return int(len(_HEADER) + end + -end % _ALIGNMENT)


def _write(message: Any, view: memoryview) -> None:
    """Write a message into zeroed memory of exactly its size."""
    definition, store = _known(message.__class__)
    view[:4] = _HEADER
    try:
        definition.serialize_cdr_le(view[4:], 0, message, store)
    except _writing_errors() as exc:
        raise _write_error(message, exc) from exc


def serialize(message: Any) -> bytes:
    """Return a message as little-endian CDR with its 4-byte header, padded to a multiple of 4.

    Numeric arrays must be contiguous one-dimensional NumPy arrays of the field's dtype. Another dtype of
    the same width is not detected. Padding is zero, so equal messages give equal bytes.

    Raises:
        CdrError: A field has a value of the wrong kind or out of range; the error names the field.
        UnknownTypeError: The object is no message.
    """
    # The bytes are written in place and returned without a copy. For an image, a copy would take longer
    # than all other steps together.
    memory = BytesIO(bytes(serialized_size(message)))
    with memory.getbuffer() as view:
        _write(message, view)
    return memory.getvalue()


def serialize_into(message: Any, buffer: Buffer) -> int:
    """Write a message as `serialize` does into contiguous memory that is large enough; return the number of bytes.

    Raises:
        CdrError: As for `serialize`, or the buffer is too small. After an error the buffer's content is
            undefined.
        UnknownTypeError: The object is no message.
    """
    size = serialized_size(message)
    view = memoryview(buffer).cast("B")
    if view.nbytes < size:
        raise CdrError(
            type_name(type(message)), f"given a buffer of {view.nbytes} bytes, needed: {size}"
        )
    np.frombuffer(view, np.uint8, size).fill(0)  # old content must not remain in alignment gaps
    _write(message, view[:size])
    return size


def _decoder(store: Typestore, name: str) -> Callable[[Buffer], Any]:
    """Return a function from CDR bytes to messages; it prepares here what is equal for all messages of the type."""
    from rosbags.serde import SerdeError

    definition = store.get_msgdef(name)
    read_fast = _image_reader(store) if name == _IMAGE else None

    def decoded(data: Buffer) -> Any:
        is_bytes = type(data) is memoryview and data.readonly and data.format == "B"
        view: memoryview = data if is_bytes else memoryview(data).cast("B").toreadonly()  # type: ignore[assignment]
        if view.nbytes < len(_HEADER) or bytes(view[:2]) not in {b"\0\0", _HEADER[:2]}:
            raise CdrError(name, "the encapsulation is not CDR", size_bytes=view.nbytes)
        if read_fast is not None and (message := read_fast(view)) is not None:
            return message
        decode = definition.deserialize_cdr_le if view[1] else definition.deserialize_cdr_be
        try:
            # Further bytes may follow, as rclpy accepts them: Fast DDS overestimates the size of a message.
            return decode(view[4:], 0, definition.cls, store)[0]
        except (SerdeError, struct.error, ValueError, IndexError) as exc:
            raise CdrError(name, str(exc), size_bytes=view.nbytes) from exc

    return decoded


def _image_reader(store: Typestore) -> Callable[[memoryview], Any]:
    """Return a function from the little-endian CDR of a sensor_msgs/Image to the message.

    It makes three calls of `struct`, while the general decoder makes one for each field. With cold caches
    each call costs several times as much. The function returns None for all other bytes. The general
    decoder then reads them, or reports the error.
    """
    image, header, time = (
        store.types[name] for name in (_IMAGE, "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    read_stamp = struct.Struct("<4siII").unpack_from  # encapsulation, stamp, length of frame_id
    read_size = struct.Struct("<III").unpack_from  # height, width, length of encoding
    read_rows = struct.Struct("<II").unpack_from  # step, length of data

    def read(view: memoryview) -> Any:
        try:
            encapsulation, seconds, nanoseconds, length = read_stamp(view, 0)
            end = 16 + length
            frame_id = str(view[16 : end - 1], "utf-8")
            size_at = end + -end % 4
            height, width, encoded = read_size(view, size_at)
            text_at = size_at + 12
            flag_at = text_at + encoded
            encoding = str(view[text_at : flag_at - 1], "utf-8")
            rows_at = flag_at + 4 - flag_at % 4  # after the flag, one byte, aligned to four
            step, size = read_rows(view, rows_at)
            is_ended = length and encoded and not view[end - 1] and not view[flag_at - 1]
            if encapsulation != _HEADER or not is_ended:
                return None
            data = np.frombuffer(view, np.uint8, size, rows_at + 8)
        except (struct.error, ValueError, IndexError):
            return None
        stamped = header(time(seconds, nanoseconds), frame_id)
        return image(stamped, height, width, encoding, view[flag_at], step, data)

    return read


def decoder(type_or_name: type[Any] | str) -> Callable[[Buffer], Any]:
    """Return `deserialize` for one message type or its name; the type is looked up once.

    Raises:
        UnknownTypeError: There is no such type.
    """
    key: Any = type_or_name
    return _known_decoder(key)


@functools.cache
def _known_decoder(type_or_name: Any) -> Callable[[Buffer], Any]:
    return _decoder(type_store(), type_name(type_or_name))


def deserialize(data: Buffer, type_or_name: type[Any] | str) -> Any:
    """Return the message in a CDR buffer of either byte order; numeric arrays are read-only views of it.

    The views keep the buffer alive: an mmap or shared memory cannot be closed before they are gone. Arrays
    of wide numbers may be unaligned in memory, which NumPy handles. Use `copy()` to change or to keep an
    array.

    Raises:
        CdrError: The bytes are truncated, malformed or of another type; bytes after the message are ignored.
        UnknownTypeError: There is no such type.
    """
    return decoder(type_or_name)(data)


def register_definition(name: str, text: str) -> None:
    """Add the type of a definition with its dependencies, as in logs; types that exist already are kept.

    Raises:
        MessageError: The definition cannot be read, or differs from that of the store under this name.
    """
    if is_known(name):
        if not is_known_as(name, text):
            raise MessageError(
                f"{name} is already registered with other fields; choose another name"
            )
        return
    parsed = parse_definition(name, text)
    add_types({other: fields for other, fields in parsed.items() if not is_known(other)})


def decoder_from_definition(name: str, text: str) -> Callable[[Buffer], Any]:
    """Return a function from CDR bytes to messages for a type that is known only by its definition.

    The text has the form that `sfglab.messages.store.definition` returns. The types of the messages are
    separate from those of `message_type`, even if they have equal names.

    Raises:
        CdrError: The text is no complete definition of the type.
    """
    from rosbags.typesys import Stores, TypesysError, get_typestore

    store = get_typestore(Stores.EMPTY)
    try:
        check_new(store, parsed := parse_definition(name, text))
        store.register(parsed)
        store.get_msgdef(name)
        return _decoder(store, name)
    except (MessageError, TypesysError, LookupError, SyntaxError, NameError, RecursionError) as exc:
        raise CdrError(name, f"its definition cannot be read: {exc}") from exc
