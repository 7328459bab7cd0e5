"""What crosses between an agent's domain and the global one: paper A, section 4.1, Eq. 1 and Table 1.

The one place that decides it. The in-process router asks it for every endpoint; the configurations of other
routers are generated from its rules. Pure: knows names and directions, refuses to know domain ids and samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from fnmatch import fnmatchcase

from sfglab.names import ResourceKind, dds_names


class Side(Enum):
    """One of the two domains that a router joins."""

    LOCAL = "local"
    """The agent's own domain, D_i in the paper."""
    GLOBAL = "global"
    """The domain that all agents share, D_0 in the paper."""

    @property
    def other(self) -> Side:
        """The side across the border."""
        return Side.GLOBAL if self is Side.LOCAL else Side.LOCAL


class Direction(Enum):
    """Which way a sample crosses the border."""

    OUTWARD = "outward"
    """From the agent's domain into the global one."""
    INWARD = "inward"
    """From the global domain into the agent's."""

    @property
    def source(self) -> Side:
        """The side that a sample comes from."""
        return Side.LOCAL if self is Direction.OUTWARD else Side.GLOBAL

    @property
    def target(self) -> Side:
        """The side that a sample goes to."""
        return self.source.other


class Crossing(Enum):
    """How much of a ROS name, which may be several DDS topics, crosses."""

    NONE = "none"
    HALF = "half"
    """Only some of its DDS topics: a service whose requests pass and whose replies do not."""
    WHOLE = "whole"


@dataclass(frozen=True, slots=True, kw_only=True)
class ForwardRule:
    """One row of Table 1."""

    pattern: str  #: DDS topic names; ``*`` stands for any characters, slashes included, as in the DDS Router.
    description: str  #: For people.
    directions: frozenset[Direction] = frozenset(Direction)  #: The ways it is open.

    def matches(self, dds_name: str) -> bool:
        """Return whether a DDS topic name falls under this rule."""
        return fnmatchcase(dds_name, self.pattern)


TABLE_1 = (
    ForwardRule(pattern="rt/tf", description="Transform topic"),
    ForwardRule(pattern="rt/tf_static", description="Static transform topic"),
    ForwardRule(pattern="rt/global/*", description="Global topics"),
    ForwardRule(pattern="rq/global/*", description="Global service requests"),
    ForwardRule(pattern="rr/global/*", description="Global service responses"),
)
"""Paper A, Table 1: everything that crosses D_i <-> D_0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Policy:
    """The set F_forward of Eq. 1 as rules."""

    rules: tuple[ForwardRule, ...] = TABLE_1  #: What may cross; everything else stays where it is.

    def crosses(self, dds_name: str, direction: Direction) -> bool:
        """Return whether samples of a DDS topic cross the border this way.

        Args:
            dds_name: The topic on the wire, as "rt/tf".
            direction: Which way.
        """
        return any(direction in rule.directions and rule.matches(dds_name) for rule in self.rules)

    def domains(self, dds_name: str, published_in: Side) -> frozenset[Side]:
        """Return where a message is heard: Eq. 1, with both sides of "D_i <-> D_0" named.

        Args:
            dds_name: The topic on the wire.
            published_in: The side that its publisher lives on.
        """
        way = Direction.OUTWARD if published_in is Side.LOCAL else Direction.INWARD
        return frozenset(Side) if self.crosses(dds_name, way) else frozenset({published_in})

    def crossing(self, name: str, kind: ResourceKind, direction: Direction) -> Crossing:
        """Return how much of a ROS topic, service or action crosses; a half-open one hangs its callers.

        Args:
            name: Absolute ROS name.
            kind: What the name denotes.
            direction: The way of a topic's messages; a service needs its requests and replies in both.

        Raises:
            FqnError: The name is not valid for its kind.
        """
        if kind is ResourceKind.TOPIC:
            passes = [self.crosses(dds, direction) for dds in dds_names(name, kind)]
        else:
            passes = [self.crosses(dds, way) for dds in dds_names(name, kind) for way in Direction]
        if all(passes):
            return Crossing.WHOLE
        return Crossing.HALF if any(passes) else Crossing.NONE
