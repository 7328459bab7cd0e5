"""Messages with random values in every field, for tests of bytes."""

import numpy as np

from sfglab.messages.store import fields_of, type_store


def _scalar(rng, type_):
    if type_.is_message:
        return random_message(rng, type_.base)
    if type_.base == "string":
        return "".join(rng.choice(list("abc äß字"), size=rng.integers(0, 9)))
    if type_.base == "bool":
        return bool(rng.integers(2))
    if type_.base.startswith("float"):
        return float(np.float32(rng.normal()))
    limits = np.iinfo(type_.dtype)
    return int(rng.integers(limits.min, limits.max, endpoint=True, dtype=limits.dtype))


def _value(rng, type_):
    if not type_.is_list:
        return _scalar(rng, type_)
    most = min(type_.length or 6, 6)
    count = type_.length if type_.is_array else int(rng.integers(0, most))
    if not type_.is_number:
        return [_scalar(rng, type_) for _ in range(count)]
    if type_.base == "bool":
        return rng.integers(0, 2, count).astype(bool)
    # Any bytes are a number, NaN included.
    return np.frombuffer(rng.bytes(count * type_.dtype.itemsize), type_.dtype)


def random_message(rng, name):
    types = fields_of(name).values()
    # By position: a field whose name is a keyword of Python has another name in the class.
    return type_store().types[name](*(_value(rng, type_) for type_ in types))
