"""ROS time stamps and nanoseconds since the epoch.

Knows the two fields of `builtin_interfaces/msg/Time`. Refuses to know what time it is.
"""

from __future__ import annotations

from typing import Any

from sfglab.errors import SfglabError
from sfglab.messages.store import message_type

_NS_PER_S = 1_000_000_000
_SECONDS = range(-(2**31), 2**31)


class StampError(SfglabError, ValueError):
    """A time that `builtin_interfaces/msg/Time` cannot hold.

    Attributes:
        stamp_ns: What was given, in nanoseconds.
    """

    def __init__(self, stamp_ns: int) -> None:
        self.stamp_ns = stamp_ns
        super().__init__(
            f"stamp: given {stamp_ns} ns, allowed are {_SECONDS.start} to {_SECONDS.stop} s (int32)"
        )


def stamp_from_ns(stamp_ns: int) -> Any:
    """Return a `builtin_interfaces/msg/Time`.

    Args:
        stamp_ns: Nanoseconds since the epoch; negative ones get negative seconds and positive nanoseconds.

    Returns:
        The stamp, exact to the nanosecond.

    Raises:
        StampError: The seconds do not fit into 32 bits.
    """
    sec, nanosec = divmod(int(stamp_ns), _NS_PER_S)
    if sec not in _SECONDS:
        raise StampError(stamp_ns)
    return message_type("builtin_interfaces/msg/Time")(sec=sec, nanosec=nanosec)


def ns_from_stamp(stamp: Any) -> int:
    """Return a stamp's nanoseconds since the epoch.

    Args:
        stamp: Anything with `sec` and `nanosec`, such as a `builtin_interfaces/msg/Time` of any library.

    Returns:
        Nanoseconds, exact.
    """
    return int(stamp.sec) * _NS_PER_S + int(stamp.nanosec)
