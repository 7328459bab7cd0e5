"""Screening of what remote agents say of themselves, in a domain where anybody can publish anything.

Judged before anybody uses it: heartbeats (`Screen`) and descriptions (`admitted`). Pure.
"""

from __future__ import annotations

import functools
import math
from collections import OrderedDict
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, Any

from sfglab.fields import between, check_bounds
from sfglab.fleet.status.description import MAX_TEXT, DescriptionError, StreamDescription
from sfglab.fleet.status.heartbeat import (
    MAX_PERIOD_S,
    MIN_PERIOD_S,
    Heartbeat,
    Phase,
    metadata_service,
)
from sfglab.names import FqnError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

#: Most streams of one agent: each costs whoever decodes an endpoint before anybody wants it.
MAX_STREAMS = 128
MAX_ENTRIES = 64  #: Most sensors, codecs in hardware and pieces of software of one agent, of each.
_MAX_VERSION_LENGTH = 128
_PHASES = frozenset(int(phase) for phase in Phase)


class Refusal(Enum):
    """Why a heartbeat does not count."""

    #: It is no heartbeat: bytes, name, phase, period or version are not allowed.
    MALFORMED = "malformed"
    FLOOD = "flood"  #: There are more than a fleet would send.
    OWN = "own"  #: It is the discoverer's own agent's.
    SPOOFED = "spoofed"  #: It bears the discoverer's own agent's name and comes from somebody else.
    STALE = "stale"  #: It is from a start of the agent before the one that is there.
    CLAIMED = "claimed"  #: It claims a start, or a revision, that has not answered, again.
    FULL = "full"  #: It is from an agent for which there is no place.


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """How much a discoverer takes in. A fleet in start-up sends one heartbeat a second and agent."""

    #: Remote agents that are kept track of, at most 900: consumers that come late hear of each.
    max_agents: int = between(500, 1, 900)
    #: Heartbeats per second that one publisher may send for long.
    beats_per_s: float = between(25.0, without=(0, math.inf))
    #: Heartbeats that one publisher may send at once.
    burst: int = between(50, without=(0, math.inf))
    #: The same for all publishers together.
    total_per_s: float = between(1000.0, without=(0, math.inf))
    #: The same for all publishers together.
    total_burst: int = between(5000, without=(0, math.inf))
    #: Longest description, serialized.
    max_metadata_bytes: int = between(65_536, without=(0, math.inf))

    def __post_init__(self) -> None:
        check_bounds(self, "discovery, ")


class Bucket:
    """A token bucket: `rate_per_s` for long, `burst` at once."""

    __slots__ = ("_burst", "_rate_per_ns", "_tokens", "_updated_ns")

    def __init__(self, rate_per_s: float, burst: int, now_ns: int) -> None:
        self._rate_per_ns = rate_per_s / 1e9
        self._burst = float(burst)
        self._tokens = float(burst)
        self._updated_ns = now_ns

    def take(self, now_ns: int) -> bool:
        """Return whether one more is within the rate, and count it then."""
        gained = max(0, now_ns - self._updated_ns) * self._rate_per_ns
        self._tokens = min(self._burst, self._tokens + gained)
        self._updated_ns = max(now_ns, self._updated_ns)
        if self._tokens < 1:
            return False
        self._tokens -= 1
        return True


class Rates:
    """The rates of all publishers: each its own, and all together."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._total = Bucket(limits.total_per_s, limits.total_burst, 0)
        self._buckets: OrderedDict[bytes, Bucket] = OrderedDict()

    def take(self, publisher_gid: bytes, now_ns: int) -> bool:
        """Return whether one more of a publisher is within the rates, and count it then."""
        # One publisher's flood must not take the others' share, so its own bucket comes first.
        return self._bucket(publisher_gid, now_ns).take(now_ns) and self._total.take(now_ns)

    def _bucket(self, publisher_gid: bytes, now_ns: int) -> Bucket:
        bucket = self._buckets.get(publisher_gid)
        if bucket is None:
            bucket = Bucket(self._limits.beats_per_s, self._limits.burst, now_ns)
            self._buckets[publisher_gid] = bucket
            if len(self._buckets) > 2 * self._limits.max_agents:
                self._buckets.popitem(last=False)
        self._buckets.move_to_end(publisher_gid)
        return bucket


class Screen:
    """The checks by a discoverer's agent that need nothing but the heartbeat, who published it, and when."""

    def __init__(self, agent: str, limits: Limits) -> None:
        self._agent = agent
        self._rates = Rates(limits)
        self._own: tuple[int, bytes] | None = None  # its last incarnation and publisher

    def check(self, heartbeat: Heartbeat, publisher_gid: bytes, *, now_ns: int) -> Refusal | None:
        """Return why a heartbeat of a publisher does not count, or None if it does."""
        if not self._rates.take(publisher_gid, now_ns):
            return Refusal.FLOOD
        if not _well_formed(heartbeat):
            return Refusal.MALFORMED
        if heartbeat.agent == self._agent:
            return self._check_own(heartbeat, publisher_gid)
        return None

    def _check_own(self, heartbeat: Heartbeat, publisher_gid: bytes) -> Refusal:
        """Tell our agent, the latest to start, from another of its name, which is spoofed while it lives."""
        if self._own is None or heartbeat.incarnation > self._own[0]:
            self._own = heartbeat.incarnation, publisher_gid
        return Refusal.OWN if publisher_gid == self._own[1] else Refusal.SPOOFED


def _well_formed(heartbeat: Heartbeat) -> bool:
    return (
        len(heartbeat.agent) <= MAX_TEXT
        and _can_be_asked(heartbeat.agent)
        and heartbeat.phase in _PHASES
        and MIN_PERIOD_S <= heartbeat.period_s <= MAX_PERIOD_S
        and len(heartbeat.version) <= _MAX_VERSION_LENGTH
    )


@functools.lru_cache(maxsize=1024)
def _can_be_asked(agent: str) -> bool:
    """Return whether the schema has a name for this agent's metadata service; every heartbeat asks."""
    try:
        metadata_service(agent)
    except FqnError:
        return False
    return True


def admitted(metadata: Any) -> tuple[Any, tuple[DescriptionError, ...]]:
    """Return what may be used of an ``AgentMetadata``, the first of each name, and what is wrong with it."""
    refused: list[DescriptionError] = []
    taken: list[str] = []
    sensors: dict[str, Any] = {}
    for sensor in metadata.sensors:
        if (wrong := _wrong_sensor(sensor, sensors)) is not None:
            refused.append(wrong)
            continue
        streams = []
        for stream in sensor.streams:
            if (wrong := _wrong_stream(metadata.agent, stream, taken)) is None:
                taken += [stream.topic, stream.decoded_topic or stream.topic]
                streams.append(stream)
            else:
                refused.append(wrong)
        sensors[sensor.name] = replace(sensor, streams=streams)
    lists = {
        name: _lines(getattr(metadata, name), name, refused)
        for name in ("accelerators", "software")
    }
    return replace(metadata, sensors=list(sensors.values()), **lists), tuple(refused)


def _wrong_sensor(sensor: Any, known: Mapping[str, Any]) -> DescriptionError | None:
    names = (sensor.name, sensor.model)
    if (
        sensor.name not in known
        and len(known) < MAX_ENTRIES
        and all(len(name) <= MAX_TEXT for name in names)
    ):
        return None
    why = f"allowed are {MAX_ENTRIES} whose names differ, of {MAX_TEXT} characters"
    return DescriptionError(f"sensor {sensor.name[:MAX_TEXT]!r}", why)


def _wrong_stream(agent: str, message: Any, taken: Sequence[str]) -> DescriptionError | None:
    stream = StreamDescription.of(message)
    try:
        stream.check(agent)
    except DescriptionError as error:
        return error
    if stream.topic in taken or stream.decoded_topic in taken or len(taken) >= 2 * MAX_STREAMS:
        return DescriptionError(
            f"stream {stream.topic!r}", f"allowed are {MAX_STREAMS}, whose topics differ"
        )
    return None


def _lines(given: Sequence[str], name: str, refused: list[DescriptionError]) -> list[str]:
    lines = [entry for entry in given if len(entry) <= MAX_TEXT and entry.isprintable()][
        :MAX_ENTRIES
    ]
    if len(lines) < len(given):
        why = f"allowed are {MAX_ENTRIES} lines of {MAX_TEXT} characters, {len(given) - len(lines)} are not"
        refused.append(DescriptionError(name, why))
    return lines
