"""Estimated traffic of discovery, with one domain for all agents and through routers."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING

from sfglab.fleet.lint.report import Announcements, Discovery
from sfglab.fleet.policy import Direction
from sfglab.names import DdsRole, dds_names, ros_name_from_dds
from sfglab.qos import Durability

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from sfglab.fleet.lint.uses import Use, View

ROS_ENDPOINTS = 17
"""Endpoints of each ROS 2 process: a writer of rosout, a writer and a reader each of parameter events and
ros_discovery_info, and six parameter services."""

PAIR_BYTES = 1300
ENDPOINT_BYTES = 460
"""Bytes received per ordered pair of participants, and per endpoint announced to one participant.

The values were fitted to two hosts with 20 participants each (Cyclone DDS, multicast). With six hosts under
full load, repeated messages increased the traffic up to six times.
"""


def discovery(view: View) -> Discovery:
    """Return the estimated traffic of discovery with one domain for all agents, and through routers."""
    readers: dict[str, set[str]] = defaultdict(set)  # agents with a reader, by DDS topic
    writers: Counter[tuple[str, str]] = Counter()  # transient-local writers by agent and DDS topic
    endpoints: Counter[str] = Counter()
    for use in view.uses:
        is_latched = use.qos is not None and use.qos.durability is Durability.TRANSIENT_LOCAL
        for dds, is_writer in _endpoints(use):
            endpoints[use.agent] += use.count
            if is_writer:
                writers[use.agent, dds] += use.count if is_latched else 0
            else:
                readers[dds].add(use.agent)
    # Each router opens a reader per topic, and one writer, or one per transient-local writer behind it.
    shown = dict.fromkeys((agent.name for agent in view.fleet.agents), 0)
    crosses = view.fleet.policy.crosses
    for dds, agents in readers.items():
        if crosses(dds, Direction.INWARD):
            for agent in agents:
                shown[agent] += 1
    for (agent, dds), latched in writers.items():
        if readers.get(dds, set()) - {agent} and all(crosses(dds, way) for way in Direction):
            shown[agent] += max(1, latched)
    local = {
        agent.name: (agent.processes, agent.processes * ROS_ENDPOINTS + endpoints[agent.name])
        for agent in view.fleet.agents
    }
    return Discovery(
        standard=_announcements(local.values()),
        routed=_announcements((1, count) for count in shown.values()),
        local=local,
        shown=shown,
    )


def _endpoints(use: Use) -> Iterator[tuple[str, bool]]:
    """Yield the DDS topic of each endpoint, and whether it is a writer."""
    for dds in dds_names(use.name, use.kind):
        wire = ros_name_from_dds(dds)
        assert wire is not None, "made from a ROS name"
        yield dds, use.speaks is not (wire.role is DdsRole.REQUEST)


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
