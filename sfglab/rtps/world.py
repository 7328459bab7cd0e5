"""The run as one value for compiled functions, a pointer to where the arrays are; its random numbers and events.

Numba passes a tuple of arrays by value, some two hundred words per call, and counts a reference to each array. Numba's
own mutable structure (`structref`) counts a reference at each access to a field. Here a call passes a plain pointer to
a block of words; the block has the address and the shape of each array. The block owns no array. Therefore functions
of a world are compiled without reference counting (`_nrt=False`, Numba's own option), and may not make arrays. Only
Python writes the block, before the call, so a function may read a word once. Compared with `structref`, a second of
processor time has 1.4 to 1.8 times as many events, on five cells of the transmission experiment.

An array of records gives records, whose fields are attributes. An array without dimensions is its one record.
"""

# Numba's extension interface has no types.
# mypy: disable-error-code="no-untyped-call, untyped-decorator"

from __future__ import annotations

import functools
import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numba as nb
import numpy as np
from numba.core import types
from numba.core.caching import IndexDataCacheFile
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    models,
    register_model,
    unbox,
)
from numba.np.arrayobj import get_itemsize, make_array, populate_array
from numba.np.numpy_support import from_dtype

if TYPE_CHECKING:
    from collections.abc import Callable

_F = TypeVar("_F", bound="Callable[..., object]")


def compiled(function: _F) -> _F:
    """Compile a function of a world or of a world's arrays, without reference counts and without new arrays.

    The machine code on disk is valid only for the present sources of the whole folder, because the machine code
    contains functions of other files. Numba itself checks only the function's own file for changes.
    """
    dispatcher: Any = nb.njit(cache=True, nogil=True, _nrt=False)(function)  # type: ignore[call-overload]
    cache: Any = dispatcher._cache  # noqa: SLF001 - Numba has no public name for the cache
    stamp = _folder_digest(Path(function.__code__.co_filename).parent)
    cache._cache_file = IndexDataCacheFile(cache.cache_path, cache._impl.filename_base, stamp)  # noqa: SLF001
    return dispatcher  # type: ignore[no-any-return]


@functools.cache
def _folder_digest(folder: Path) -> str:
    return hashlib.sha256(
        b"\0".join(path.read_bytes() for path in sorted(folder.glob("*.py")))
    ).hexdigest()


class World:
    """A `World` is an argument of compiled code: the fields of `Params` and `State`, tuples of contiguous arrays."""

    def __init__(self, *parts: NamedTuple) -> None:
        # Python holds the arrays here, and compiled code borrows them.
        self._arrays = {name: array for part in parts for name, array in part._asdict().items()}
        words = [word for a in self._arrays.values() for word in (a.ctypes.data, *a.shape)]
        self._block = np.array(words, np.int64)
        self.address = self._block.ctypes.data  #: Address of the block, for compiled code.
        fields = tuple((name, a.dtype, a.ndim) for name, a in self._arrays.items())
        # Numba looks for the type in this attribute, without a call of Python.
        self._numba_type_ = _world_type(fields)


@functools.cache
def _world_type(fields: tuple[tuple[str, Any, int], ...]) -> _WorldType:
    kinds = {}
    for name, dtype, dimensions in fields:
        item = from_dtype(dtype)
        kinds[name] = types.Array(item, dimensions, "C") if dimensions else item
    return _WorldType(kinds)


class _WorldType(types.Type):
    """A `_WorldType` is Numba's type of a world: its fields and the types of their contiguous arrays or records."""

    def __init__(self, fields: dict[str, Any]) -> None:
        self.fields = fields
        self.places: dict[str, int] = {}  #: Word of the block where each field begins.
        words = 0
        for name, kind in fields.items():
            self.places[name] = words
            words += 1 + getattr(kind, "ndim", 0)
        # The names of compiled functions contain the type's name, so the type's name is short; records have long names.
        text = repr([(name, str(kind)) for name, kind in fields.items()])
        super().__init__(f"World({hashlib.sha256(text.encode()).hexdigest()})")


register_model(_WorldType)(models.OpaqueModel)


@unbox(_WorldType)
def _unbox(_: Any, world: Any, c: Any) -> Any:
    address = c.pyapi.object_getattr_string(world, "address")
    pointer = c.pyapi.long_as_voidptr(address)
    c.pyapi.decref(address)
    return NativeValue(pointer)


@infer_getattr
class _Fields(AttributeTemplate):
    key = _WorldType

    def generic_resolve(self, world: Any, name: str) -> Any:  # type: ignore[override]
        return world.fields.get(name)


@lower_getattr_generic(_WorldType)
def _borrow(context: Any, builder: Any, world: Any, pointer: Any, name: str) -> Any:
    """Generate the code that makes an array of an address and a shape; the compiler removes unused parts."""
    kind, place = world.fields[name], world.places[name]
    word = context.get_value_type(types.intp)
    unchanging = builder.module.add_metadata([])

    def load(offset: int, llvm_type: Any) -> Any:
        base = builder.bitcast(pointer, llvm_type.as_pointer())
        index = context.get_constant(types.intp, place + offset)
        value = builder.load(builder.gep(base, [index], inbounds=True))
        value.set_metadata("invariant.load", unchanging)
        return value

    if isinstance(kind, types.Record):
        return load(0, context.get_value_type(kind))
    data = load(0, context.get_data_type(kind.dtype).as_pointer())
    shape = [load(1 + axis, word) for axis in range(kind.ndim)]
    strides = [context.get_constant(types.intp, get_itemsize(context, kind))]
    for length in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    array = make_array(kind)(context, builder)
    populate_array(
        array, data=data, shape=shape, strides=strides, itemsize=strides[-1], meminfo=None
    )
    return array._getvalue()  # noqa: SLF001 - the name that Numba gives its extensions


# --- Random numbers -----------------------------------------------------------------------------------------

GOLDEN = np.uint64(0x9E3779B97F4A7C15)  #: Step of SplitMix64's state.


@compiled
def scattered(z: Any) -> Any:
    """Return the output of SplitMix64 for a state, both of type uint64 (S. Vigna, prng.di.unimi.it)."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


# --- Events -------------------------------------------------------------------------------------------------

_ARGUMENT_BITS, _KIND_BITS = 20, 3


@compiled
def push(slots: Any, sizes: Any, time_ns: int, kind: int, argument: int) -> None:
    """Insert an event of a kind, with its time and argument, into the binary heap of a world.

    The earliest event comes first, and events of equal time come in the order of insertion. Events move into a gap
    instead of being swapped, which halves the memory accesses. The arguments are the arrays, because with the world as
    the argument a run takes 4 % longer.

    Raises:
        IndexError: The heap is full, because the caller's capacity is wrong.
    """
    i = sizes[0]
    if i >= slots.shape[0]:
        raise IndexError("event heap is full")
    key = (sizes[1] << (_ARGUMENT_BITS + _KIND_BITS)) | (argument << _KIND_BITS) | kind
    sizes[0] += 1
    sizes[1] += 1
    while i > 0:
        parent = (i - 1) >> 1
        if slots[parent, 0] <= time_ns:  # The newest of equal events is last.
            break
        slots[i, 0] = slots[parent, 0]
        slots[i, 1] = slots[parent, 1]
        i = parent
    slots[i, 0] = time_ns
    slots[i, 1] = key


@compiled
def pop(slots: Any, sizes: Any) -> tuple[int, int, int]:
    """Remove the earliest event and return its time, kind and argument; the heap must not be empty."""
    time_ns, key = slots[0, 0], slots[0, 1]
    sizes[0] -= 1
    last = sizes[0]
    late_t, late_k = slots[last, 0], slots[last, 1]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= last:
            break
        if child + 1 < last:
            a, b = slots[child, 0], slots[child + 1, 0]
            if b < a or (b == a and slots[child + 1, 1] < slots[child, 1]):
                child += 1
        t = slots[child, 0]
        if t > late_t or (t == late_t and slots[child, 1] > late_k):
            break
        slots[i, 0] = t
        slots[i, 1] = slots[child, 1]
        i = child
    slots[i, 0] = late_t
    slots[i, 1] = late_k
    return time_ns, key & 7, (key >> _KIND_BITS) & 0xFFFFF
