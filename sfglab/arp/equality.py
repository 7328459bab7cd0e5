"""When two sensor values are the same value: paper B, sections 2.2 and 2.3, asks for "the same value in a row".

Works on scalars, strings, NumPy arrays and ROS messages, which are compared field by field. Pure.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

Equality = Callable[[Any, Any], bool]


def exactly_equal(first: Any, second: Any, *, ignore: frozenset[str] = frozenset()) -> bool:
    """Return whether two values are the same to the bit, a NaN being the same as a NaN.

    Args:
        first: A scalar, string, array, or message.
        second: The other one.
        ignore: Names of message fields that do not count, such as ``header`` (its stamp always differs).
    """
    return _equal(first, second, 0.0, ignore)


def nearly_equal(tolerance: float, *, ignore: frozenset[str] = frozenset()) -> Equality:
    """Return a comparison that takes numbers for equal that differ by no more than a tolerance.

    It compares with the last value *sent*, so a slow drift is sent once it has left the tolerance; it cannot
    creep away unseen. Texts and truth values stay exact.

    Args:
        tolerance: Largest difference that does not count, in the value's own unit; at least 0.
        ignore: Names of message fields that do not count.

    Raises:
        ValueError: The tolerance is negative or no number.
    """
    if not tolerance >= 0.0:
        raise ValueError(f"cache tolerance: given {tolerance}, allowed are 0 and more")
    return partial(_equal, tolerance=tolerance, ignore=ignore)


def _equal(first: Any, second: Any, tolerance: float, ignore: frozenset[str]) -> bool:
    if type(first) is not type(second):
        return _is_number(first) and _is_number(second) and _numbers_equal(first, second, tolerance)
    if dataclasses.is_dataclass(first):
        fields = (f.name for f in dataclasses.fields(first) if f.name not in ignore)
        return all(_equal(getattr(first, n), getattr(second, n), tolerance, ignore) for n in fields)
    if isinstance(first, (list, tuple)):
        return len(first) == len(second) and all(
            _equal(a, b, tolerance, ignore) for a, b in zip(first, second, strict=True)
        )
    if isinstance(first, np.ndarray):
        return (
            first.shape == second.shape
            and first.dtype == second.dtype
            and _arrays_equal(first, second, tolerance)
        )
    if _is_number(first):
        return _numbers_equal(first, second, tolerance)
    return bool(first == second)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def _numbers_equal(first: Any, second: Any, tolerance: float) -> bool:
    # Infinities are equal to themselves, and their difference is no number.
    return bool(first == second or abs(first - second) <= tolerance or (np.isnan(first) and np.isnan(second)))


def _arrays_equal(first: Any, second: Any, tolerance: float) -> bool:
    if first.dtype.kind not in "iuf" or tolerance == 0.0:
        return bool(np.array_equal(first, second, equal_nan=first.dtype.kind == "f"))
    # Unsigned differences would wrap around.
    return bool(
        np.allclose(
            first.astype(np.float64), second.astype(np.float64), rtol=0.0, atol=tolerance, equal_nan=True
        )
    )
