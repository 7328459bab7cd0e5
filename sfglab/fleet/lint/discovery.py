"""Estimated traffic of discovery, with one domain for all agents and through routers."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from sfglab.fleet.lint.report import Announcements, Discovery
from sfglab.fleet.policy import Direction
from sfglab.names import DdsRole, dds_names, ros_name_from_dds
from sfglab.qos import Durability

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from sfglab.fleet.lint.uses import Use, View
    from sfglab.fleet.policy import Policy

ROS_ENDPOINTS = 17
"""Endpoints of each ROS 2 process: a writer of rosout, a writer and a reader each of parameter events and
ros_discovery_info, and six parameter services."""

PAIR_BYTES = 1300
ENDPOINT_BYTES = 460
"""Bytes received per ordered pair of participants, and per endpoint announced to one participant.

The values were fitted to two hosts with 20 participants each (Cyclone DDS, multicast). With six hosts under
full load, repeated messages increased the traffic up to six times.
"""


@dataclass(slots=True)
class _Endpoints:
    """Numbers of DDS endpoints of one agent by topic; transient-local writers are also counted separately."""

    writers: Counter[str] = field(default_factory=Counter)
    readers: Counter[str] = field(default_factory=Counter)
    latched: Counter[str] = field(default_factory=Counter)

    def __len__(self) -> int:
        return self.writers.total() + self.readers.total()


def _endpoints(uses: Iterable[Use]) -> _Endpoints:
    found = _Endpoints()
    for use in uses:
        is_latched = use.qos is not None and use.qos.durability is Durability.TRANSIENT_LOCAL
        for dds in dds_names(use.name, use.kind):
            wire = ros_name_from_dds(dds)
            assert wire is not None, "made from a ROS name"
            if use.speaks is (wire.role is DdsRole.REQUEST):
                found.readers[dds] += use.count
                continue
            found.writers[dds] += use.count
            if is_latched:
                found.latched[dds] += use.count
    return found


def discovery(view: View) -> Discovery:
    """Return the estimated traffic of discovery with one domain for all agents, and through routers."""
    ends, local, shown = {}, {}, {}
    for agent in view.fleet.agents:
        ends[agent.name] = _endpoints(use for use in view.uses if use.agent == agent.name)
        endpoints = agent.processes * ROS_ENDPOINTS + len(ends[agent.name])
        local[agent.name] = (agent.processes, endpoints)
    for name in ends:
        shown[name] = _shown(view.fleet.policy, name, ends)
    return Discovery(
        standard=_announcements(local.values()),
        routed=_announcements((1, count) for count in shown.values()),
        local=local,
        shown=shown,
    )


def _shown(policy: Policy, agent: str, ends: Mapping[str, _Endpoints]) -> int:
    """Return the number of endpoints of an agent's router in the global domain."""
    own = ends[agent]
    others = [end.readers for name, end in ends.items() if name != agent]
    count = sum(policy.crosses(dds, Direction.INWARD) for dds in own.readers)
    for dds in own.writers:
        crosses = all(policy.crosses(dds, direction) for direction in Direction)
        if crosses and any(dds in readers for readers in others):
            count += max(1, own.latched[dds])
    return count


def _announcements(hosts: Iterable[tuple[int, int]]) -> Announcements:
    """Count what participants announce to participants of other hosts; a host is (participants, endpoints)."""
    counts = list(hosts)
    participants = sum(p for p, _ in counts)
    endpoints = sum(e for _, e in counts)
    pairs = sum(p * (participants - p) for p, _ in counts)
    announced = sum(p * (endpoints - e) for p, e in counts)
    return Announcements(
        participants=participants,
        endpoints=endpoints,
        pairs=pairs,
        announced=announced,
        estimated_bytes=pairs * PAIR_BYTES + announced * ENDPOINT_BYTES,
    )
