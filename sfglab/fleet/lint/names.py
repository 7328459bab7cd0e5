"""Checks of domains and names: forwarded names, QoS, types, and static transforms."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

from sfglab.fleet.lint.report import Finding, a_remark, a_warning, an_error
from sfglab.fleet.policy import Crossing
from sfglab.fleet.status.description import DescriptionError
from sfglab.names import TF, TF_STATIC, FqnError, ResourceKind, Scope, parse
from sfglab.qos import Durability, incompatibilities
from sfglab.validation import suggestion

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.fleet.lint.uses import Meeting, Use, View


def check_qos(view: View) -> Iterator[Finding]:
    """Find subscriptions that request more than a matching publisher offers."""
    for publisher, subscriber in _pairs(view, ResourceKind.TOPIC):
        offered, requested = publisher.qos, subscriber.qos
        if offered is None or requested is None or publisher.name == TF_STATIC:
            continue
        reasons = incompatibilities(offered=offered, requested=requested)
        if reasons:
            name = f"{subscriber.name} of {publisher.agent}"
            yield an_error(
                "qos-mismatch",
                subscriber.place,
                what=f"{subscriber.agent} never receives {name}: QoS does not match",
                why="; ".join(reasons),
                remedy="request what the publisher offers, or offer more",
            )


def check_types(view: View) -> Iterator[Finding]:
    """Find endpoints of one name that reach each other and have different types."""
    for kind in ResourceKind:
        for one, other in _pairs(view, kind):
            if one.type and other.type and one.type != other.type:
                types = f"{one.agent} has type {one.type}, {other.agent} has {other.type}"
                yield an_error(
                    "type-mismatch",
                    other.place,
                    what=f"{other.name}: {types}",
                    why="endpoints of different types never match",
                    remedy="use one type",
                )


def check_static_transforms(view: View) -> Iterator[Finding]:
    """Find endpoints of /tf_static that are not transient local: static transforms are sent only once."""
    meeting = view.meetings.get((ResourceKind.TOPIC, TF_STATIC))
    if meeting is None:
        return
    for use in meeting.speakers + meeting.hearers:
        if use.qos is None or use.qos.durability is Durability.TRANSIENT_LOCAL:
            continue
        doing, late = "subscribes to", "it"
        if use.speaks:
            doing, late = "publishes", "a late joiner"
        yield an_error(
            "static-not-latched",
            use.place,
            what=f"{use.agent} {doing} {TF_STATIC} as VOLATILE",
            why=f"static transforms are sent once: {late} misses them, across a router always",
            remedy="use qos: latched (TRANSIENT_LOCAL)",
        )


def _pairs(view: View, kind: ResourceKind) -> Iterator[tuple[Use, Use]]:
    """Yield each publisher or server with each subscriber or client of its name that it reaches."""
    for (found, _), meeting in view.meetings.items():
        if found is not kind:
            continue
        for pair in product(meeting.speakers, meeting.hearers):
            if view.reaches(*pair):
                yield pair


#: Highest domain whose ports are below Linux' ephemeral range (ROS 2, "The ROS_DOMAIN_ID").
LAST_SAFE_DOMAIN = 101

ROS_OWN = frozenset({TF, TF_STATIC, "/rosout", "/parameter_events", "/clock", "/diagnostics"})
"""Names that ROS 2 gives itself; they are outside the schema on purpose."""


def check_domains(view: View) -> Iterator[Finding]:
    """Find agents that share a domain, with each other or with the routers."""
    first_of: dict[int, str] = {}
    for agent in view.fleet.agents:
        first = first_of.setdefault(agent.domain, agent.name)
        if agent.domain == view.fleet.global_domain:
            yield an_error(
                "domain-global",
                agent.place,
                what=f"{agent.name} uses domain {agent.domain}, the global one",
                why="all agents receive its local topics (paper A, 4.1: D_i != 0)",
                remedy=f"give it a domain of its own, 1 to {LAST_SAFE_DOMAIN}",
            )
        elif first != agent.name:
            yield an_error(
                "domain-shared",
                agent.place,
                what=f"{agent.name} and {first} both use domain {agent.domain}",
                why="on one network their local topics mix, and both routers serve both agents",
                remedy="give every agent a domain of its own",
            )
        if agent.domain > LAST_SAFE_DOMAIN:
            yield a_warning(
                "domain-high",
                agent.place,
                what=f"{agent.name} uses domain {agent.domain}, above {LAST_SAFE_DOMAIN}",
                why="its ports are in the range of outgoing connections: some starts will fail",
                remedy=f"use 1 to {LAST_SAFE_DOMAIN}",
            )


def check_topics_cross(view: View) -> Iterator[Finding]:
    """Find topics that their subscriber cannot receive, and forwarded topics without a subscriber."""
    for (kind, name), meeting in view.meetings.items():
        if kind is not ResourceKind.TOPIC:
            continue
        crosses = view.crossing(name, kind) is Crossing.WHOLE
        yield from _without_publisher(name, meeting, crosses=crosses)
        if crosses and not meeting.hearers and not meeting.implied:
            yield a_remark(
                "unheard",
                meeting.first.place,
                what=f"{name} may cross, but no agent in this file subscribes to it",
                why="it costs nothing meanwhile: routers forward a topic only on demand",
            )


def _without_publisher(name: str, meeting: Meeting, *, crosses: bool) -> Iterator[Finding]:
    publishers = sorted({use.agent for use in meeting.speakers})
    for use in meeting.hearers:
        if use.agent in publishers or (crosses and publishers):
            continue
        if publishers:
            yield an_error(
                "does-not-cross",
                use.place,
                what=f"{use.agent} subscribes to {name} of {', '.join(publishers)}, and receives nothing",
                why="no forwarding rule lets it cross (paper A, Table 1)",
                remedy=f"publish it below /global/, as {_global_form(name, publishers[0])}",
            )
        elif crosses and not use.implied and name not in ROS_OWN:
            yield a_warning(
                "nobody-speaks",
                use.place,
                what=f"{use.agent} subscribes to {name}, which no agent in this file publishes",
                why="the publisher may spell the name differently",
                remedy="add the publisher to the file, or correct the name",
            )


def check_schema(view: View) -> Iterator[Finding]:
    """Find forwarded names outside the schema, and names that are not forwarded but nearly global."""
    for (kind, name), meeting in view.meetings.items():
        if name in ROS_OWN or any(part.startswith("_") for part in name.split("/")):
            continue
        try:
            parse(name, kind)
        except FqnError as error:
            if view.crossing(name, kind) is not Crossing.NONE:
                yield a_warning(
                    "not-in-schema",
                    meeting.first.place,
                    what=f"{name} crosses, but is not a name of the schema",
                    why=str(error),
                    remedy="build names with RosFqnBuilder; Custom(...) is for other segments",
                )
            elif _is_nearly_global(name.split("/")[1]):
                yield a_warning(
                    "nearly-global",
                    meeting.first.place,
                    what=f"{name} stays local, although it begins almost like /global/",
                    why="a rule such as rt/global/* needs the slash (paper A, Table 1)",
                    remedy=f"if it shall cross, name it {_global_form(name, meeting.first.agent)}",
                )


def _is_nearly_global(segment: str) -> bool:
    is_similar = suggestion(segment, (Scope.GLOBAL.value,))
    return segment.startswith(Scope.GLOBAL.value) or bool(is_similar)


def check_descriptions(view: View) -> Iterator[Finding]:
    """Find sensors that the agent's metadata could not announce."""
    for agent in view.fleet.agents:
        try:
            agent.description.check(agent.name)
        except DescriptionError as error:
            place = agent.sensors[0].place if agent.sensors else agent.place
            yield an_error(
                "description",
                place,
                what=f"{agent.name} cannot announce its sensors: {error}",
                why="its status provider does not start: no agent discovers it (paper A, section 4.2)",
                remedy=f"name streams /global/{agent.name}/<component>/<stream>/<resource>",
            )


def _global_form(name: str, agent: str) -> str:
    """Return a similar name in the global scope, as a hint; the name is not parsed."""
    first, *rest = name.split("/")[1:]
    is_local = first == Scope.LOCAL.value
    tail = [agent, first, *rest]
    if is_local and rest[:1] == [Scope.GLOBAL.value]:
        tail = rest[1:]
    elif rest and (is_local or _is_nearly_global(first)):
        tail = rest
    return "/".join(["", Scope.GLOBAL.value, *tail])
