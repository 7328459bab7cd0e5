"""What a node of the driving application hears and says; refuses to know how topics deliver."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Ports:
    """A node's topics, named as in the graph of paper C, Fig. 9."""

    node: str  #: Its name.
    subscribes: tuple[str, ...]  #: Topics that it hears.
    publishes: tuple[str, ...]  #: Topics that it says something on.
