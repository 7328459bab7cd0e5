"""`RosFqnBuilder`, the builder of paper A, section 4.1: names from enumerations, not from joined strings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

from sfglab.names.agent import default_agent
from sfglab.names.fqn import RosFqn
from sfglab.names.grammar import FqnError
from sfglab.names.vocabulary import Component, Custom, Resource, Scope, Stream, Suffixed

if TYPE_CHECKING:
    from sfglab.names.fqn import ComponentSegment, ResourceSegment, StreamSegment


_T = TypeVar("_T", Component, Stream, Resource)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Parts:
    scope: Scope | None = None
    agent: str | None = None
    has_agent: bool = True
    component: ComponentSegment | None = None
    stream: StreamSegment | None = None
    resource: ResourceSegment | None = None


class RosFqnBuilder:
    """Collects the segments of one name, in any order; a later call replaces an earlier one.

    Immutable: every method returns a new builder, so a common beginning can be kept and continued more than
    once. An agent that is neither given nor excluded is this host's, as `default_agent` says.
    """

    __slots__ = ("_parts",)

    def __init__(self) -> None:
        self._parts = _Parts()

    def scope(self, scope: Scope) -> RosFqnBuilder:
        """Return a builder with this scope."""
        return _continued(replace(self._parts, scope=scope))

    def agent(self, agent: str) -> RosFqnBuilder:
        """Return a builder with this agent instead of the default one."""
        return _continued(replace(self._parts, agent=agent, has_agent=True))

    def without_agent(self) -> RosFqnBuilder:
        """Return a builder for a name without agent, such as `/global/agent_heartbeat`."""
        return _continued(replace(self._parts, agent=None, has_agent=False))

    def component(self, component: ComponentSegment, suffix: str | None = None) -> RosFqnBuilder:
        """Return a builder with this component, for example `Component.CAMERA, "front"`.

        Raises:
            FqnError: If the suffix is not allowed.
        """
        segment = component if suffix is None else _suffixed("component", component, suffix)
        return _continued(replace(self._parts, component=segment))

    def stream(self, stream: StreamSegment, suffix: str | None = None) -> RosFqnBuilder:
        """Return a builder with this data stream, for example `Stream.INFRA, "1"`.

        Raises:
            FqnError: If the suffix is not allowed.
        """
        segment = stream if suffix is None else _suffixed("stream", stream, suffix)
        return _continued(replace(self._parts, stream=segment))

    def resource(self, resource: ResourceSegment, suffix: str | None = None) -> RosFqnBuilder:
        """Return a builder with this resource.

        Raises:
            FqnError: If the suffix is not allowed.
        """
        segment = resource if suffix is None else _suffixed("resource", resource, suffix)
        return _continued(replace(self._parts, resource=segment))

    def build(self) -> RosFqn:
        """Return the name.

        Reads the environment and the host name only where no agent was given or excluded.

        Raises:
            FqnError: Naming the segment that is missing or not allowed.
        """
        parts = self._parts
        if parts.scope is None:
            raise FqnError("scope", None, "Scope.LOCAL or Scope.GLOBAL; it is mandatory")
        if parts.resource is None:
            raise FqnError("resource", None, "a Resource, one with a suffix, or Custom; it is mandatory")
        agent = default_agent() if parts.has_agent and parts.agent is None else parts.agent
        return RosFqn(
            scope=parts.scope,
            agent=agent,
            component=parts.component,
            stream=parts.stream,
            resource=parts.resource,
        )


def _continued(parts: _Parts) -> RosFqnBuilder:
    builder = RosFqnBuilder()
    builder._parts = parts  # noqa: SLF001 - a second constructor of the same class
    return builder


def _suffixed(label: str, value: _T | Suffixed[_T] | Custom, suffix: str) -> Suffixed[_T]:
    if isinstance(value, (Component, Stream, Resource)):
        return value.suffixed(suffix)
    raise FqnError(label, value, "a suffix only on a standard value that has none yet; write it into Custom")
