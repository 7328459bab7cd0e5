"""Checks of domains and of names: what crosses or not, QoS, types, and latched transforms."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

from sfglab.fleet.lint.report import Finding, Severity, a_remark, a_warning, an_error
from sfglab.fleet.policy import Crossing
from sfglab.fleet.status.description import DescriptionError
from sfglab.names import TF, TF_STATIC, FqnError, ResourceKind, Scope, parse
from sfglab.qos import Durability, incompatibilities
from sfglab.validation import suggestion

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.fleet.fleet_file import AgentSpec
    from sfglab.fleet.lint.uses import Meeting, Use, View


def check_qos(view: View) -> Iterator[Finding]:
    """Find subscribers that request more than a publisher in reach offers."""
    for speaker, hearer in _pairs(view, ResourceKind.TOPIC):
        if speaker.qos is None or hearer.qos is None or speaker.name == TF_STATIC:
            continue
        reasons = incompatibilities(offered=speaker.qos, requested=hearer.qos)
        if reasons:
            what = (
                f"{hearer.agent} never hears {hearer.name} of {speaker.agent}: QoS does not match"
            )
            why, remedy = "; ".join(reasons), "request what the publisher offers, or offer more"
            yield an_error(
                code="qos-mismatch", place=hearer.place, what=what, why=why, remedy=remedy
            )


def check_types(view: View) -> Iterator[Finding]:
    """Find endpoints of one name that hear each other but disagree on the type."""
    for kind in ResourceKind:
        for speaker, hearer in _pairs(view, kind):
            if speaker.type and hearer.type and speaker.type != hearer.type:
                types = f"{speaker.agent} has type {speaker.type}, {hearer.agent} has {hearer.type}"
                what = f"{hearer.name}: {types}"
                why, remedy = "endpoints of different types never match", "use one type"
                yield an_error(
                    code="type-mismatch", place=hearer.place, what=what, why=why, remedy=remedy
                )


def check_static_transforms(view: View) -> Iterator[Finding]:
    """Find endpoints of /tf_static that are not transient local: static transforms are sent only once."""
    meeting = view.meetings.get((ResourceKind.TOPIC, TF_STATIC))
    if meeting is None:
        return
    for use in meeting.speakers + meeting.hearers:
        if use.qos is None or use.qos.durability is Durability.TRANSIENT_LOCAL:
            continue
        doing = "publishes" if use.speaks else "subscribes"
        who = "whoever starts later" if use.speaks else "it"
        what = f"{use.agent} {doing} {TF_STATIC} as VOLATILE"
        why = f"static transforms are sent once: {who} misses them, across a router always"
        remedy = "use qos: latched (TRANSIENT_LOCAL)"
        yield an_error(
            code="static-not-latched", place=use.place, what=what, why=why, remedy=remedy
        )
    for use in (use for use in meeting.speakers if use.count > 1):
        what = f"{use.agent} has {use.count} static broadcasters"
        why = (
            "a router that keeps one message a topic would lose all but the last; ours keeps a writer for "
            "each, a DDS Router its history, a Zenoh bridge transient_local_cache_multiplier messages"
        )
        yield a_remark(code="static-broadcasters", place=use.place, what=what, why=why)


def _pairs(view: View, kind: ResourceKind) -> Iterator[tuple[Use, Use]]:
    for (found, _), meeting in view.meetings.items():
        if found is kind:
            yield from (
                pair for pair in product(meeting.speakers, meeting.hearers) if view.reaches(*pair)
            )


#: Above it, ports are in Linux' ephemeral range (ROS 2, "The ROS_DOMAIN_ID").
LAST_SAFE_DOMAIN = 101

ROS_OWN = frozenset({TF, TF_STATIC, "/rosout", "/parameter_events", "/clock", "/diagnostics"})
"""Names that ROS 2 gives itself; they are outside the schema on purpose."""


def check_domains(view: View) -> Iterator[Finding]:
    """Find agents that share a domain, with each other or with the routers."""
    taken: dict[int, AgentSpec] = {}
    for agent in view.fleet.agents:
        if agent.domain == view.fleet.global_domain:
            what = f"{agent.name} uses domain {agent.domain}, the global one"
            why = "nothing separates it from the fleet: its names are everywhere (paper A, 4.1: D_i != 0)"
            remedy = f"give it a domain of its own, 1 to {LAST_SAFE_DOMAIN}"
            yield an_error(
                code="domain-global", place=agent.place, what=what, why=why, remedy=remedy
            )
        elif agent.domain in taken:
            what = f"{agent.name} and {taken[agent.domain].name} both use domain {agent.domain}"
            why = (
                "where one network reaches both, their local names mix, and both routers serve both"
            )
            remedy = "give every agent a domain of its own"
            yield an_error(
                code="domain-shared", place=agent.place, what=what, why=why, remedy=remedy
            )
        taken.setdefault(agent.domain, agent)
        if agent.domain > LAST_SAFE_DOMAIN:
            what = f"{agent.name} uses domain {agent.domain}, above {LAST_SAFE_DOMAIN}"
            why = "its ports lie where Linux takes ports for outgoing connections: some starts will fail"
            remedy = f"use 1 to {LAST_SAFE_DOMAIN}"
            yield a_warning(
                code="domain-high", place=agent.place, what=what, why=why, remedy=remedy
            )


def check_topics_cross(view: View) -> Iterator[Finding]:
    """Find topics whose subscriber waits for another agent that it cannot hear, or for nobody at all."""
    for (kind, name), meeting in view.meetings.items():
        if kind is not ResourceKind.TOPIC:
            continue
        crosses = view.crossing(name, kind) is Crossing.WHOLE
        yield from _deaf(name, meeting, crosses=crosses)
        if crosses and not meeting.hearers and not meeting.implied:
            what = f"{name} may cross, but nobody in this file subscribes it"
            why = (
                "it costs nothing until somebody does: routers show a topic only when it is wanted"
            )
            yield a_remark(code="unheard", place=meeting.first.place, what=what, why=why)


def _deaf(name: str, meeting: Meeting, *, crosses: bool) -> Iterator[Finding]:
    speakers = {use.agent for use in meeting.speakers}
    publishers = ", ".join(sorted(speakers))
    for use in meeting.hearers:
        if use.agent in speakers or (crosses and speakers):
            continue
        if speakers:
            severity, code = Severity.ERROR, "does-not-cross"
            what = (
                f"{use.agent} subscribes {name}, which {publishers} publishes, and never hears it"
            )
            why = "no forwarding rule lets it cross (paper A, Table 1)"
            remedy = f"publish it below /global/, as {_global_form(name, min(speakers))}"
        elif crosses and not use.implied and name not in ROS_OWN:
            severity, code = Severity.WARNING, "nobody-speaks"
            what = f"{use.agent} subscribes {name}, which nobody in this file publishes"
            why = "it may be a name that is spelled differently where it is published"
            remedy = "add the publisher to the file, or correct the name"
        else:
            continue
        yield Finding(
            severity=severity, code=code, place=use.place, what=what, why=why, remedy=remedy
        )


def check_schema(view: View) -> Iterator[Finding]:
    """Find names that the naming schema does not know, those that nearly begin with a scope first."""
    for (kind, name), meeting in view.meetings.items():
        if name in ROS_OWN or any(part.startswith("_") for part in name.split("/")):
            continue
        try:
            parse(name, kind)
        except FqnError as error:
            yield _outside(
                name, meeting, error, crosses=view.crossing(name, kind) is not Crossing.NONE
            )


def _outside(name: str, meeting: Meeting, error: FqnError, *, crosses: bool) -> Finding:
    first = name.split("/")[1]
    meant = first.startswith(Scope.GLOBAL.value) or suggestion(first, (Scope.GLOBAL.value,))
    severity, why = Severity.WARNING, str(error)
    if crosses:
        code, what = "not-in-schema", f"{name} crosses, but is not a name of the schema"
        remedy = (
            "build names with RosFqnBuilder; Custom(...) is for what the standard does not know"
        )
    elif meant:
        code, what = "nearly-global", f"{name} stays local, though it begins almost like /global/"
        why = (
            "a rule such as rt/global/* asks for the slash: nothing else crosses (paper A, Table 1)"
        )
        remedy = f"if it shall cross, name it {_global_form(name, meeting.first.agent)}"
    else:
        severity, code = Severity.INFO, "local-outside-schema"
        what = f"{name} is not a name of the schema; it stays in its agent's domain"
        remedy = "begin it with /local/<agent>/ so that its reader knows that it does not cross"
    return Finding(
        severity=severity, code=code, place=meeting.first.place, what=what, why=why, remedy=remedy
    )


def check_descriptions(view: View) -> Iterator[Finding]:
    """Find sensors that the agent's metadata could not announce."""
    for agent in view.fleet.agents:
        try:
            agent.description.check(agent.name)
        except DescriptionError as error:
            what = f"{agent.name} cannot announce its sensors: {error}"
            why = "its status provider refuses to start: nobody discovers the agent (paper A, section 4.2)"
            remedy = f"name streams /global/{agent.name}/<component>/<stream>/<resource>"
            place = (agent.sensors[0] if agent.sensors else agent).place
            yield an_error(code="description", place=place, what=what, why=why, remedy=remedy)


def check_agents_named(view: View) -> Iterator[Finding]:
    """Find names that name an agent that the fleet does not have."""
    known = tuple(agent.name for agent in view.fleet.agents)
    for (kind, name), meeting in view.meetings.items():
        try:
            agent = parse(name, kind).agent
        except FqnError:
            continue
        if agent is not None and agent not in known:
            what = (
                f"{name} names agent {agent!r}, which is not in the fleet{suggestion(agent, known)}"
            )
            why = "nobody will be found under that name"
            remedy = f"use one of {', '.join(known)}, or add the agent"
            yield a_warning(
                code="unknown-agent", place=meeting.first.place, what=what, why=why, remedy=remedy
            )


def check_publishers(view: View) -> Iterator[Finding]:
    """Find crossing topics of one agent that several agents publish."""
    for (kind, name), meeting in view.meetings.items():
        agents = dict.fromkeys(use.agent for use in meeting.speakers)
        if (
            kind is not ResourceKind.TOPIC
            or len(agents) < 2
            or view.crossing(name, kind) is Crossing.NONE
        ):
            continue
        try:
            owner = parse(name, kind).agent
        except FqnError:
            continue
        if owner in agents:
            others = ", ".join(sorted(agent for agent in agents if agent != owner))
            what = f"{others} publishes {name}, as {owner} itself does"
            why = "subscribers hear both and cannot tell them apart"
            remedy = "publish under the own agent's name, or remove one publisher"
            place = meeting.speakers[-1].place
            yield a_warning(code="two-publishers", place=place, what=what, why=why, remedy=remedy)


def _global_form(name: str, agent: str) -> str:
    """Return how a name could look in the global scope; a hint, not a parsed name."""
    first, *rest = name.split("/")[1:]
    nearly = first.startswith(Scope.GLOBAL.value) or suggestion(first, (Scope.GLOBAL.value,))
    tail = rest if (first == Scope.LOCAL.value or nearly) and rest else [agent, first, *rest]
    if first == Scope.LOCAL.value and rest[:1] == [Scope.GLOBAL.value]:
        tail = rest[1:]
    return "/".join(["", Scope.GLOBAL.value, *tail])
