"""A graph in the words of ROS 2's tools: its topics, services, actions and nodes, as values and as text.

Knows what is hidden, and which topics of the wire make a service or an action. Refuses to know terminals.
"""

from __future__ import annotations

import asyncio
import difflib
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from sfglab import names
from sfglab.bus.api import FAST_DDS, EndpointInfo, EndpointKind, NodeInfo, entries
from sfglab.errors import InvalidValueError
from sfglab.qos import Durability, History, QoSProfile, Reliability

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from sfglab.bus.node import Node

Types = dict[str, tuple[str, ...]]  #: Names, sorted, each with its types.

_QUIET_S = 0.7  #: How long nothing new may come.
_LIMIT_S = 5.0  #: How long is waited at most, and while there is nobody.
_FEEDBACK, _FEEDBACK_TYPE = "/_action/feedback", "_FeedbackMessage"
_TYPE_HASH = "typehash"
BARE = "_CREATED_BY_BARE_DDS_APP_"  #: rmw's name of who announces no node.


def is_hidden(name: str) -> bool:
    """Return whether ROS 2's tools leave a name out, as they do where a part of it begins with ``_``."""
    return "/_" in f"/{name}"


@dataclass(frozen=True, slots=True)
class View:
    """The graph at a moment, without the node that looks."""

    endpoints: tuple[EndpointInfo, ...]  #: All that belong to a ROS name.
    nodes: tuple[NodeInfo, ...]  #: All nodes, by name.

    def topics(self, *, hidden: bool = False, of: Callable[[EndpointInfo], bool] = bool) -> Types:
        """Return topics of those endpoints."""
        found = (e for e in self.endpoints if _role(e) is names.DdsRole.TOPIC and of(e))
        return _by_name(((e.topic, e.type) for e in found), hidden=hidden)

    def services(self, *, hidden: bool = False, of: Callable[[EndpointInfo], bool] = bool) -> Types:
        """Return services of those endpoints."""
        found = ((e, names.ros_name_from_dds(e.dds_topic)) for e in self.endpoints if of(e))
        halves = [
            (wire.name, e.type)
            for e, wire in found
            if wire and wire.role is not names.DdsRole.TOPIC
        ]
        return _by_name(((name, type_.rpartition("_")[0]) for name, type_ in halves), hidden=hidden)

    def actions(self, *, hidden: bool = False, of: Callable[[EndpointInfo], bool] = bool) -> Types:
        """Return actions of those endpoints, which are known by their feedback."""
        found = {
            topic.removesuffix(_FEEDBACK): tuple(
                type_.removesuffix(_FEEDBACK_TYPE) for type_ in types
            )
            for topic, types in self.topics(hidden=True, of=of).items()
            if topic.endswith(_FEEDBACK)
        }
        return {name: types for name, types in found.items() if hidden or not is_hidden(name)}

    def ends(self, topic: str, kind: EndpointKind) -> list[EndpointInfo]:
        """Return a topic's publishers or subscriptions."""
        return [e for e in self.endpoints if e.topic == topic and e.kind is kind]

    def of_node(self, name: str, *, hidden: bool = False) -> dict[str, Types]:
        """Return what a node has, under the heads of `ros2 node info`.

        Raises:
            InvalidValueError: There is no such node.
        """
        one_of([node.full_name for node in self.nodes], name, "node")

        def which(kind: EndpointKind, prefix: str) -> Callable[[EndpointInfo], bool]:
            return lambda e: e.node == name and e.kind is kind and e.dds_topic.startswith(prefix)

        sends, hears = EndpointKind.PUBLISHER, EndpointKind.SUBSCRIPTION
        return {
            "Subscribers": self.topics(hidden=hidden, of=which(hears, "rt/")),
            "Publishers": self.topics(hidden=hidden, of=which(sends, "rt/")),
            "Service Servers": self.services(hidden=hidden, of=which(hears, "rq/")),
            "Service Clients": self.services(hidden=hidden, of=which(sends, "rq/")),
            "Action Servers": self.actions(hidden=hidden, of=which(sends, "rt/")),
            "Action Clients": self.actions(hidden=hidden, of=which(hears, "rt/")),
        }


_NOTHING = View((), ())


def _role(endpoint: EndpointInfo) -> names.DdsRole | None:
    wire = names.ros_name_from_dds(endpoint.dds_topic)
    return wire.role if wire else None


def _by_name(pairs: Iterable[tuple[str, str]], *, hidden: bool) -> Types:
    found: dict[str, set[str]] = {}
    for name, type_ in pairs:
        if hidden or not is_hidden(name):
            found.setdefault(name, set()).add(type_)
    return {name: tuple(sorted(found[name])) for name in sorted(found)}


def one_of(known: Iterable[str], name: str, what: str) -> str:
    """Return a name that is known.

    Raises:
        InvalidValueError: It is not; names those that look similar.
    """
    if name in (there := list(dict.fromkeys(known))):
        return name
    near = difflib.get_close_matches(name, there, n=5, cutoff=0.5) or there[:5]
    allowed = f"one that is there, such as {', '.join(near)}" if near else "there is none"
    raise InvalidValueError(what, name, allowed)


def view(node: Node) -> View:
    """Return what a node knows of the others."""
    seen = tuple(e for e in node.graph.endpoints() if e.participant != node.guid and _role(e))
    return View(seen, tuple(one for one in node.graph.nodes() if one.participant != node.guid))


def _is_half_known(endpoint: EndpointInfo) -> bool:
    """Whether it is ROS 2's, as its type's hash says, and its node's announcement is yet to come."""
    return not endpoint.node and _TYPE_HASH in entries(endpoint.user_data)


async def settled(node: Node, spin_s: float | None = None) -> View:
    """Return the graph once it stands still, or after so many seconds."""
    node.graph.nodes()  # from now on they are read
    if spin_s is not None:
        await asyncio.sleep(spin_s)
        return view(node)
    end_s, before = time.monotonic() + _LIMIT_S, _NOTHING
    while time.monotonic() < end_s:
        await asyncio.sleep(_QUIET_S)
        if (now := view(node)) == before != _NOTHING and not any(
            map(_is_half_known, now.endpoints)
        ):
            break
        before = now
    return view(node)


def node_of(endpoint: EndpointInfo) -> tuple[str, str]:
    """Return the namespace and the name of an endpoint's node, in rmw's words where it has none."""
    namespace, _, name = endpoint.node.rpartition("/")
    return (namespace or "/", name) if name else (BARE, BARE)


def endpoint_text(endpoint: EndpointInfo) -> str:
    """Return an endpoint as `ros2 topic info -v` prints it."""
    namespace, name = node_of(endpoint)
    qos = endpoint.qos
    kept = qos.history.name + (f" ({qos.depth})" if qos.history is History.KEEP_LAST else "")
    lines = [
        f"Node name: {name}",
        f"Node namespace: {namespace}",
        f"Topic type: {endpoint.type}",
        f"Topic type hash: {_hash(endpoint)}",
        f"Endpoint type: {endpoint.kind.name}",
        f"GID: {endpoint.gid.hex('.')}",
        "QoS profile:",
        f"  Reliability: {qos.reliability.name}",
        f"  History (Depth): {'UNKNOWN' if tells_no_history(endpoint) else kept}",
        f"  Durability: {qos.durability.name}",
        f"  Lifespan: {_duration(qos.lifespan_ns)}",
        f"  Deadline: {_duration(qos.deadline_ns)}",
        f"  Liveliness: {qos.liveliness.name}",
        f"  Liveliness lease duration: {_duration(qos.lease_ns)}",
    ]
    return "\n".join(lines)


def endpoint_values(endpoint: EndpointInfo) -> dict[str, Any]:
    """Return an endpoint as JSON values; durations in nanoseconds, null where they are infinite."""
    namespace, name = node_of(endpoint)
    qos, unknown = endpoint.qos, tells_no_history(endpoint)
    return {
        "node_name": name,
        "node_namespace": namespace,
        "topic_type": endpoint.type,
        "topic_type_hash": _hash(endpoint),
        "endpoint_type": endpoint.kind.name,
        "gid": endpoint.gid.hex("."),
        "transport": endpoint.transport,
        "reliability": qos.reliability.name,
        "history": "UNKNOWN" if unknown else qos.history.name,
        "depth": None if unknown or qos.history is History.KEEP_ALL else qos.depth,
        "durability": qos.durability.name,
        "lifespan_ns": qos.lifespan_ns,
        "deadline_ns": qos.deadline_ns,
        "liveliness": qos.liveliness.name,
        "liveliness_lease_ns": qos.lease_ns,
    }


def tells_no_history(endpoint: EndpointInfo) -> bool:
    """Return whether its middleware does not announce how much it keeps."""
    return endpoint.gid.startswith(FAST_DDS)


def _hash(endpoint: EndpointInfo) -> str:
    return entries(endpoint.user_data).get(_TYPE_HASH, "INVALID")


def _duration(duration_ns: int | None) -> str:
    return "Infinite" if duration_ns is None else f"{duration_ns} nanoseconds"


def names_text(found: Mapping[str, tuple[str, ...]], *, show_types: bool) -> str:
    """Return names, a line each, as ROS 2's lists print them."""
    lines = (
        f"{name} [{', '.join(types)}]" if show_types else name for name, types in found.items()
    )
    return "".join(f"{line}\n" for line in lines)


def requested(declared: QoSProfile, offered: Iterable[QoSProfile]) -> QoSProfile:
    """Return what to request so that it matches all that is offered, as near as can be to what is declared."""
    profiles = tuple(offered)
    if any(profile.reliability is Reliability.BEST_EFFORT for profile in profiles):
        declared = replace(declared, reliability=Reliability.BEST_EFFORT)
    if any(profile.durability is Durability.VOLATILE for profile in profiles):
        declared = replace(declared, durability=Durability.VOLATILE)
    return declared


def usual_qos(publishers: Iterable[EndpointInfo]) -> QoSProfile:
    """Return what to request of publishers as ROS 2's tools do: repair and the past where all offer them."""
    offered = [publisher.qos for publisher in publishers]
    past = Durability.TRANSIENT_LOCAL if offered else Durability.VOLATILE
    return requested(QoSProfile(durability=past, history=History.KEEP_ALL), offered)
