"""A graph in the words of ROS 2's tools: its topics and nodes, and what is hidden."""

from __future__ import annotations

import asyncio
import difflib
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sfglab import names
from sfglab.bus.api import FAST_DDS, EndpointInfo, EndpointKind, NodeInfo, entries
from sfglab.errors import InvalidValueError
from sfglab.qos import Durability, History, QoSProfile, Reliability

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from sfglab.bus.node import Node

Types = dict[str, tuple[str, ...]]  #: Names, sorted, each with its types.

_QUIET_S = 0.7  #: How long nothing new may come.
_LIMIT_S = 5.0  #: How long is waited at most, and while there is nobody.
_TYPE_HASH = "typehash"


def is_hidden(name: str) -> bool:
    """Return whether ROS 2's tools leave a name out, as they do where a part of it begins with ``_``."""
    return "/_" in f"/{name}"


@dataclass(frozen=True, slots=True)
class View:
    """The graph at a moment, without the node that looks."""

    endpoints: tuple[EndpointInfo, ...]  #: All that belong to a ROS name.
    nodes: tuple[NodeInfo, ...]  #: All nodes, by name.

    def topics(self, *, hidden: bool = False) -> Types:
        """Return topics with their types."""
        found = (e for e in self.endpoints if _role(e) is names.DdsRole.TOPIC)
        return _by_name(((e.topic, e.type) for e in found), hidden=hidden)

    def ends(self, topic: str, kind: EndpointKind) -> list[EndpointInfo]:
        """Return a topic's publishers or subscriptions."""
        return [e for e in self.endpoints if e.topic == topic and e.kind is kind]


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


def tells_no_history(endpoint: EndpointInfo) -> bool:
    """Return whether its middleware does not announce how much it keeps."""
    return endpoint.gid.startswith(FAST_DDS)


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
