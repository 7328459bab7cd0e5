"""Serialisation of messages as plain CDR, little endian, the form that ROS 2 uses on the network and in logs.

The module handles the encapsulation header (RTPS 2.5, clause 10.2) and its padding. It does not depend on
the source of the bytes.
"""

from __future__ import annotations

import functools
import re
import struct
from collections.abc import Callable, Sequence
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.messages.store import (
    RULE,
    MessageError,
    add_types,
    check_new,
    is_known_as,
    numpy_dtype,
    parse_definition,
    type_name,
    type_store,
)

if TYPE_CHECKING:
    from rosbags.interfaces import Msgdef
    from rosbags.interfaces.typing import FieldDesc
    from rosbags.typesys.store import Typestore
    from typing_extensions import Buffer

_HEADER = b"\x00\x01\x00\x00"  # CDR_LE, no options
_WHOLE: Any = (int, np.integer, np.bool_)
_NUMBERS: Any = (*_WHOLE, float, np.floating)
_IMAGE = "sensor_msgs/msg/Image"
_ALIGNMENT = 4  # Cyclone DDS rejects lengths that are not a multiple of it


class CdrError(MessageError):
    """Bytes that are not a message of the type, or a message that cannot become bytes."""

    def __init__(self, type_name: str, reason: str, *, size_bytes: int | None = None) -> None:
        self.type_name = type_name  #: Type of the message.
        self.size_bytes = size_bytes  #: Length of the bytes; None for an error of serialisation.
        self.reason = reason  #: Reason.
        what = (
            "cannot serialise" if size_bytes is None else f"not in these {size_bytes} bytes of CDR"
        )
        super().__init__(f"{type_name}: {what}: {reason}")


def _scalar_misfit(value: Any, base: str) -> str | None:
    if base == "string":
        return None if isinstance(value, str) else f": given {value!r}, allowed is text"
    dtype = numpy_dtype(base)
    if not isinstance(value, _NUMBERS if dtype.kind == "f" else _WHOLE):
        return f": given {value!r}, allowed is {base}"
    if dtype.kind in "iu":
        limits = np.iinfo(dtype)
        if not limits.min <= value <= limits.max:
            return f": given {value!r}, allowed are {limits.min} to {limits.max}"
    return None


def _array_misfit(value: Any, base: str) -> str:
    """Return why a value is no array of numbers of a type; empty if it is such an array."""
    wanted = numpy_dtype(base)
    if not isinstance(value, np.ndarray):
        return f": given {type(value).__name__}, allowed is a NumPy array of {wanted}"
    if value.dtype != wanted:
        return f": given an array of {value.dtype}, allowed is {wanted}"
    is_plain = value.ndim == 1 and value.flags.c_contiguous
    allowed = "allowed is one contiguous dimension: ravel() it"
    return "" if is_plain else f": given an array of shape {value.shape}, {allowed}"


def _misfit(store: Typestore, value: Any, desc: FieldDesc) -> str | None:
    """Return why a value does not fit a field, or None. The text begins with the path to the field."""
    from rosbags.interfaces import Nodetype

    if desc[0] == Nodetype.BASE:
        return _scalar_misfit(value, desc[1][0])
    parts = _parts_of(store, value, desc)
    if isinstance(parts, str):
        return parts
    for step, part, part_desc in parts:
        if reason := _misfit(store, part, part_desc):
            return step + reason
    return None


def _parts_of(store: Typestore, value: Any, desc: FieldDesc) -> list[tuple[str, Any, Any]] | str:
    """Return path step, value and type of each part of a message or list, or the reason why it is neither."""
    from rosbags.interfaces import Nodetype

    kind = desc[0]
    inner: Any = desc[1]
    if kind == Nodetype.NAME:
        if getattr(value, "__msgtype__", None) != inner:
            return f": given {type(value).__name__}, allowed is {inner}"
        fields = store.get_msgdef(inner).fields
        return [(f".{name}", getattr(value, name), part) for name, part in fields]
    element, length = inner
    if element[0] == Nodetype.BASE and element[1][0] != "string":
        return _array_misfit(value, element[1][0]) or []
    if not isinstance(value, Sequence) or isinstance(value, str):
        return f": given {type(value).__name__}, allowed is a list"
    if kind == Nodetype.ARRAY and len(value) != length:
        return f": given {len(value)} elements, allowed are {length}"
    return [(f"[{index}]", part, element) for index, part in enumerate(value)]


def _write_error(message: Any, cause: Exception) -> CdrError:
    from rosbags.interfaces import Nodetype

    name = type_name(type(message))
    reason = _misfit(type_store(), message, (Nodetype.NAME, name))
    return CdrError(name, reason.lstrip(".: ") if reason else str(cause))


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
        UnknownTypeError: It is no message.
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
        CdrError: A field has a value of the wrong kind or out of range; the message names the field.
        UnknownTypeError: It is no message.
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
        CdrError: As for `serialize`, or the buffer is too small. After an error, its content is undefined.
        UnknownTypeError: It is no message.
    """
    size = serialized_size(message)
    view = memoryview(buffer).cast("B")
    if view.nbytes < size:
        raise CdrError(
            type_name(type(message)), f"given a buffer of {view.nbytes} bytes, needed are {size}"
        )
    np.frombuffer(view, np.uint8, size).fill(0)  # old content must not remain in alignment gaps
    _write(message, view[:size])
    return size


def _decoder(store: Typestore, name: str) -> Callable[[Buffer], Any]:
    """Return a function from CDR bytes to messages. Work that is equal for all messages is done once, here."""
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


_decoders: dict[type[Any] | str, Callable[[Buffer], Any]] = {}


def decoder(type_or_name: type[Any] | str) -> Callable[[Buffer], Any]:
    """Return `deserialize` for one message type or its name; the type is looked up once.

    Raises:
        UnknownTypeError: There is no such type.
    """
    found = _decoders.get(type_or_name)
    if found is None:
        name = type_name(type_or_name)
        found = _decoders[type_or_name] = _decoder(type_store(), name)
    return found


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
    if name in type_store().fielddefs:
        if not is_known_as(name, text):
            raise MessageError(f"{name} is already registered with other fields")
        return
    first, *rest = re.split(rf"^{RULE}$\nMSG: ", text, flags=re.MULTILINE)
    heads = [part.partition("\n") for part in rest]
    texts = {
        (n if n.count("/") == 2 else n.replace("/", "/msg/")).strip(): body for n, _, body in heads
    }
    add_types(
        {name: first} | {n: body for n, body in texts.items() if n not in type_store().fielddefs}
    )


def decoder_from_definition(name: str, text: str) -> Callable[[Buffer], Any]:
    """Return a `deserialize` for a type known only by its definition, as `definition` returns it.

    Its types are separate from those of `message_type`, also if they have equal names.

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
