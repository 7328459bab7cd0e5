"""Graphs as YAML: read strictly, written canonically.

What was written is read back equal, and what was read from a written text is written byte by byte the same.
Knows keys and kinds of values, and says for every refusal file, key, what was given and what is allowed.
Refuses to know what a graph is for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.documents import Document, DocumentError
from sfglab.soc.graph import Graph, GraphError, Implementation, Node, Placement, Topic, TopicMapping

if TYPE_CHECKING:
    from pathlib import Path

    from sfglab.documents import Section


_WIDTH = 110
_RARE_BREAKS = frozenset("\x85\u2028\u2029")


def load_graph(path: Path) -> Graph:
    """Read a graph from a file.

    Args:
        path: A YAML file, such as ``data/graphs/figure_8.yaml``.

    Raises:
        GraphError: It cannot be read, or does not say what it must; says where.
    """
    try:
        document = Document.of_file(path)
    except DocumentError as error:
        raise _graph_error(error) from error
    return _read(document)


def read_graph(text: str, *, file: str = "graph.yaml") -> Graph:
    """Read a graph from the text of a YAML file.

    Args:
        text: What stands in the file.
        file: Its name, for messages.

    Raises:
        GraphError: It does not say what it must; says where.
    """
    try:
        document = Document(text, file)
    except DocumentError as error:
        raise _graph_error(error) from error
    return _read(document)


def graph_text(graph: Graph) -> str:
    """Return a graph as the text of a YAML file; what has its default value is left out."""
    import yaml

    values = {
        "name": graph.name,
        "description": graph.description,
        "nodes": {node.name: _node_values(node) for node in graph.nodes},
        "topics": {topic.name: _topic_values(topic) for topic in graph.topics},
    }
    values = {key: value for key, value in values.items() if value or key == "nodes"}
    layout: dict[str, Any] = {"sort_keys": False, "default_flow_style": None, "width": _WIDTH}
    return str(yaml.dump(values, Dumper=_dumper(), allow_unicode=True, **layout))


def _dumper() -> Any:
    """Return PyYAML's dumper, which escapes rare line breaks here: raw, it would read them back as blanks."""
    import yaml

    class Dumper(yaml.SafeDumper):
        pass

    def represent(dumper: Dumper, text: str) -> yaml.ScalarNode:
        style = '"' if _RARE_BREAKS.intersection(text) else None
        return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)

    Dumper.add_representer(str, represent)
    return Dumper


def save_graph(graph: Graph, path: Path) -> None:
    """Write a graph into a file.

    Raises:
        GraphError: The file cannot be written.
    """
    try:
        path.write_text(graph_text(graph), encoding="utf-8")
    except OSError as error:
        raise GraphError("", str(path), f"a file that can be written ({error})") from error


def _node_values(node: Node) -> dict[str, Any]:
    hardware = node.hardware
    values: dict[str, Any] = {"placement": node.placement.value}
    if node.rate_hz:
        values["rate_hz"] = float(node.rate_hz)
    if node.software_s:
        values["software_s"] = float(node.software_s)
    if hardware is not None:
        numbers = {"lut": hardware.lut, "bram": float(hardware.bram), "time_s": float(hardware.time_s)}
        values["hardware"] = numbers
    return values


def _topic_values(topic: Topic) -> dict[str, Any]:
    values = {
        "type": topic.type or None,
        "size_bytes": topic.size_bytes,
        "rate_hz": None if topic.rate_hz is None else float(topic.rate_hz),
        "publishers": list(topic.publishers),
        "subscribers": list(topic.subscribers) or None,
        "mapping": None if topic.mapping is TopicMapping.SOFTWARE else topic.mapping.value,
    }
    return {key: value for key, value in values.items() if value is not None}


def _graph_error(error: DocumentError, file: str = "") -> GraphError:
    place = error.place
    return GraphError(place.key, error.given, error.allowed, place.file or file, place.line)


def _read(document: Document) -> Graph:
    """Read a graph; what the graph itself refuses gets the file's name."""
    try:
        return _read_graph(document.section())
    except DocumentError as error:
        raise _graph_error(error, document.file) from error


def _read_graph(top: Section) -> Graph:
    top.get("nodes")
    graph = Graph(
        name=top.text("name", ""),
        description=top.text("description", ""),
        nodes=tuple(_read_node(name, section) for name, section in top.members("nodes")),
        topics=tuple(_read_topic(name, section) for name, section in top.members("topics")),
    )
    top.close()
    return graph


def _read_node(name: str, section: Section) -> Node:
    node = Node(
        name=name,
        placement=section.choice("placement", Placement.SOFTWARE),
        rate_hz=section.number("rate_hz", 0.0),
        software_s=section.number("software_s", 0.0),
        hardware=None if section.get("hardware", None) is None else _read_hardware(section.section("hardware")),
    )
    section.close()
    return node


def _read_hardware(section: Section) -> Implementation:
    hardware = Implementation(
        lut=section.whole("lut", 0, low=0),
        bram=section.number("bram", 0.0),
        time_s=section.number("time_s", 0.0),
    )
    section.close()
    return hardware


def _read_topic(name: str, section: Section) -> Topic:
    topic = Topic(
        name=name,
        type=section.text("type", ""),
        size_bytes=section.whole("size_bytes", None, low=0),
        rate_hz=section.number("rate_hz", None),
        publishers=section.texts("publishers"),
        subscribers=section.texts("subscribers"),
        mapping=section.choice("mapping", TopicMapping.SOFTWARE),
    )
    section.close()
    return topic
