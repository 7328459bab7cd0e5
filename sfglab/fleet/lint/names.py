"""Checks of names: what reaches whom, with which type and QoS, and services whose halves do not cross together."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from sfglab.fleet.lint.report import Finding, a_remark, a_warning, an_error
from sfglab.fleet.policy import Crossing, Direction
from sfglab.names import TF, TF_STATIC, FqnError, ResourceKind, dds_names, parse, router_hazards
from sfglab.qos import Durability, incompatibilities

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.fleet.lint.uses import Meeting, Use, View

ROS_OWN = frozenset({TF, TF_STATIC, "/rosout", "/parameter_events", "/clock", "/diagnostics"})
"""Names that ROS 2 gives itself; they are outside the schema on purpose."""


def check_rule_pairs(view: View) -> Iterator[Finding]:
    """Find rules that forward one endpoint of services without the other, or only in one direction."""
    other = {"rq/": "rr/", "rr/": "rq/"}
    rules = view.fleet.policy.rules
    places = view.fleet.rule_places or (view.fleet.place,) * len(rules)
    opened: dict[str, set[Direction]] = defaultdict(set)
    for rule in rules:
        opened[rule.pattern] |= rule.directions
    for rule, place in zip(rules, places, strict=True):
        half = rule.pattern[:3]
        if half not in other:
            continue
        mirror = other[half] + rule.pattern[3:]
        if opened.get(mirror, set()) == set(rule.directions) == set(Direction):
            continue
        yield an_error(
            "half-open-rule",
            place,
            what=f"rule {rule.pattern} opens one half of services; {mirror} is not open in the same "
            "directions",
            why="a call needs its request and its reply, each out at one router and in at the other; "
            "without them no agent can query another one's get_metadata",
            remedy=f"have both {rule.pattern} and {mirror}, in both directions, or neither",
        )


def check_reach(view: View) -> Iterator[Finding]:
    """Find subscriptions and clients that nothing reaches, and forwarded topics without a subscription."""
    for meeting in view.meetings:
        is_topic = meeting.kind is ResourceKind.TOPIC
        is_whole = meeting.crossing is Crossing.WHOLE
        reaches_some = meeting.senders and meeting.crossing is not Crossing.NONE
        for use in meeting.hearers:
            if use.agent in meeting.senders or reaches_some:
                continue
            if meeting.senders:
                yield _does_not_cross(use, meeting.senders)
            elif not is_topic:
                yield _without_server(use)
            elif is_whole and not use.implied and use.name not in ROS_OWN:
                yield _without_publisher(use)
        if is_topic and is_whole and not meeting.hearers and not meeting.implied:
            yield a_remark(
                "unheard",
                meeting.first.place,
                what=f"{meeting.name} may cross, but no agent in this file subscribes to it",
                why="it costs nothing meanwhile: routers forward a topic only on demand",
            )


def _does_not_cross(use: Use, senders: list[str]) -> Finding:
    is_topic = use.kind is ResourceKind.TOPIC
    doing = "subscribes to" if is_topic else f"calls {use.kind.value}"
    below = use.name.split("/")[1:]
    for own in ("local", senders[0]):
        if below[:1] == [own]:
            below = below[1:]
    better = "/".join(("/global", senders[0], *below))
    return an_error(
        "does-not-cross",
        use.place,
        what=f"{use.agent} {doing} {use.name} of {', '.join(senders)}, which does not reach it",
        why="no forwarding rule lets it cross (paper A, Table 1)",
        remedy=f"name it below /global/, as {better}",
    )


def _without_server(use: Use) -> Finding:
    finding = a_warning if use.implied else an_error
    return finding(
        "no-server",
        use.place,
        what=f"{use.agent} calls {use.kind.value} {use.name}, which no agent in this file serves",
        why="its clients wait indefinitely",
        remedy="add the server to the file, or correct the name",
    )


def _without_publisher(use: Use) -> Finding:
    return a_warning(
        "nobody-speaks",
        use.place,
        what=f"{use.agent} subscribes to {use.name}, which no agent in this file publishes",
        why="the publisher may spell the name differently",
        remedy="add the publisher to the file, or correct the name",
    )


def check_services(view: View) -> Iterator[Finding]:
    """Find services and actions that cross in part, have several servers, or confuse a DDS Router."""
    for meeting in view.meetings:
        kind = meeting.kind
        name = meeting.name
        if kind is ResourceKind.TOPIC or meeting.crossing is Crossing.NONE:
            continue
        # Names that only the file implies are not reported here, because the rule itself is reported.
        if meeting.crossing is Crossing.PARTIAL and not meeting.implied:
            topics = dds_names(name, kind)
            policy = view.fleet.policy
            blocked = [t for t in topics if not all(policy.crosses(t, way) for way in Direction)]
            yield an_error(
                "half-open",
                meeting.first.place,
                what=f"{kind.value} {name} is half open: {len(topics) - len(blocked)} of its {len(topics)} "
                "DDS topics cross",
                why=f"clients of other agents wait indefinitely: {blocked[0]} does not cross both ways",
                remedy="allow requests and replies (rq/ and rr/) with the same pattern; an action needs rt/ too",
            )
        if meeting.crossing is Crossing.WHOLE and len(meeting.senders) > 1:
            yield an_error(
                "two-servers",
                meeting.speakers[-1].place,
                what=f"{', '.join(meeting.senders)} all serve {kind.value} {name}, which crosses",
                why="each call reaches all of them; the client takes the first reply",
                remedy="put the agent into the name, /global/<agent>/...",
            )
        hazards = router_hazards(name, kind)
        if hazards:
            yield an_error(
                "router-hazard",
                meeting.first.place,
                what=f"{kind.value} {name}: a DDS Router breaks {', '.join(map(repr, hazards))}",
                why="it finds the reply by replacing every 'rq/' by 'rr/' and every 'Request' by 'Reply'",
                remedy="rename so that no part ends in rq or rr before a slash or contains Request or Reply",
            )


def check_matches(view: View) -> Iterator[Finding]:
    """Find endpoints that reach each other and do not match, because of their types or QoS."""
    for meeting in view.meetings:
        name = meeting.name
        for one, other in _pairs(meeting):
            if one.type and other.type and one.type != other.type:
                types = f"{one.agent} has type {one.type}, {other.agent} has {other.type}"
                yield an_error(
                    "type-mismatch",
                    other.place,
                    what=f"{name}: {types}",
                    why="endpoints of different types never match",
                    remedy="use one type",
                )
            if one.qos is None or other.qos is None or name == TF_STATIC:
                continue
            reasons = incompatibilities(offered=one.qos, requested=other.qos)
            if reasons:
                yield an_error(
                    "qos-mismatch",
                    other.place,
                    what=f"{other.agent} never receives {name} of {one.agent}: QoS does not match",
                    why="; ".join(reasons),
                    remedy="request what the publisher offers, or offer more",
                )


def _pairs(meeting: Meeting) -> Iterator[tuple[Use, Use]]:
    """Yield each subscriber or client with the publishers or servers that it reaches, the first of equal ones."""
    crosses = meeting.crossing is Crossing.WHOLE
    groups: dict[str, dict[object, Use]] = defaultdict(dict)
    for speaker in meeting.speakers:
        group = groups["" if crosses else speaker.agent]
        group.setdefault((speaker.type, speaker.qos), speaker)
    for hearer in meeting.hearers:
        for speaker in groups["" if crosses else hearer.agent].values():
            yield speaker, hearer


def check_static_transforms(view: View) -> Iterator[Finding]:
    """Find endpoints of /tf_static that are not transient local: static transforms are sent only once."""
    for use in view.uses:
        is_static = use.kind is ResourceKind.TOPIC and use.name == TF_STATIC
        if is_static and use.qos is not None and use.qos.durability is Durability.VOLATILE:
            doing = "publishes" if use.speaks else "subscribes to"
            yield an_error(
                "static-not-latched",
                use.place,
                what=f"{use.agent} {doing} {TF_STATIC} as VOLATILE",
                why="static transforms are sent once: late joiners miss them, across a router always",
                remedy="use qos: latched (TRANSIENT_LOCAL)",
            )


def check_schema(view: View) -> Iterator[Finding]:
    """Find forwarded names that do not follow the naming schema of paper A, section 4.1."""
    for meeting in view.meetings:
        name = meeting.name
        is_hidden = any(part.startswith("_") for part in name.split("/"))
        if name in ROS_OWN or is_hidden or meeting.crossing is Crossing.NONE:
            continue
        try:
            parse(name, meeting.kind)
        except FqnError as error:
            yield a_warning(
                "not-in-schema",
                meeting.first.place,
                what=f"{name} crosses, but is not a name of the schema",
                why=str(error),
                remedy="build names with RosFqnBuilder; Custom(...) is for other segments",
            )
