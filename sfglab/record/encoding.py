"""Metadata and QoS profiles as the plain strings that MCAP keeps.

Knows JSON and rosbag2's YAML. Refuses to know files.
"""

from __future__ import annotations

import dataclasses
import json
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.qos import Durability, History, Reliability
from sfglab.record.errors import LogInputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from sfglab.qos import QoSProfile


# rmw/types.h; rosbag2 (Humble, metadata version 5) writes the numbers.
_HISTORY = {History.KEEP_LAST: 1, History.KEEP_ALL: 2}
_RELIABILITY = {Reliability.RELIABLE: 1, Reliability.BEST_EFFORT: 2}
_DURABILITY = {Durability.TRANSIENT_LOCAL: 1, Durability.VOLATILE: 2}
_LIVELINESS_AUTOMATIC = 1
_INFINITE_NS = 2**63 - 1


def _duration_yaml(duration_ns: int | None) -> str:
    sec, nsec = divmod(_INFINITE_NS if duration_ns is None else duration_ns, 1_000_000_000)
    return f"\n    sec: {sec}\n    nsec: {nsec}"


def offered_qos_profiles(qos: QoSProfile) -> str:
    """Return a profile as rosbag2 records it with a topic (rosbag2_transport, qos.cpp).

    Args:
        qos: The profile that the topic's writer offers.

    Returns:
        A YAML list with one entry; policies that sfglab does not model have ROS 2's defaults.
    """
    return (
        f"- history: {_HISTORY[qos.history]}\n"
        f"  depth: {qos.depth}\n"
        f"  reliability: {_RELIABILITY[qos.reliability]}\n"
        f"  durability: {_DURABILITY[qos.durability]}\n"
        f"  deadline:{_duration_yaml(qos.deadline_ns)}\n"
        f"  lifespan:{_duration_yaml(qos.lifespan_ns)}\n"
        f"  liveliness: {_LIVELINESS_AUTOMATIC}\n"
        f"  liveliness_lease_duration:{_duration_yaml(None)}\n"
        "  avoid_ros_namespace_conventions: false\n"
    )


def _plain(value: Any) -> Any:
    """Return what JSON can hold instead of a value that it does not know."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no form in JSON")


def _is_literal(text: str) -> bool:
    """Return whether text would be read back as something else than itself."""
    try:
        text.encode()
        json.loads(text)
    except UnicodeEncodeError:
        return True
    except ValueError:
        return False
    return True


def strings_from_values(name: str, values: Mapping[str, Any]) -> dict[str, str]:
    """Return a mapping whose values are strings: text as it is, everything else as JSON.

    Text that looks like JSON is quoted, so that `values_from_strings` returns what went in.

    Args:
        name: What the mapping is called, for the error.
        values: Text, numbers, None, lists, mappings, enums, dataclasses and NumPy values, nested as you like.

    Returns:
        The strings, in the same order. Tuples and arrays become lists, dataclasses mappings.

    Raises:
        LogInputError: A key is not text, or a value has no form in JSON.
    """
    strings = {}
    for key, value in values.items():
        if not isinstance(key, str):
            raise LogInputError(f"metadata {name!r}: given the key {key!r}, allowed is text")
        is_text = isinstance(value, str) and not isinstance(value, Enum) and not _is_literal(value)
        try:
            strings[key] = value if is_text else json.dumps(value, default=_plain)
        except (TypeError, ValueError) as exc:
            raise LogInputError(f"metadata {name!r}: {key!r} cannot be kept: {exc}") from exc
    return strings


def values_from_strings(strings: Mapping[str, str]) -> dict[str, Any]:
    """Return what `strings_from_values` was given: JSON where it is JSON, text elsewhere.

    Args:
        strings: A metadata record of any log.

    Returns:
        Values of JSON's types, in the same order.
    """
    return {key: json.loads(text) if _is_literal(text) else text for key, text in strings.items()}
