"""The rows that the routing experiment writes into its log, one class a table; the policy's are `CheckRow`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class PartyRow:
    """Somebody who talks and listens."""

    party: str  #: Its name.
    domain: int  #: Its DDS domain; 0 is the global one.
    host: str  #: Where it runs.


@dataclass(frozen=True, slots=True, kw_only=True)
class HeardRow:
    """What one party heard of another under one name."""

    name: str  #: ROS name.
    dds_topic: str  #: The same on the wire.
    source: str  #: Who published.
    hearer: str  #: Who subscribed.
    source_domain: int  #: Where the source is.
    hearer_domain: int  #: Where the hearer is.
    sent: int  #: Messages that the source published.
    received: int  #: Messages that arrived, repeated ones counted again.
    repeated: int  #: Messages that arrived more than once.
    disordered: int  #: Messages that arrived after a later one.
    restamped: int  #: Messages whose source time stamp is not the publisher's.
    missing: int  #: Messages missing between the first and the last that arrived.
    misnamed: int  #: Transforms whose frame does not bear its source's prefix.
    age_ms: float  #: Median time from publishing to receiving, milliseconds; NaN when nothing arrived.


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointRow:
    """An endpoint that somebody in the global domain saw there and that is no party's own."""

    seen_by: str  #: Who saw it.
    dds_topic: str  #: Its topic on the wire.
    kind: str  #: ``publisher`` or ``subscription``.
    router: str  #: Which pair of domains its router serves; empty when it is no router's.


@dataclass(frozen=True, slots=True, kw_only=True)
class CallRow:
    """One call of a service."""

    name: str  #: ROS name.
    caller: str  #: Who called.
    server: str  #: Who serves.
    caller_domain: int  #: Where the caller is.
    server_domain: int  #: Where the server is.
    answered: bool  #: Whether an answer of that server came.


@dataclass(frozen=True, slots=True, kw_only=True)
class LatchedRow:
    """What a party that subscribed static transforms late heard of one that had published them once."""

    source: str  #: Who published.
    hearer: str  #: Who came late.
    received: int  #: Messages that arrived.
