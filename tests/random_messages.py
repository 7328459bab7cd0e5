"""Messages with random values in every field, for tests of bytes."""

import numpy as np
from rosbags.interfaces import Nodetype

from sfglab.messages.store import numpy_dtype, type_store


def _scalar(rng, base):
    if base == "string":
        return "".join(rng.choice(list("abc äß字"), size=rng.integers(0, 9)))
    if base == "bool":
        return bool(rng.integers(2))
    if base.startswith("float"):
        return float(np.float32(rng.normal()))
    limits = np.iinfo(numpy_dtype(base))
    return int(rng.integers(limits.min, limits.max, endpoint=True, dtype=limits.dtype))


def _array(rng, base, count):
    if base == "string":
        return [_scalar(rng, base) for _ in range(count)]
    if base == "bool":
        return rng.integers(0, 2, count).astype(bool)
    dtype = numpy_dtype(base)
    size = count * dtype.itemsize
    # Any bytes are a number, NaN included.
    return np.frombuffer(rng.bytes(size), dtype)


def _value(rng, desc):
    kind, inner = desc
    if kind == Nodetype.BASE:
        return _scalar(rng, inner[0])
    if kind == Nodetype.NAME:
        return random_message(rng, inner)
    (element_kind, element), length = inner
    count = length if kind == Nodetype.ARRAY else int(rng.integers(0, min(length or 6, 6)))
    if element_kind == Nodetype.NAME:
        return [random_message(rng, element) for _ in range(count)]
    return _array(rng, element[0], count)


def random_message(rng, name):
    store = type_store()
    fields = store.get_msgdef(name).fields
    return store.types[name](**{field: _value(rng, desc) for field, desc in fields})
