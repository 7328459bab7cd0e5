"""A sample as Cyclone DDS holds it (`ddsi_serdata`): from CDR bytes, to CDR bytes, and its time stamp.

Knows who owns a reference. Refuses to know readers and writers.
"""

from __future__ import annotations

import ctypes as ct
from typing import Any

from sfglab.bus.dds.clib import SDK_DATA, TIMESTAMP_INVALID, TIMESTAMP_OFFSET, IoVec, library

CDR_HEADER_BYTES = 4
_PADDING = ct.create_string_buffer(4)
_PADDING_ADDRESS = ct.addressof(_PADDING)


def sertype_of(entity: int) -> int | None:
    """Return what the samples of a writer are made with."""
    sertype = ct.c_void_p()
    library().dds_get_entity_sertype(entity, ct.byref(sertype))
    return sertype.value


def serdata_from_bytes(sertype: int | None, data: Any) -> int | None:
    """Return a new sample, unstamped, whose one reference is the caller's; None when the bytes do not parse.

    Args:
        sertype: Of the writer that it is for.
        data: `bytes` or a contiguous NumPy array of them: CDR with its 4-byte header.
    """
    size = len(data)
    if size < CDR_HEADER_BYTES:
        return None
    # RTPS sends whole words, so Cyclone may read up to three bytes beyond the end.
    padding = -size % 4
    address = ct.cast(ct.c_char_p(data), ct.c_void_p).value if isinstance(data, bytes) else data.ctypes.data
    parts = (IoVec * 2)(IoVec(address, size), IoVec(_PADDING_ADDRESS, padding))
    serdata: int | None = library().ddsi_serdata_from_ser_iov(
        sertype, SDK_DATA, 2 if padding else 1, ct.byref(parts), size + padding
    )
    return serdata


def bytes_from_serdata(serdata: int) -> bytes:
    """Return a copy of a sample's CDR, header included; the reference stays the caller's."""
    lib = library()
    part = IoVec()
    size = lib.ddsi_serdata_size(serdata)
    reference = lib.ddsi_serdata_to_ser_ref(serdata, 0, size, ct.byref(part))
    try:
        return ct.string_at(part.base, size)
    finally:
        lib.ddsi_serdata_to_ser_unref(reference, ct.byref(part))


def source_timestamp_ns(serdata: int) -> int:
    """Return when a sample was published, by its publisher's clock, in nanoseconds of Unix time."""
    return ct.c_int64.from_address(serdata + TIMESTAMP_OFFSET).value


def stamp(serdata: int, source_timestamp_ns: int) -> None:
    """Give a new sample its source time stamp, in nanoseconds of Unix time."""
    field = ct.c_int64.from_address(serdata + TIMESTAMP_OFFSET)
    assert field.value == TIMESTAMP_INVALID, "this Cyclone DDS has another serdata layout"
    field.value = source_timestamp_ns
