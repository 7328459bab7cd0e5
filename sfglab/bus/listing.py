"""Topics and nodes of a graph as ROS 2's tools list them, and hidden names."""

from __future__ import annotations

import asyncio
import difflib
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sfglab import names
from sfglab.bus.api import FAST_DDS, EndpointInfo, EndpointKind, NodeInfo, entries
from sfglab.bus.graph import types_by_topic
from sfglab.errors import InvalidValueError
from sfglab.qos import Durability, History, QoSProfile, Reliability

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from sfglab.bus.node import Node

Types = dict[str, tuple[str, ...]]  #: Sorted names, each with its types.

_QUIET_S = 0.7  #: Time without a change after which the graph is settled, s.
_LIMIT_S = 5.0  #: Longest wait for a settled graph, and wait while the graph is empty, s.
_TYPE_HASH = "typehash"


def is_hidden(name: str) -> bool:
    """Return whether ROS 2's tools hide a name, because a part of it begins with ``_``."""
    return "/_" in f"/{name}"


@dataclass(frozen=True, slots=True)
class View:
    """Snapshot of the graph, without the observing node."""

    endpoints: tuple[EndpointInfo, ...]  #: Endpoints whose DDS topic has a ROS name.
    nodes: tuple[NodeInfo, ...]  #: Nodes, ordered by name.

    def topics(self, *, hidden: bool = False) -> Types:
        """Return the types of each topic, by the topic's name; hidden topics only if `hidden` is True."""
        return types_by_topic(
            end
            for end in self.endpoints
            if _role(end) is names.DdsRole.TOPIC and (hidden or not is_hidden(end.topic))
        )

    def ends(self, topic: str, kind: EndpointKind) -> list[EndpointInfo]:
        """Return the endpoints of one kind of a topic: its publishers or its subscriptions."""
        return [e for e in self.endpoints if e.topic == topic and e.kind is kind]


_NOTHING = View((), ())


def _role(endpoint: EndpointInfo) -> names.DdsRole | None:
    wire = names.ros_name_from_dds(endpoint.dds_topic)
    return wire.role if wire else None


def one_of(known: Iterable[str], name: str, what: str) -> str:
    """Return a name unchanged if it is one of the known names.

    Args:
        known: Known names.
        name: Name to check.
        what: Kind of the name in the error's text, such as ``topic``.

    Raises:
        InvalidValueError: The name is unknown; the error lists similar names.
    """
    there = list(known)
    if name in there:
        return name
    near = difflib.get_close_matches(name, there, n=5, cutoff=0.5) or there[:5]
    allowed = f"an existing name, such as {', '.join(near)}"
    if not near:
        allowed = "an existing name; none was found, so check the domain and the interface"
    raise InvalidValueError(what, name, allowed)


def view(node: Node) -> View:
    """Return the graph of a node without the node itself."""
    seen = tuple(e for e in node.graph.endpoints() if e.participant != node.guid and _role(e))
    return View(seen, tuple(one for one in node.graph.nodes() if one.participant != node.guid))


def _is_half_known(endpoint: EndpointInfo) -> bool:
    """Return whether an endpoint is of ROS 2, which its type hash shows, and its node is not announced yet."""
    return not endpoint.node and _TYPE_HASH in entries(endpoint.user_data)


async def settled(node: Node, spin_s: float | None = None) -> View:
    """Return the graph after `spin_s` seconds; with None once it no longer changes, after 5 s at most."""
    node.graph.nodes()  # the first call starts the reading of nodes
    if spin_s is not None:
        await asyncio.sleep(spin_s)
        return view(node)
    end_s = time.monotonic() + _LIMIT_S
    now = _NOTHING
    while time.monotonic() < end_s:
        await asyncio.sleep(_QUIET_S)
        before, now = now, view(node)
        if now == before != _NOTHING and not any(map(_is_half_known, now.endpoints)):
            break
    return now


def tells_no_history(endpoint: EndpointInfo) -> bool:
    """Return whether the middleware of an endpoint does not announce the history."""
    return endpoint.gid.startswith(FAST_DDS)


def names_text(found: Mapping[str, tuple[str, ...]], *, show_types: bool) -> str:
    """Return names, one per line, as ROS 2's tools print them."""
    lines = (
        f"{name} [{', '.join(types)}]" if show_types else name for name, types in found.items()
    )
    return "".join(f"{line}\n" for line in lines)


def requested(declared: QoSProfile, offered: Iterable[QoSProfile]) -> QoSProfile:
    """Return the QoS to request: the profile closest to `declared` that matches all offered profiles."""
    profiles = tuple(offered)
    if any(profile.reliability is Reliability.BEST_EFFORT for profile in profiles):
        declared = replace(declared, reliability=Reliability.BEST_EFFORT)
    if any(profile.durability is Durability.VOLATILE for profile in profiles):
        declared = replace(declared, durability=Durability.VOLATILE)
    return declared


def usual_qos(publishers: Iterable[EndpointInfo]) -> QoSProfile:
    """Return the QoS that ROS 2's tools request: RELIABLE and TRANSIENT_LOCAL if all publishers offer them."""
    offered = [publisher.qos for publisher in publishers]
    past = Durability.TRANSIENT_LOCAL if offered else Durability.VOLATILE
    return requested(QoSProfile(durability=past, history=History.KEEP_ALL), offered)
