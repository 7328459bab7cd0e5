"""Graphs from what is there: a recorded log, or the live graph of a DDS domain.

Neither says where nodes run, so all of them are placed in software. What cannot stand in a graph is left out
and named with the reason. Knows logs and endpoints. Refuses to know what is done with a graph.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any

from sfglab.documents import DocumentError, Place
from sfglab.soc.graph import Graph, Node, Topic
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from sfglab import bus
    from sfglab.bus import EndpointInfo
    from sfglab.record import LogReader


METADATA = "computation_graph"
"""Name of the metadata record in which a log says who publishes and who subscribes; see `graph_metadata`."""

_ROS_OWN = frozenset({"/rosout", "/parameter_events"})
_SAMPLES = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """A topic that is not in the graph."""

    topic: str  #: Its name.
    why: str  #: Why not.


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportedGraph:
    """A graph and what is missing from it."""

    graph: Graph  #: All nodes in software.
    left_out: tuple[LeftOut, ...] = ()  #: Topics that are not in it.


def graph_metadata(graph: Graph) -> dict[str, Any]:
    """Return the values of the metadata record `METADATA`, to be written into a log beside its messages.

    A log's channels say what was published, but not by whom; `graph_from_log` reads that from this record.
    """
    return {
        topic.name: {"publishers": list(topic.publishers), "subscribers": list(topic.subscribers)}
        for topic in graph.topics
    }


def graph_from_log(log: LogReader) -> ImportedGraph:
    """Return the graph that an open log of any recorder shows: its topics with types, sizes and rates.

    Sizes are means, and rates follow from the times, of the first messages of each topic. Publishers and
    subscribers are those of the log's metadata record `METADATA`; a topic that it does not name gets one node
    of its own, called ``publisher of <topic>``, and no subscribers. Tables are no topics.

    Raises:
        DocumentError: The metadata record is not what `graph_metadata` returns.
        LogError: The log is damaged.
    """
    owners = _owners(log)
    tables = {f"/table/{name}" for name in log.tables}
    topics, left_out = [], []
    for name, info in log.topics.items():
        if name in tables:
            continue
        publishers, subscribers = owners.get(name, ((f"publisher of {name}",), ()))
        if not publishers:
            left_out.append(LeftOut(topic=name, why=f"no publisher in the record {METADATA!r}"))
            continue
        size_bytes, rate_hz = _traffic(log, name)
        topic = Topic(
            name=name,
            type=info.type_name,
            size_bytes=size_bytes,
            rate_hz=rate_hz,
            publishers=publishers,
            subscribers=subscribers,
        )
        topics.append(topic)
    return ImportedGraph(graph=_graph(topics, log.path.name), left_out=tuple(left_out))


def graph_from_endpoints(endpoints: Iterable[EndpointInfo], *, name: str = "") -> ImportedGraph:
    """Return the graph, called `name`, of some endpoints, such as those of `sfglab.bus.Graph.endpoints`.

    Nodes have the names by which their participants announce them; an endpoint whose owner is unknown belongs
    to a node named after its participant. Services, and the topics that every ROS node has, are no part of
    the graph; sizes and rates are unknown.
    """
    from sfglab.bus import EndpointKind

    types: dict[str, set[str]] = defaultdict(set)
    sides: dict[EndpointKind, dict[str, set[str]]] = {kind: defaultdict(set) for kind in EndpointKind}
    for endpoint in endpoints:
        if endpoint.dds_topic.startswith("rt/") and endpoint.topic not in _ROS_OWN:
            types[endpoint.topic].add(endpoint.type)
            owner = endpoint.node or f"participant {endpoint.participant.hex()}"
            sides[endpoint.kind][endpoint.topic].add(owner)
    topics, left_out = [], []
    for topic, kinds in sorted(types.items()):
        publishers = tuple(sorted(sides[EndpointKind.PUBLISHER][topic]))
        subscribers = tuple(sorted(sides[EndpointKind.SUBSCRIPTION][topic]))
        if why := _obstacle(publishers, kinds):
            left_out.append(LeftOut(topic=topic, why=why))
            continue
        topics.append(Topic(name=topic, type=min(kinds), publishers=publishers, subscribers=subscribers))
    return ImportedGraph(graph=_graph(topics, name), left_out=tuple(left_out))


async def watch_graph(node: bus.Node, *, timeout_s: float = 5.0) -> ImportedGraph:
    """Return the graph that a node of the bus sees, once the owner of every topic's endpoints is known.

    The open node's own topics are part of it. After `timeout_s` seconds, owners that are still unknown stay
    so.
    """
    seen = node.graph
    seen.nodes()  # from now on owners are learnt
    await seen.wait_for(
        lambda: (
            bool(seen.endpoints())
            and all(endpoint.node for endpoint in seen.endpoints() if endpoint.dds_topic.startswith("rt/"))
        ),
        timeout_s,
    )
    return graph_from_endpoints(seen.endpoints(), name=f"seen by {node.name}")


def _obstacle(publishers: tuple[str, ...], types: set[str]) -> str:
    if not publishers:
        return "nobody publishes it"
    if len(types) > 1:
        return f"it has more than one type: {', '.join(sorted(types))}"
    return ""


def _graph(topics: list[Topic], name: str) -> Graph:
    members = dict.fromkeys(member for topic in topics for member in topic.members)
    return Graph(name=name, nodes=tuple(Node(name=member) for member in members), topics=tuple(topics))


def _owners(log: LogReader) -> Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]]:
    if METADATA not in log.metadata_names:
        return {}
    owners = {}
    for topic, sides in log.metadata(METADATA).items():
        found = [sides.get(key, []) for key in ("publishers", "subscribers")] if isinstance(sides, dict) else []
        if not found or not all(isinstance(s, list) and all(isinstance(n, str) for n in s) for s in found):
            place = Place(file=log.path.name, key=f"{METADATA}.{topic}")
            raise DocumentError(place, sides, "lists of names as publishers and subscribers")
        owners[topic] = (tuple(found[0]), tuple(found[1]))
    return owners


def _traffic(log: LogReader, topic: str) -> tuple[int | None, float | None]:
    """Return mean size and rate of a topic's first messages, None for what cannot be told."""
    found = list(islice(log.messages(topic), _SAMPLES))
    if not found:
        return None, None
    size_bytes = round(sum(len(message.cdr) for message in found) / len(found))
    duration_ns = found[-1].log_time_ns - found[0].log_time_ns
    return size_bytes, (len(found) - 1) * NS_PER_S / duration_ns if duration_ns else None
