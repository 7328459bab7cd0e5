"""Types of the fields of messages in a flat form; rosbags nests them in tuples."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class FieldType(NamedTuple):
    """Type of one field of a message."""

    base: str  #: Type of the value or of each element: a primitive, `string` or a full name.
    longest: int  #: Largest number of characters of a string; 0: any.
    is_message: bool  #: Whether `base` is the name of a message type.
    is_list: bool  #: Whether the field is an array or a sequence.
    is_array: bool  #: Whether the field is a list of exactly `length` elements.
    length: int  #: Largest number of elements; 0: any.

    @property
    def is_number(self) -> bool:
        """Whether each value is a number or a truth value."""
        return not self.is_message and self.base != "string"

    @property
    def dtype(self) -> np.dtype[Any]:
        """The dtype of a number; `byte` and `char` are uint8."""
        return np.dtype({"char": "uint8", "byte": "uint8"}.get(self.base, self.base))


def field_type(desc: Any) -> FieldType:
    """Return the flat form of a field's type as rosbags describes it."""
    from rosbags.interfaces import Nodetype

    is_array = desc[0] == Nodetype.ARRAY
    is_list = is_array or desc[0] == Nodetype.SEQUENCE
    (kind, inner), length = desc[1] if is_list else (desc, 0)
    is_message = kind == Nodetype.NAME
    base, longest = (inner, 0) if is_message else inner
    return FieldType(base, longest, is_message, is_list, is_array, length)
