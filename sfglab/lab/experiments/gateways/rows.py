"""What the gateways experiment writes down, beside its checks."""

from __future__ import annotations

from dataclasses import dataclass

STAGES = ("all topics in software", "topics in hardware", "topics in hardware, gateways")
"""Fig. 8 b, c and d."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExplorationRow:
    """One exploration of the core's table, or of one derived from it."""

    software: str  #: Messages of each software publisher.
    hardware: str  #: Messages of each hardware publisher.
    subscribers: int  #: Hardware subscribers besides the core.
    calls: int  #: Calls to the delegate that may wait.
    echoes: bool  #: Whether both topics return the core's own messages.
    port_messages: int  #: Whole messages that the core's port can store.
    worlds: int  #: Reachable moments.
    steps: int  #: Steps between them.
    depth: int  #: Length of the longest of the shortest ways.
    states: int  #: States of the core that occurred.
    violation: str  #: What was violated; empty: nothing.


@dataclass(frozen=True, slots=True, kw_only=True)
class StageRow:
    """One stage of the mapping of Fig. 8."""

    stage: str  #: One of `STAGES`.
    publications: int  #: Publishing edges across the boundary.
    subscriptions: int  #: Subscribing edges across the boundary.
    carriages: float  #: How often one message of every topic is carried across, together.
    mapped: str  #: Topics and what they are mapped to.
    left: str  #: The edges that are left across the boundary.
