"""Checks of the naming schema, paper A, section 4.1, Fig. 2: every standard name, and a seeded sample."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.checks import Case, Checks
from sfglab.names import (
    After,
    Component,
    Custom,
    FqnError,
    Resource,
    RosFqn,
    RosFqnBuilder,
    Scope,
    Stream,
    Suffixed,
    all_standard_fqns,
    parse,
    sanitize_agent,
    validate_agent,
    validate_ros_name,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

AGENT = "go2"

PAPER_NAMES = (
    "/global/agent_heartbeat",
    "/global/go2/get_metadata",
    "/local/go2/agent_discovery_event",
)
"""The names that the paper prints (sections 4.2 and 4.3), for an agent go2."""

HOST_NAMES = ("Go2-Jetson.local", "steamdeck", "raspberry-pi-5", "Workstation_7970X")

checks = Checks()


def _random_word(rng: np.random.Generator) -> str:
    return "".join(rng.choice(list("abcdefgh"), size=rng.integers(3, 8)))


def random_fqns(count: int, *, rng: np.random.Generator) -> Iterator[RosFqn]:
    """Yield names with random segments; names that the schema refuses are left out."""
    drawn = 0
    while drawn < count:
        builder = RosFqnBuilder().scope(list(Scope)[rng.integers(2)]).agent(_random_word(rng))
        try:
            yield _random_rest(builder, rng).build()
        except FqnError:
            continue
        drawn += 1


def _random_rest(builder: RosFqnBuilder, rng: np.random.Generator) -> RosFqnBuilder:
    depth = rng.integers(0, 3)
    if depth >= 1:
        builder = builder.component(*_random_segment(list(Component), rng))
    if depth == 2:
        builder = builder.stream(*_random_segment(list(Stream), rng))
    return builder.resource(*_random_segment(list(Resource), rng))


def _random_segment(values: list[Any], rng: np.random.Generator) -> tuple[Any, ...]:
    if rng.random() < 0.3:
        return (Custom(_random_word(rng)),)
    value = values[rng.integers(len(values))]
    return (value, _random_word(rng)) if rng.random() < 0.4 else (value,)


@cache
def _names(count: int, seed: int) -> tuple[RosFqn, ...]:
    """Return all standard names and `count` random ones."""
    return (*all_standard_fqns(AGENT), *random_fqns(count, rng=np.random.default_rng(seed)))


@checks.each("parses back to the tuple it was built from", _names)
def _parses_back(fqn: RosFqn) -> bool:
    return parse(str(fqn), fqn.kind) == fqn


@checks.each("builds back to the string it was parsed from", _names)
def _rebuilds(fqn: RosFqn) -> bool:
    return str(parse(str(fqn), fqn.kind)) == str(fqn)


@checks.each("is a valid ROS 2 name", _names)
def _is_ros_name(fqn: RosFqn) -> bool:
    validate_ros_name(str(fqn), fqn.kind)  # raises
    return True


@checks.each("has a resource that Fig. 2 allows after its last segment", _names)
def _is_allowed_there(fqn: RosFqn) -> bool:
    """Return whether Fig. 2 allows the resource behind the last segment; a custom resource is allowed everywhere."""
    resource = fqn.resource.base if isinstance(fqn.resource, Suffixed) else fqn.resource
    return isinstance(resource, Custom) or fqn.preceding in resource.after


@checks.cases("resources where Fig. 2 does not allow them are refused")
def _refuses() -> Iterator[Case]:
    agent = RosFqnBuilder().scope(Scope.GLOBAL).agent(AGENT)
    component = agent.component(Component.CAMERA)
    prefixes = {
        After.SCOPE: RosFqnBuilder().scope(Scope.GLOBAL).without_agent(),
        After.AGENT: agent,
        After.COMPONENT: component,
        After.STREAM: component.stream(Stream.COLOR),
    }
    for flag, prefix in prefixes.items():
        for resource in Resource:
            if flag in resource.after:
                continue
            try:
                prefix.resource(resource).build()
            except FqnError as error:
                yield str(error), True
            else:
                yield f"{resource.value} after {flag.name}", False


@checks.cases("a segment without the one that it is part of is refused")
def _no_gaps() -> Iterator[Case]:
    for agent, component, stream in ((None, Component.CAMERA, None), (AGENT, None, Stream.COLOR)):
        case = f"agent {agent}, component {component}, stream {stream}"
        try:
            RosFqn(
                scope=Scope.LOCAL,
                agent=agent,
                component=component,
                stream=stream,
                resource=Custom("x"),
            )
        except FqnError as error:
            yield case, error.place in {"agent", "component"}
        else:
            yield case, False


@checks.cases("a host name becomes a valid agent")
def _agents_of_hosts() -> Iterator[Case]:
    text = ", ".join(f"{host} -> {sanitize_agent(host)}" for host in HOST_NAMES)
    for host in HOST_NAMES:
        agent = sanitize_agent(host)
        yield text, validate_agent(agent) == agent


@checks.cases("standard names differ from each other")
def _differ() -> Iterator[Case]:
    names = [str(fqn) for fqn in all_standard_fqns(AGENT)]
    seen: set[str] = set()
    for name in reversed(names):
        yield name, name not in seen
        seen.add(name)


@checks.cases("is printed in the paper, and is in the schema")
def _printed() -> Iterator[Case]:
    return ((name, _rebuilds(parse(name))) for name in PAPER_NAMES)
