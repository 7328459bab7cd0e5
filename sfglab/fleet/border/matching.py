"""Checks of endpoints that hear each other by name: quality of service, types, and latched transforms."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.fleet.border.report import Finding, Severity
from sfglab.names import TF_STATIC, ResourceKind
from sfglab.qos import Durability, incompatibilities

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.fleet.border.uses import Use, View


def check_qos(view: View) -> Iterator[Finding]:
    """Find subscribers that request more than a publisher in reach offers."""
    for speaker, hearer in _pairs(view, ResourceKind.TOPIC):
        if speaker.qos is None or hearer.qos is None or speaker.name == TF_STATIC:
            continue
        reasons = incompatibilities(offered=speaker.qos, requested=hearer.qos)
        if reasons:
            yield Finding(
                severity=Severity.ERROR,
                code="qos-mismatch",
                place=hearer.place,
                what=f"{hearer.agent} never hears {hearer.name} of {speaker.agent}: QoS does not match",
                why="; ".join(reasons),
                remedy="request what the publisher offers, or offer more",
            )


def check_types(view: View) -> Iterator[Finding]:
    """Find endpoints of one name that hear each other but disagree on the type."""
    for kind in ResourceKind:
        for speaker, hearer in _pairs(view, kind):
            if speaker.type and hearer.type and speaker.type != hearer.type:
                yield Finding(
                    severity=Severity.ERROR,
                    code="type-mismatch",
                    place=hearer.place,
                    what=(
                        f"{hearer.name}: {speaker.agent} has type {speaker.type}, "
                        f"{hearer.agent} has {hearer.type}"
                    ),
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
        doing = "publishes" if use.speaks else "subscribes"
        who = "whoever starts later" if use.speaks else "it"
        yield Finding(
            severity=Severity.ERROR,
            code="static-not-latched",
            place=use.place,
            what=f"{use.agent} {doing} {TF_STATIC} as VOLATILE",
            why=f"static transforms are sent once: {who} misses them, across a router always",
            remedy="use qos: latched (TRANSIENT_LOCAL)",
        )
    many = [use for use in meeting.speakers if use.count > 1]
    for use in many:
        yield Finding(
            severity=Severity.INFO,
            code="static-broadcasters",
            place=use.place,
            what=f"{use.agent} has {use.count} static broadcasters",
            why=(
                "a router that keeps one message a topic would lose all but the last; ours keeps a writer for "
                "each, a DDS Router its history, a Zenoh bridge transient_local_cache_multiplier messages"
            ),
        )


def _pairs(view: View, kind: ResourceKind) -> Iterator[tuple[Use, Use]]:
    for (found, _), meeting in view.meetings.items():
        if found is kind:
            for speaker in meeting.speakers:
                for hearer in meeting.hearers:
                    if view.reaches(speaker, hearer):
                        yield speaker, hearer
