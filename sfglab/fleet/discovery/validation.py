"""Validation of everything that remote agents send: rates, heartbeats and descriptions.

Any participant of the global domain can publish anything. Therefore this module checks each heartbeat and each
description before other code uses it. It has neither endpoints nor a clock.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from enum import Enum
from typing import TYPE_CHECKING, Any

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

#: Maximum number of streams of one agent: a decoder creates an endpoint for each of them.
MAX_STREAMS = 128
#: Maximum number of sensors, of hardware codecs and of software entries per agent.
MAX_ENTRIES = 64
_MAX_VERSION_LENGTH = 128


class Refusal(Enum):
    """Reason why a heartbeat or a published description is dropped."""

    #: The bytes, the name, the phase, the period or the version are invalid.
    MALFORMED = "malformed"
    FLOOD = "flood"  #: The rate of the messages exceeds the limit.
    OWN = "own"  #: The message is from the discoverer's own agent.
    SPOOFED = "spoofed"  #: The message contains the own agent's name and is from another publisher.
    STALE = "stale"  #: The message is from an earlier incarnation than the present one.
    #: The message claims again an incarnation or revision that did not answer a query.
    CLAIMED = "claimed"
    FULL = "full"  #: The table of agents is full.


# Rates of heartbeats, and of descriptions; an agent that starts sends one heartbeat per second.
BEATS_PER_S = 25.0  #: Messages per second and publisher, on average.
BURST = 50  #: Messages of one publisher at once.
TOTAL_PER_S = 1000.0  #: Messages per second of all publishers, on average.
TOTAL_BURST = 5000  #: Messages of all publishers at once.
MAX_METADATA_BYTES = 65_536  #: Maximum size of a serialized description.


class TokenBucket:
    """A rate limit: `rate_per_s` on average, `burst` at once."""

    __slots__ = ("_burst", "_rate_per_ns", "_tokens", "_updated_ns")

    def __init__(self, rate_per_s: float, burst: int, now_ns: int) -> None:
        self._rate_per_ns = rate_per_s / 1e9
        self._burst = float(burst)
        self._tokens = float(burst)
        self._updated_ns = now_ns

    def take(self, now_ns: int) -> bool:
        """Count one event and return True if the rate allows it, else return False."""
        gained = max(0, now_ns - self._updated_ns) * self._rate_per_ns
        self._tokens = min(self._burst, self._tokens + gained)
        self._updated_ns = max(now_ns, self._updated_ns)
        if self._tokens < 1:
            return False
        self._tokens -= 1
        return True


class Rates:
    """Rate limits of the messages on one topic: of each publisher, and of all publishers together.

    The class remembers the most recent publishers, at most `max_publishers` of them.
    """

    def __init__(self, max_publishers: int) -> None:
        self._max_publishers = max_publishers
        self._total = TokenBucket(TOTAL_PER_S, TOTAL_BURST, 0)
        self._buckets: dict[bytes, TokenBucket] = {}  # the most recent publisher last

    def take(self, publisher_gid: bytes, now_ns: int) -> bool:
        """Count one message of a publisher and return True if the rates allow it, else return False."""
        bucket = self._buckets.pop(publisher_gid, None)
        if bucket is None:
            bucket = TokenBucket(BEATS_PER_S, BURST, now_ns)
        self._buckets[publisher_gid] = bucket
        if len(self._buckets) > self._max_publishers:
            del self._buckets[next(iter(self._buckets))]
        # The publisher's own limit comes first, so that its flood does not use up the rate of the others.
        return bucket.take(now_ns) and self._total.take(now_ns)


def is_valid_heartbeat(heartbeat: Heartbeat) -> bool:
    """Return whether all values of a heartbeat are in range; also for an ``AgentHeartbeat`` message."""
    return (
        len(heartbeat.agent) <= MAX_TEXT
        and _is_agent_name(heartbeat.agent)
        and heartbeat.phase in (Phase.STARTUP, Phase.STEADY)
        and MIN_PERIOD_S <= heartbeat.period_s <= MAX_PERIOD_S
        and len(heartbeat.version) <= _MAX_VERSION_LENGTH
    )


@functools.lru_cache(maxsize=1024)
def _is_agent_name(agent: str) -> bool:
    """Return whether the schema has a metadata service for this name. The cache serves each heartbeat."""
    try:
        metadata_service(agent)
    except FqnError:
        return False
    return True


def validated_metadata(metadata: Any) -> tuple[Any, tuple[DescriptionError, ...]]:
    """Return the valid parts of an ``AgentMetadata``, and one error per removed part.

    If two sensors have one name, or two streams one topic, the first one is valid.
    """
    errors: list[DescriptionError] = []
    topics: list[str] = []
    sensors: dict[str, Any] = {}
    for sensor in metadata.sensors:
        try:
            _check_sensor(sensor, sensors)
        except DescriptionError as error:
            errors.append(error)
            continue
        streams = []
        for stream in sensor.streams:
            try:
                _check_stream(metadata.agent, stream, topics)
            except DescriptionError as error:
                errors.append(error)
                continue
            topics += [stream.topic, stream.decoded_topic or stream.topic]
            streams.append(stream)
        sensors[sensor.name] = replace(sensor, streams=streams)
    accelerators = _valid_lines("accelerators", metadata.accelerators, errors)
    software = _valid_lines("software", metadata.software, errors)
    valid = replace(
        metadata, sensors=list(sensors.values()), accelerators=accelerators, software=software
    )
    return valid, tuple(errors)


def _check_sensor(sensor: Any, known: Mapping[str, Any]) -> None:
    is_short = max(len(sensor.name), len(sensor.model)) <= MAX_TEXT
    if sensor.name in known or len(known) >= MAX_ENTRIES or not is_short:
        allowed = f"allowed: up to {MAX_ENTRIES} sensors with different names of up to {MAX_TEXT} characters"
        raise DescriptionError(f"sensor {sensor.name[:MAX_TEXT]!r}", allowed)


def _check_stream(agent: str, stream: Any, topics: Sequence[str]) -> None:
    """Check a stream, given the two topics of each stream before it."""
    StreamDescription.of(stream).check(agent)
    is_known = stream.topic in topics or stream.decoded_topic in topics
    if is_known or len(topics) >= 2 * MAX_STREAMS:
        allowed = f"allowed: up to {MAX_STREAMS} streams with different topics"
        raise DescriptionError(f"stream {stream.topic!r}", allowed)


def _valid_lines(name: str, lines: Sequence[str], errors: list[DescriptionError]) -> list[str]:
    valid = [line for line in lines if len(line) <= MAX_TEXT and line.isprintable()]
    valid = valid[:MAX_ENTRIES]
    if len(valid) < len(lines):
        allowed = f"allowed: up to {MAX_ENTRIES} lines of up to {MAX_TEXT} characters"
        errors.append(DescriptionError(name, f"{allowed}, {len(lines) - len(valid)} are not"))
    return valid
