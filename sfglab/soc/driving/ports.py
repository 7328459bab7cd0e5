"""What a node of the driving application hears and says; refuses to know how topics deliver."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Ports"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Ports:
    """A node's topics, named as in the graph of paper C, Fig. 9.

    Attributes:
        node: Its name.
        subscribes: Topics that it hears.
        publishes: Topics that it says something on.
    """

    node: str
    subscribes: tuple[str, ...]
    publishes: tuple[str, ...]
