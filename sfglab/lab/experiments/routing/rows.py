"""The rows that the routing experiment writes into its log, one class a table; the policy's are `CheckRow`."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CallRow", "EndpointRow", "HeardRow", "LatchedRow", "PartyRow"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PartyRow:
    """Somebody who talks and listens.

    Attributes:
        party: Its name.
        domain: Its DDS domain; 0 is the global one.
        host: Where it runs.
    """

    party: str
    domain: int
    host: str


@dataclass(frozen=True, slots=True, kw_only=True)
class HeardRow:
    """What one party heard of another under one name.

    Attributes:
        name: ROS name.
        dds_topic: The same on the wire.
        source: Who published.
        hearer: Who subscribed.
        source_domain: Where the source is.
        hearer_domain: Where the hearer is.
        sent: Messages that the source published.
        received: Messages that arrived, repeated ones counted again.
        repeated: Messages that arrived more than once.
        disordered: Messages that arrived after a later one.
        restamped: Messages whose source time stamp is not the publisher's.
        missing: Messages missing between the first and the last that arrived.
        misnamed: Transforms whose frame does not bear its source's prefix.
        age_ms: Median time from publishing to receiving, milliseconds; NaN when nothing arrived.
    """

    name: str
    dds_topic: str
    source: str
    hearer: str
    source_domain: int
    hearer_domain: int
    sent: int
    received: int
    repeated: int
    disordered: int
    restamped: int
    missing: int
    misnamed: int
    age_ms: float


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointRow:
    """An endpoint that somebody in the global domain saw there and that is no party's own.

    Attributes:
        seen_by: Who saw it.
        dds_topic: Its topic on the wire.
        kind: ``publisher`` or ``subscription``.
        router: Which pair of domains its router serves; empty when it is no router's.
    """

    seen_by: str
    dds_topic: str
    kind: str
    router: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CallRow:
    """One call of a service.

    Attributes:
        name: ROS name.
        caller: Who called.
        server: Who serves.
        caller_domain: Where the caller is.
        server_domain: Where the server is.
        answered: Whether an answer of that server came.
    """

    name: str
    caller: str
    server: str
    caller_domain: int
    server_domain: int
    answered: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class LatchedRow:
    """What a party that subscribed static transforms late heard of one that had published them once.

    Attributes:
        source: Who published.
        hearer: Who came late.
        received: Messages that arrived.
    """

    source: str
    hearer: str
    received: int
