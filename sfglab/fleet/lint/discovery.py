"""Load of a fleet before it runs: estimates of discovery, transforms and other topics, to compare layouts."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.fleet.lint.frames import edges_of
from sfglab.fleet.lint.report import AgentLoad, Announcements, Discovery
from sfglab.fleet.policy import Crossing, Direction
from sfglab.names import TF, DdsRole, ResourceKind, dds_names, ros_name_from_dds
from sfglab.qos import Durability

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from sfglab.fleet.fleet_file import AgentSpec
    from sfglab.fleet.lint.uses import Use, View

ROS_ENDPOINTS = 17
"""Of each ROS 2 process: rosout, parameter events and ros_discovery_info both ways, six parameter services."""

PAIR_BYTES = 1300
ENDPOINT_BYTES = 460
"""Received per ordered pair of participants, and per endpoint announced to one: fitted to two hosts with 20
participants each (Cyclone DDS, multicast). Repeats among six hosts under full load made it up to six times."""

_HEARD_BY_SPEAKER = {DdsRole.TOPIC: False, DdsRole.REQUEST: True, DdsRole.REPLY: False}


@dataclass(frozen=True, slots=True)
class _Endpoints:
    """DDS endpoints of one agent by topic, its latched writers counted apart as well."""

    writers: Counter[str]
    readers: Counter[str]
    latched: Counter[str]

    @property
    def total(self) -> int:
        return self.writers.total() + self.readers.total()


def _endpoints(uses: Sequence[Use]) -> _Endpoints:
    found = _Endpoints(writers=Counter(), readers=Counter(), latched=Counter())
    for use in uses:
        for dds in dds_names(use.name, use.kind):
            wire = ros_name_from_dds(dds)
            assert wire is not None, "made from a ROS name"
            reads = use.speaks is _HEARD_BY_SPEAKER[wire.role]
            (found.readers if reads else found.writers)[dds] += use.count
            if (
                not reads
                and use.qos is not None
                and use.qos.durability is Durability.TRANSIENT_LOCAL
            ):
                found.latched[dds] += use.count
    return found


def discovery(view: View) -> Discovery:
    """Return what discovery costs with one domain for all, and through routers."""
    agents = view.fleet.agents
    ends = {a.name: _endpoints([use for use in view.uses if use.agent == a.name]) for a in agents}
    local = {
        a.name: (a.processes, a.processes * ROS_ENDPOINTS + ends[a.name].total) for a in agents
    }
    shown = {a.name: _shown(view, a, ends) for a in agents}
    routed = _announcements({name: (1, count) for name, count in shown.items()})
    return Discovery(standard=_announcements(local), routed=routed, local=local, shown=shown)


def _shown(view: View, agent: AgentSpec, ends: Mapping[str, _Endpoints]) -> int:
    policy, own = view.fleet.policy, ends[agent.name]
    readers = sum(policy.crosses(dds, Direction.INWARD) for dds in own.readers)
    writers = 0
    for dds in own.writers:
        wanted = any(dds in end.readers for name, end in ends.items() if name != agent.name)
        if wanted and all(policy.crosses(dds, way) for way in Direction):
            writers += max(1, own.latched[dds])
    return readers + writers


def _announcements(hosts: Mapping[str, tuple[int, int]]) -> Announcements:
    """Count who tells whom what; hosts are (participants, endpoints) by name."""
    participants = sum(p for p, _ in hosts.values())
    endpoints = sum(e for _, e in hosts.values())
    pairs = sum(p * (participants - p) for p, _ in hosts.values())
    announced = sum(p * (endpoints - e) for p, e in hosts.values())
    size = pairs * PAIR_BYTES + announced * ENDPOINT_BYTES
    return Announcements(
        participants=participants,
        endpoints=endpoints,
        pairs=pairs,
        announced=announced,
        estimated_bytes=size,
    )


def transform_bytes(parent: str, child: str) -> int:
    """Return the size of a TFMessage with one transform, in bytes of CDR, header included."""
    at = 4 + 8  # sequence length, stamp
    for name in (parent, child):
        at += -at % 4 + 4 + len(name.encode()) + 1
    return 4 + at + -at % 8 + 7 * 8


def loads(view: View) -> tuple[AgentLoad, ...]:
    """Return what crosses each border in steady state: transforms one a message, topics once a subscriber."""
    hears_tf = {use.agent for use in view.uses if use.name == TF and not use.speaks}
    crosses = view.crossing(TF, ResourceKind.TOPIC) is Crossing.WHOLE
    sent = {a.name: _transforms(a) if crosses else (0.0, 0.0) for a in view.fleet.agents}
    rows = []
    for agent in view.fleet.agents:
        others = [name for name in sent if name != agent.name]
        out = sent[agent.name] if any(name in hears_tf for name in others) else (0.0, 0.0)
        heard = [sent[name] for name in others] if agent.name in hears_tf else []
        topics_out, topics_in, unsized = _topics(view, agent)
        rows.append(
            AgentLoad(
                agent=agent.name,
                tf_out_hz=out[0],
                tf_out_bps=out[1],
                tf_in_hz=sum(hz for hz, _ in heard),
                tf_in_bps=sum(bps for _, bps in heard),
                topics_out_bps=topics_out,
                topics_in_bps=topics_in,
                unsized=unsized,
            )
        )
    return tuple(rows)


def _transforms(agent: AgentSpec) -> tuple[float, float]:
    moving = [edge for edge in edges_of(agent) if not edge.frame.static]
    bits = sum(e.frame.rate_hz * 8 * transform_bytes(e.parent, e.child) for e in moving)
    return sum(e.frame.rate_hz for e in moving), bits


def _topics(view: View, agent: AgentSpec) -> tuple[float, float, tuple[str, ...]]:
    """Return bits a second out and in, and the topics whose size the file does not say."""
    out, into, unsized = 0.0, 0.0, []
    for (kind, name), meeting in view.meetings.items():
        if kind is not ResourceKind.TOPIC or view.crossing(name, kind) is not Crossing.WHOLE:
            continue
        hearers = {use.agent for use in meeting.hearers}
        for use in meeting.speakers:
            others = hearers - {use.agent}
            if use.implied or not others or agent.name not in {use.agent, *others}:
                continue
            if use.rate_hz is None or use.size_bytes is None:
                unsized.append(name)
                continue
            bits = use.rate_hz * use.size_bytes * 8
            out += bits * len(others) if use.agent == agent.name else 0
            into += bits if agent.name in others else 0
    return out, into, tuple(dict.fromkeys(unsized))
