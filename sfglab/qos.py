"""Quality-of-service profiles in the terms of rclpy, and the rules by which two profiles match."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from sfglab.errors import InvalidValueError
from sfglab.tables import Shown


class Reliability(Enum):
    """DDS RELIABILITY (DDS 1.4, clause 2.2.3.14), the weaker kind first."""

    BEST_EFFORT = "best_effort"
    RELIABLE = "reliable"


class Durability(Enum):
    """DDS DURABILITY, the two kinds that ROS 2 uses (DDS 1.4, clause 2.2.3.4), the weaker first."""

    VOLATILE = "volatile"
    TRANSIENT_LOCAL = "transient_local"


class History(Enum):
    """DDS HISTORY (DDS 1.4, clause 2.2.3.18)."""

    KEEP_LAST = "keep_last"
    KEEP_ALL = "keep_all"


class Liveliness(Enum):
    """DDS LIVELINESS, the two kinds that ROS 2 uses (DDS 1.4, clause 2.2.3.11), the weaker first."""

    AUTOMATIC = "automatic"
    MANUAL_BY_TOPIC = "manual_by_topic"


@dataclass(frozen=True, slots=True, kw_only=True)
class QoSProfile(Shown):
    """QoS of one endpoint; the defaults are rmw's default profile (rmw 7.5, qos_profiles.h).

    Raises:
        InvalidValueError: The depth is below 1, or a time is not positive.
    """

    reliability: Reliability = Reliability.RELIABLE  #: Whether lost samples are retransmitted.
    #: Whether late joiners receive the writer's history.
    durability: Durability = Durability.VOLATILE
    #: Whether the history is bounded by `depth` (KEEP_LAST) or not (KEEP_ALL).
    history: History = History.KEEP_LAST
    depth: int = 10  #: Samples kept with KEEP_LAST, at least 1; ignored with KEEP_ALL.
    #: Longest agreed time between samples, ns; None is infinite.
    deadline_ns: int | None = None
    #: Age after which a sample is dropped, ns; None is infinite.
    lifespan_ns: int | None = None
    #: Source of liveliness assertions: process or samples.
    liveliness: Liveliness = Liveliness.AUTOMATIC
    #: Time without an assertion after which a writer is lost, ns; None is infinite.
    lease_ns: int | None = None

    def __post_init__(self) -> None:
        if self.depth < 1:
            raise InvalidValueError("QoS depth", self.depth, "a whole number from 1")
        for name in _TIMES:
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise InvalidValueError(
                    f"QoS {name}", value, "a positive number of nanoseconds, or None"
                )

    def __repr__(self) -> str:
        parts = [self.reliability.value, self.durability.value, self.history.value]
        if self.history is History.KEEP_LAST:
            parts[-1] += f" {self.depth}"
        if self.liveliness is not Liveliness.AUTOMATIC:
            parts.append(self.liveliness.value)
        for name in _TIMES:
            value = getattr(self, name)
            if value is not None:
                parts.append(f"{name.removesuffix('_ns')} {value / 1e6:g} ms")
        return f"<QoS {', '.join(parts)}>"


_TIMES = ("deadline_ns", "lifespan_ns", "lease_ns")
DEFAULT = QoSProfile()
SENSOR_DATA = QoSProfile(reliability=Reliability.BEST_EFFORT, depth=5)
COMPRESSED_STREAM = QoSProfile(reliability=Reliability.BEST_EFFORT, depth=60)
"""Best effort, as in paper A, section 4.3; the depth is two GOPs, because a lost P frame spoils the rest of its GOP."""

SERVICES = QoSProfile(depth=10)
PARAMETER_EVENTS = QoSProfile(depth=1000)
LATCHED = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=1)


def incompatibilities(*, offered: QoSProfile, requested: QoSProfile) -> tuple[str, ...]:
    """Return the reasons why a request does not match an offer; empty if it does (DDS 1.4, clause 2.2.3)."""
    reasons = []
    for name in ("reliability", "durability", "liveliness"):
        asked, given = getattr(requested, name), getattr(offered, name)
        kinds = list(type(asked).__members__)
        if kinds.index(asked.name) > kinds.index(given.name):
            reasons.append(
                f"{name}: the reader requests {asked.name}, the writer offers {given.name}"
            )
    for name in ("deadline", "lease"):
        asked, given = getattr(requested, f"{name}_ns"), getattr(offered, f"{name}_ns")
        if asked is not None and (given is None or given > asked):
            reasons.append(f"{name}: the reader requests {asked} ns, the writer offers {given}")
    return tuple(reasons)
