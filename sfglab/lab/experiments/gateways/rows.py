"""What the gateways experiment writes down, beside its checks."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["STAGES", "ExplorationRow", "StageRow"]

STAGES = ("all topics in software", "topics in hardware", "topics in hardware, gateways")
"""Fig. 8 b, c and d."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExplorationRow:
    """One exploration of the core's table, or of one derived from it.

    Attributes:
        software: Messages of each software publisher.
        hardware: Messages of each hardware publisher.
        subscribers: Hardware subscribers besides the core.
        calls: Calls to the delegate that may wait.
        echoes: Whether both topics return the core's own messages.
        port_messages: Whole messages that the core's port can store.
        worlds: Reachable moments.
        steps: Steps between them.
        depth: Length of the longest of the shortest ways.
        states: States of the core that occurred.
        violation: What was violated; empty: nothing.
    """

    software: str
    hardware: str
    subscribers: int
    calls: int
    echoes: bool
    port_messages: int
    worlds: int
    steps: int
    depth: int
    states: int
    violation: str


@dataclass(frozen=True, slots=True, kw_only=True)
class StageRow:
    """One stage of the mapping of Fig. 8.

    Attributes:
        stage: One of `STAGES`.
        publications: Publishing edges across the boundary.
        subscriptions: Subscribing edges across the boundary.
        carriages: How often one message of every topic is carried across, together.
        mapped: Topics and what they are mapped to.
        left: The edges that are left across the boundary.
    """

    stage: str
    publications: int
    subscriptions: int
    carriages: float
    mapped: str
    left: str
