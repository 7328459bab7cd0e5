"""The schema as data: the graph of Fig. 2 and every name that the standard values alone can make."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from sfglab.names.fqn import RosFqn
from sfglab.names.vocabulary import After, Component, Resource, Scope, Stream

if TYPE_CHECKING:
    from collections.abc import Iterator


@dataclass(frozen=True, slots=True, kw_only=True)
class SchemaNode:
    """One kind of segment."""

    name: str  #: scope, agent, component, stream or resource.
    mandatory: bool  #: Whether every name has it.
    extensible: bool  #: Whether it takes suffixes and `Custom`.
    values: tuple[str, ...]  #: The standard values; none for the agent, which is resolved at run time.


@dataclass(frozen=True, slots=True, kw_only=True)
class SchemaEdge:
    """One step from a segment to the next."""

    source: str  #: Name of the node it leaves.
    target: str  #: Name of the node it enters.
    after: After | None = None  #: The constraint on a path into the resource; None on the other steps.
    #: The standard resources that the constraint permits; empty on the other steps.
    resources: tuple[Resource, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class SchemaTable:
    """The graph of Fig. 2: its nodes in the order of a name, and its edges."""

    nodes: tuple[SchemaNode, ...]
    edges: tuple[SchemaEdge, ...]


def schema_table() -> SchemaTable:
    """Return the structural syntax of the schema, from which paper A, Fig. 2 can be drawn."""
    chain = [flag.name.lower() for flag in After if flag.name]
    steps = [SchemaEdge(source=a, target=b) for a, b in pairwise(chain)]
    ends = [
        SchemaEdge(source=source, target="resource", after=flag, resources=_permitted(flag))
        for source, flag in zip(chain, After, strict=True)
    ]
    return SchemaTable(nodes=_nodes(), edges=(*steps, *ends))


def all_standard_fqns(agent: str) -> Iterator[RosFqn]:
    """Yield every name that standard values without suffix can make for one agent, each once.

    Raises:
        FqnError: If the agent's name is not allowed.
    """
    for scope in Scope:
        for resource in _permitted(After.SCOPE):
            yield RosFqn(scope=scope, resource=resource)
        for resource in _permitted(After.AGENT):
            yield RosFqn(scope=scope, agent=agent, resource=resource)
        for component in Component:
            for resource in _permitted(After.COMPONENT):
                yield RosFqn(scope=scope, agent=agent, component=component, resource=resource)
            for stream in Stream:
                for resource in _permitted(After.STREAM):
                    yield RosFqn(
                        scope=scope, agent=agent, component=component, stream=stream, resource=resource
                    )


def _permitted(flag: After) -> tuple[Resource, ...]:
    return tuple(resource for resource in Resource if flag in resource.after)


def _nodes() -> tuple[SchemaNode, ...]:
    rows = (
        ("scope", True, False, Scope),
        ("agent", False, False, ()),
        ("component", False, True, Component),
        ("stream", False, True, Stream),
        ("resource", True, True, Resource),
    )
    return tuple(
        SchemaNode(
            name=name,
            mandatory=mandatory,
            extensible=extensible,
            values=tuple(str(value.value) for value in values),
        )
        for name, mandatory, extensible, values in rows
    )
