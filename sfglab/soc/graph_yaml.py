"""Graphs as YAML: read strictly, written canonically.

What was written is read back equal, and what was read from a written text is written byte by byte the same.
Knows keys and kinds of values, and says for every refusal file, key, what was given and what is allowed.
Refuses to know what a graph is for.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Any, TypeVar

from sfglab.soc.graph import (
    Graph,
    GraphError,
    Implementation,
    Node,
    Placement,
    Topic,
    TopicMapping,
    suggestion,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

__all__ = ["graph_text", "load_graph", "read_graph", "save_graph"]

_Choice = TypeVar("_Choice", bound=Enum)
_WIDTH = 110


def load_graph(path: Path) -> Graph:
    """Read a graph from a file.

    Args:
        path: A YAML file, such as ``data/graphs/figure_8.yaml``.

    Raises:
        GraphError: It cannot be read, or does not say what it must; says where.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise GraphError("", str(path), f"a readable text file ({error})", path.name) from error
    return read_graph(text, file=path.name)


def read_graph(text: str, *, file: str = "graph.yaml") -> Graph:
    """Read a graph from the text of a YAML file.

    Args:
        text: What stands in the file.
        file: Its name, for messages.

    Raises:
        GraphError: It does not say what it must; says where.
    """
    try:
        return _read(_Section("", _parse(text)))
    except GraphError as error:
        raise GraphError(error.key, error.given, error.allowed, file) from error


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
    return yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=_WIDTH, allow_unicode=True)


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


def _read(top: _Section) -> Graph:
    graph = Graph(
        name=top.text("name"),
        description=top.text("description"),
        nodes=tuple(_read_node(name, section) for name, section in top.members("nodes", needed=True)),
        topics=tuple(_read_topic(name, section) for name, section in top.members("topics")),
    )
    top.close()
    return graph


def _read_node(name: str, section: _Section) -> Node:
    node = Node(
        name=name,
        placement=section.choice("placement", Placement.SOFTWARE),
        rate_hz=section.number("rate_hz") or 0.0,
        software_s=section.number("software_s") or 0.0,
        hardware=None if section.get("hardware") is None else _read_hardware(section.section("hardware")),
    )
    section.close()
    return node


def _read_hardware(section: _Section) -> Implementation:
    hardware = Implementation(
        lut=section.whole("lut") or 0,
        bram=section.number("bram") or 0.0,
        time_s=section.number("time_s") or 0.0,
    )
    section.close()
    return hardware


def _read_topic(name: str, section: _Section) -> Topic:
    topic = Topic(
        name=name,
        type=section.text("type"),
        size_bytes=section.whole("size_bytes"),
        rate_hz=section.number("rate_hz"),
        publishers=section.texts("publishers"),
        subscribers=section.texts("subscribers"),
        mapping=section.choice("mapping", TopicMapping.SOFTWARE),
    )
    section.close()
    return topic


class _Section:
    """One mapping of the file, read key by key; `close` refuses keys that nobody has read."""

    def __init__(self, key: str, value: Any) -> None:
        if not isinstance(value, dict):
            raise GraphError(key, value, "a mapping of keys to values")
        self.key, self.values = key, value
        self._known: set[str] = set()

    def place(self, key: str) -> str:
        return f"{self.key}.{key}" if self.key else key

    def get(self, key: str, default: Any = None) -> Any:
        self._known.add(key)
        return self.values.get(key, default)

    def _of_kind(self, key: str, kinds: type | tuple[type, ...], allowed: str) -> Any:
        value = self.get(key)
        if key in self.values and (isinstance(value, bool) or not isinstance(value, kinds)):
            raise GraphError(self.place(key), value, allowed)
        return value

    def text(self, key: str) -> str:
        return self._of_kind(key, str, "a text") or ""

    def whole(self, key: str) -> int | None:
        value: int | None = self._of_kind(key, int, "a whole number from 0")
        return value

    def number(self, key: str) -> float | None:
        value = self._of_kind(key, (int, float), "a finite number from 0")
        return None if value is None else float(value)

    def texts(self, key: str) -> tuple[str, ...]:
        value = self._of_kind(key, list, "a list of names") or []
        for item in value:
            if not isinstance(item, str) or not item:
                raise GraphError(self.place(key), item, "names that are texts (quote numbers)")
        return tuple(value)

    def choice(self, key: str, default: _Choice) -> _Choice:
        names = [member.value for member in type(default)]
        value = self.get(key, default.value)
        if value not in names:
            raise GraphError(self.place(key), value, " or ".join(names) + suggestion(value, names))
        return type(default)(value)

    def section(self, key: str) -> _Section:
        return _Section(self.place(key), self.get(key, {}))

    def members(self, key: str, *, needed: bool = False) -> Iterator[tuple[str, _Section]]:
        if needed and key not in self.values:
            raise GraphError(self.place(key), None, f"{key!r} is needed here")
        inner = self.section(key)
        for name in inner.values:
            yield name, inner.section(name)

    def close(self) -> None:
        for key in self.values:
            if key not in self._known:
                allowed = ", ".join(sorted(self._known)) + suggestion(key, self._known)
                raise GraphError(self.place(key), key, allowed)


def _parse(text: str) -> Any:
    """Return YAML's plain values; refuse keys that stand twice, which its loader takes, or are no texts."""
    import yaml

    loader = yaml.SafeLoader(text)
    try:
        root = loader.get_single_node()
        return None if root is None else _value(loader, root, ())
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        if isinstance(error, GraphError):
            raise
        raise GraphError("", " ".join(str(error).split()), "YAML") from error
    finally:
        loader.dispose()


def _value(loader: Any, node: Any, path: tuple[str, ...]) -> Any:
    import yaml

    if isinstance(node, yaml.SequenceNode):
        return [_value(loader, item, path) for item in node.value]
    if not isinstance(node, yaml.MappingNode):
        return loader.construct_object(node)
    values: dict[str, Any] = {}
    for key, value in node.value:
        inner = (*path, str(key.value))
        if key.tag != "tag:yaml.org,2002:str":
            raise GraphError(".".join(inner), key.value, "a key that is a text (quote it)")
        if key.value in values:
            raise GraphError(".".join(inner), key.value, "each key once, and it is defined twice")
        values[key.value] = _value(loader, value, inner)
    return values
