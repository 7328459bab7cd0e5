"""The naming schema of paper A, section 4.1 and Fig. 2: `/scope[/agent[/component[/stream]]]/resource`.

In the paper's tuple (s, a, c, d, r), scope and resource are mandatory and each of the others may be empty.
Here an optional segment requires the one before it: a stream is a stream *of* a component, a component a
part *of* an agent. Without the agent, two agents' lidars would share one global name. The number of
segments alone therefore gives the meaning of each. All names that the paper prints have this form:
`/global/agent_heartbeat`, `/global/<agent>/get_metadata`, `/local/<agent>/agent_discovery_event`.

A resource is allowed behind a segment if its `After` flags contain the kind of that segment; the scope
does not matter. `str()` of a `RosFqn` and `parse` are inverse to each other. A name does not state whether
a custom resource is a topic, a service or an action, so `parse` has an argument for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from sfglab.names.agent import default_agent, validate_agent
from sfglab.names.grammar import (
    FqnError,
    ResourceKind,
    check_words,
    dds_names,
    router_hazards,
    validate_ros_name,
)
from sfglab.names.vocabulary import (
    After,
    Component,
    Custom,
    Resource,
    Scope,
    Stream,
    Suffixed,
    check_unmistakable,
    read_standard,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

ComponentSegment: TypeAlias = Component | Suffixed[Component] | Custom
StreamSegment: TypeAlias = Stream | Suffixed[Stream] | Custom
ResourceSegment: TypeAlias = Resource | Suffixed[Resource] | Custom

_SETS: dict[str, type[Component | Stream | Resource]] = {
    "component": Component,
    "stream": Stream,
    "resource": Resource,
}
_SHAPE = "/scope[/agent[/component[/stream]]]/resource"


@dataclass(frozen=True, slots=True, kw_only=True)
class RosFqn:
    """One name as the tuple (scope, agent, component, stream, resource); `str()` is the ROS name.

    Raises:
        FqnError: The schema does not allow a segment, which the error names.
    """

    scope: Scope  #: Local or global.
    agent: str | None = None  #: Agent that uses the name; None for none.
    component: ComponentSegment | None = None  #: Part of the agent; None for none.
    stream: StreamSegment | None = None  #: Data stream of the component; None for none.
    resource: ResourceSegment  #: Topic, service or action.

    def __post_init__(self) -> None:
        if not isinstance(self.scope, Scope):
            raise FqnError("scope", self.scope, "Scope.LOCAL or Scope.GLOBAL")
        _check_chain(self)
        if self.agent is not None:
            validate_agent(self.agent)
        _check_sets(self)
        _check_constraint(self)
        if self.is_global:
            _check_routable(self)
        validate_ros_name(str(self), self.kind)

    def __str__(self) -> str:
        return "".join(f"/{text}" for _, text in self.segments)

    @property
    def segments(self) -> tuple[tuple[str, str], ...]:
        """The present segments in order, as pairs of kind and text."""
        found = [("scope", self.scope.value)]
        if self.agent is not None:
            found.append(("agent", self.agent))
        for label in _SETS:
            value = getattr(self, label)
            if value is not None:
                found.append((label, value.text))
        return tuple(found)

    @property
    def kind(self) -> ResourceKind:
        """Whether the resource is a topic, a service or an action."""
        kind: ResourceKind = _base(self.resource).kind
        return kind

    @property
    def preceding(self) -> After:
        """Kind of the last segment before the resource."""
        return After[self.segments[-2][0].upper()]

    @property
    def is_global(self) -> bool:
        """Whether the scope is global."""
        return self.scope is Scope.GLOBAL

    @property
    def dds_names(self) -> tuple[str, ...]:
        """DDS topics of the name: one for topics, two for services, eight for actions."""
        return dds_names(str(self), self.kind)


def parse(name: str, kind: ResourceKind | None = None) -> RosFqn:
    """Return the tuple of an absolute ROS name; without a kind a custom resource is a topic.

    Raises:
        FqnError: The schema does not allow a segment, which the error names; `name` for the whole.
    """
    scope, middle, last = _shares(name)
    agent, component, stream = middle
    resource = _read_resource(last, kind)
    return RosFqn(
        scope=scope,
        agent=agent,
        component=_read("component", component),
        stream=_read("stream", stream),
        resource=resource,
    )


def _shares(name: str) -> tuple[Scope, tuple[str | None, ...], str]:
    if not name.startswith("/"):
        raise FqnError("name", name, f"an absolute name, {_SHAPE}")
    first, *rest = name[1:].split("/")
    if first not in {scope.value for scope in Scope}:
        raise FqnError("scope", first, " or ".join(scope.value for scope in Scope))
    if not 1 <= len(rest) <= 4:
        raise FqnError("name", name, f"two to five segments, {_SHAPE}")
    *middle, last = rest
    return Scope(first), (*middle, *[None] * (3 - len(middle))), last


def _read(label: str, text: str | None) -> Any:
    if text is None:
        return None
    return read_standard(_SETS[label], check_words(label, text)) or Custom(text)


def _read_resource(text: str, kind: ResourceKind | None) -> ResourceSegment:
    resource = read_standard(Resource, check_words("resource", text))
    if resource is None:
        return Custom(text, kind=kind or ResourceKind.TOPIC)
    own = _base(resource).kind
    if kind not in (None, own):
        raise FqnError("resource", text, f"this standard resource as a {own.value} only")
    return resource


def _base(segment: Any) -> Any:
    return segment.base if isinstance(segment, Suffixed) else segment


def _check_chain(fqn: RosFqn) -> None:
    if fqn.component is not None and fqn.agent is None:
        raise FqnError("agent", None, "an agent before the component, which is a part of it")
    if fqn.stream is not None and fqn.component is None:
        raise FqnError(
            "component", None, "a component before the stream, which is one of its data streams"
        )


def _check_sets(fqn: RosFqn) -> None:
    for label, values in _SETS.items():
        value = getattr(fqn, label)
        base = _base(value)
        if isinstance(base, Custom):
            check_unmistakable(label, base.text, own=values)
        elif not isinstance(base, values) and (value is not None or label == "resource"):
            raise FqnError(label, value, f"a {values.__name__}, one with a suffix, or Custom")


def _check_constraint(fqn: RosFqn) -> None:
    after = _base(fqn.resource).after
    if fqn.preceding not in after:
        places = ", ".join(flag.name.lower() for flag in After if flag in after and flag.name)
        allowed = f"this resource after {places}; here it follows the {fqn.segments[-2][0]}"
        raise FqnError("resource", fqn.resource.text, allowed)


def _check_routable(fqn: RosFqn) -> None:
    hazards = router_hazards(str(fqn), fqn.kind)
    for label, text in fqn.segments:
        if text in hazards:
            allowed = (
                "in a global service or action a segment without 'Request' or 'Reply' that does not end in "
                "'rq' or 'rr' before a slash: a DDS router breaks it"
            )
            raise FqnError(label, text, allowed)


class RosFqnBuilder:
    """Builder of one name from its segments, in any order; a later call replaces an earlier one.

    It is the builder of paper A, section 4.1: names from enumerations. Every method returns a new builder.
    If the agent is neither given nor excluded, it is this host's (`default_agent`). Component, stream and
    resource take a suffix, as in `Component.CAMERA, "front"` or `Stream.INFRA, "1"`.

    Raises:
        FqnError: A method was given a suffix that is not allowed; `build` raises it for the other segments.
    """

    __slots__ = ("_segments",)

    def __init__(self) -> None:
        self._segments: Mapping[str, Any] = {}

    def scope(self, scope: Scope) -> RosFqnBuilder:
        """Return a builder with this scope, such as `Scope.GLOBAL`."""
        return self._with("scope", scope)

    def agent(self, agent: str) -> RosFqnBuilder:
        """Return a builder with this agent instead of the default one."""
        return self._with("agent", agent)

    def without_agent(self) -> RosFqnBuilder:
        """Return a builder for a name without agent, such as `/global/agent_heartbeat`."""
        return self._with("agent", None)

    def component(self, component: ComponentSegment, suffix: str | None = None) -> RosFqnBuilder:
        """Return a builder with this component, and a suffix if the agent has several of its kind."""
        return self._with("component", component, suffix)

    def stream(self, stream: StreamSegment, suffix: str | None = None) -> RosFqnBuilder:
        """Return a builder with this data stream, and a suffix if the component has several of its kind."""
        return self._with("stream", stream, suffix)

    def resource(self, resource: ResourceSegment, suffix: str | None = None) -> RosFqnBuilder:
        """Return a builder with this topic, service or action, and its optional suffix."""
        return self._with("resource", resource, suffix)

    def build(self) -> RosFqn:
        """Return the name; an agent that is neither given nor excluded comes from the environment or the host.

        Raises:
            FqnError: A segment is missing or not allowed; the error names it.
        """
        segments = {"scope": None, "resource": None, **self._segments}
        if "agent" not in segments:
            segments["agent"] = default_agent()
        return RosFqn(**segments)

    def _with(self, label: str, value: Any, suffix: str | None = None) -> RosFqnBuilder:
        if suffix is not None:
            if not isinstance(value, (Component, Stream, Resource)):
                allowed = (
                    "a suffix only on a standard value that has none yet; write it into Custom"
                )
                raise FqnError(label, value, allowed)
            value = value.suffixed(suffix)
        builder = RosFqnBuilder()
        builder._segments = {**self._segments, label: value}
        return builder


def all_standard_fqns(agent: str) -> Iterator[RosFqn]:
    """Yield every name that standard values without suffix can make for one agent, each once.

    Raises:
        FqnError: The agent's name is not allowed.
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
                        scope=scope,
                        agent=agent,
                        component=component,
                        stream=stream,
                        resource=resource,
                    )


def _permitted(flag: After) -> tuple[Resource, ...]:
    return tuple(resource for resource in Resource if flag in resource.after)
