"""The run as one value for compiled functions: by reference, and its arrays without counting references.

Compiled code passes a tuple of arrays by value, some two hundred words a call, and counts a reference for
each, atomically. At a few calls an event this is most of the time. Here a call passes a pointer, and the arrays
in it are views without an owner, which are not counted; the caller of the compiled code holds the arrays.
"""

from __future__ import annotations

from typing import Any

import numba as nb
from numba.core import cgutils, types
from numba.experimental import structref
from numba.extending import intrinsic

from sfglab.rtps.state import Params, State

__all__ = ["World", "unowned"]


@structref.register
class _WorldType(types.StructRef):
    """Numba's type of a world: the fields of `Params` and `State`."""


class World(structref.StructRefProxy):
    """All fields of `Params` and `State`; made and used by compiled code only."""


structref.define_proxy(  # type: ignore[no-untyped-call]
    World, _WorldType, [*Params._fields, *State._fields]
)


@intrinsic
def _pointer(_: Any, address: Any) -> Any:
    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(address), generate


@nb.njit(cache=True, nogil=True)
def unowned(array: Any) -> Any:
    """Return a view of a contiguous array that owns nothing."""
    # Numba's stubs know neither the intrinsic's call from compiled code nor `carray`.
    return nb.carray(_pointer(array.ctypes.data), array.shape, array.dtype)  # type: ignore[attr-defined,call-arg]
