"""A faster way to read messages that are flat: numbers, strings, arrays of numbers, and such messages inside.

For these types (Image, Imu, FFMPEGPacket, ...) one function is generated that reads runs of numbers with one
`struct` call each, where the general decoder, also the tests' oracle, makes a call for every field: with cold
caches each call counts several times. Little endian only.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.messages.store import numpy_dtype

if TYPE_CHECKING:
    from collections.abc import Callable

    from rosbags.interfaces.typing import FieldDesc
    from rosbags.typesys.store import Typestore

_START = 4  # CDR counts positions, and so alignment, from behind its 4-byte header
_LITTLE = 0x0100  # the header 00 01 00 00, CDR_LE without options, read as a little-endian number
_CODES = {"bool": "?", "byte": "B", "char": "B", "float32": "f", "float64": "d"}
_CODES |= {"int8": "b", "int16": "h", "int32": "i", "int64": "q"}
_CODES |= {"uint8": "B", "uint16": "H", "uint32": "I", "uint64": "Q"}


class _NotFlatError(Exception):
    """The type holds a list of messages or strings."""


class _Source:
    """The generated function's lines, and what is known about alignment at the current line."""

    def __init__(self, store: Typestore) -> None:
        self.lines: list[str] = []
        self.names: dict[str, Any] = {"frombuffer": np.frombuffer}
        self._store = store
        self._run = "I"  # struct codes that wait to be read together, the header first
        self._targets = ["h"]
        self._phase, self._modulus = 0, 8  # the position behind the header, as far as it is known
        self._count = 0

    def message(self, name: str) -> str:
        """Read a message's fields and return the expression that makes it."""
        msgdef = self._store.get_msgdef(name)
        values = [self._field(desc) for _, desc in msgdef.fields]
        constructor = self._keep(msgdef.cls)
        return f"{constructor}({', '.join(values)})"

    def flush(self) -> None:
        """Read the numbers that wait."""
        if self._targets:
            run = struct.Struct("<" + self._run)
            self.lines.append(f"{', '.join(self._targets)}, = {self._keep(run.unpack_from)}(b, p)")
            self.lines.append(f"p += {run.size}")
            if self._targets[0] == "h":
                self.lines.append(f"if h != {_LITTLE}: return None")
            self._run, self._targets = "", []

    def _field(self, desc: FieldDesc) -> str:
        from rosbags.interfaces import Nodetype

        if desc[0] == Nodetype.NAME:
            return self.message(desc[1])
        if desc[0] == Nodetype.BASE:
            return self._string() if desc[1][0] == "string" else self._number(desc[1][0])
        element, length = desc[1]
        if element[0] != Nodetype.BASE or element[1][0] == "string":
            raise _NotFlatError
        return self._array(element[1][0], length if desc[0] == Nodetype.ARRAY else None)

    def _number(self, base: str) -> str:
        code = _CODES[base]
        size = struct.calcsize(code)
        if size > self._modulus:
            self._align(size)
        padding = -self._phase % size
        self._run += "x" * padding + code
        self._phase = (self._phase + padding + size) % self._modulus
        self._targets.append(self._new())
        return self._targets[-1]

    def _string(self) -> str:
        length, text = self._number("uint32"), self._new()
        self.flush()
        self.lines += [
            f"e = p + {length}",
            f"if not {length} or e > n or b[e - 1]:",
            f"    raise ValueError(f'string of {{{length}}} bytes at {{p}}')",
            f"{text} = str(b[p:e - 1], 'utf-8')",
            "p = e",
        ]
        self._phase, self._modulus = 0, 1
        return text

    def _array(self, base: str, length: int | None) -> str:
        dtype = np.dtype(numpy_dtype(base))
        count = self._number("uint32") if length is None else str(length)
        self.flush()
        array = self._new()
        if length is None and dtype.itemsize > 4:
            # An empty sequence has no elements to align, so what follows is aligned to 4 only.
            self.lines.append(
                f"if {count}: p = (p - {_START} + {dtype.itemsize - 1} & -{dtype.itemsize}) + {_START}"
            )
        elif length is not None:
            self._align(dtype.itemsize)
        self.lines.append(f"{array} = frombuffer(b, {self._keep(dtype)}, {count}, p)")
        self.lines.append(f"p += {count} * {dtype.itemsize}")
        self._phase, self._modulus = 0, min(dtype.itemsize, 4)
        return array

    def _align(self, size: int) -> None:
        self.flush()
        self.lines.append(f"p = (p - {_START} + {size - 1} & -{size}) + {_START}")
        self._phase, self._modulus = 0, size

    def _new(self) -> str:
        self._count += 1
        return f"v{self._count}"

    def _keep(self, value: Any) -> str:
        name = f"k{len(self.names)}"
        self.names[name] = value
        return name


def flat_reader(store: Typestore, name: str) -> Callable[[memoryview], Any] | None:
    """Return a function from CDR bytes to messages of a store's type, or None for a type that is not flat.

    It returns None for other than little-endian CDR; bad bytes are a `struct.error`, `ValueError` or
    `IndexError`.
    """
    source = _Source(store)
    try:
        result = source.message(name)
    except _NotFlatError:
        return None
    source.flush()
    body = ["n = len(b)", "p = 0", *source.lines, f"return {result}"]
    code = "def read(b):\n" + "\n".join(f"    {line}" for line in body)
    exec(compile(code, f"<reader of {name}>", "exec"), source.names)  # noqa: S102  # our own text, from a type
    reader: Callable[[memoryview], Any] = source.names["read"]
    return reader
