"""From a fleet file to a `Fleet`: every key that there is, its type, its range and its default.

Refuses what is not a fleet at all: unknown keys, wrong types, names that ROS or the schema's agent segment
forbid, domains that DDS does not have. Whether the fleet makes sense is for `sfglab.fleet.lint`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab.documents import Document, DocumentError, Place, Section, suggestion
from sfglab.fleet.fleet_file.deployment import read_deployment, read_host
from sfglab.fleet.fleet_file.model import (
    AgentSpec,
    Fleet,
    FrameSpec,
    FrameTree,
    NameUse,
    SensorSpec,
    StreamSpec,
    TopicUse,
)
from sfglab.fleet.policy import TABLE_1, Direction, ForwardRule, Policy
from sfglab.names import SHARED_FRAMES, FqnError, ResourceKind, validate_agent, validate_ros_name
from sfglab.qos import (
    COMPRESSED_STREAM,
    DEFAULT,
    LATCHED,
    SENSOR_DATA,
    SERVICES,
    Durability,
    History,
    QoSProfile,
    Reliability,
)

if TYPE_CHECKING:
    from enum import Enum


MAX_DOMAIN = 232
"""The last domain whose ports exist (RTPS 2.5, clause 9.6.2.3)."""

PROFILES = {
    "default": DEFAULT,
    "sensor_data": SENSOR_DATA,
    "compressed_stream": COMPRESSED_STREAM,
    "latched": LATCHED,
    "services": SERVICES,
}
CODECS = ("h264", "rvl", "png", "jpeg")
NS = 1_000_000_000


def load_fleet(path: Path | str) -> Fleet:
    """Read a fleet from a file.

    Raises:
        DocumentError: The file cannot be read or is not a fleet; says where, what is given and allowed.
    """
    return _read(Document.of_file(Path(path), "a fleet file in UTF-8"))


def read_fleet(text: str, file: str = "fleet.yaml") -> Fleet:
    """Read a fleet from the text of a file.

    Args:
        text: YAML.
        file: The file's name, for messages.

    Raises:
        DocumentError: It is not a fleet; says where, what is given and what is allowed.
    """
    return _read(Document(text, file))


def _read(document: Document) -> Fleet:
    top = document.section()
    border = top.section("global")
    interface = border.text("interface", None)
    policy, places = _policy(top)
    name = top.text("fleet")
    fleet = Fleet(
        name=name,
        global_domain=border.whole("domain", 0, low=0, high=MAX_DOMAIN),
        policy=policy,
        agents=tuple(_agent(agent, section, interface) for agent, section in top.members("agents")),
        deployment=read_deployment(top.section("deployment"), name),
        rule_places=places,
        place=top.here,
    )
    border.close()
    top.close()
    if not fleet.agents:
        raise top.refusal("agents", None, "at least one agent")
    return fleet


def _policy(top: Section) -> tuple[Policy, tuple[Place, ...]]:
    given = top.get("policy", "table-1")
    if isinstance(given, str):
        top.text("policy", "table-1", choices=("table-1",))
        return Policy(rules=TABLE_1), ()
    sections = tuple(top.items("policy", short="pattern"))
    rules = tuple(_rule(section) for section in sections)
    if not rules:
        raise top.refusal("policy", given, "'table-1' or at least one rule: nothing would ever cross")
    return Policy(rules=rules), tuple(section.here for section in sections)


def _rule(section: Section) -> ForwardRule:
    ways = section.texts("directions") or tuple(way.value for way in Direction)
    allowed = tuple(way.value for way in Direction)
    for way in ways:
        if way not in allowed:
            raise section.refusal("directions", way, " and ".join(allowed) + suggestion(way, allowed))
    rule = ForwardRule(
        pattern=section.text("pattern"),
        description=section.text("description", ""),
        directions=frozenset(Direction(way) for way in ways),
    )
    section.close()
    return rule


def _agent(name: str, section: Section, interface: str | None) -> AgentSpec:
    try:
        validate_agent(name)
    except FqnError as error:
        raise DocumentError(section.here, name, error.allowed) from error
    agent = AgentSpec(
        name=name,
        domain=section.whole("domain", low=0, high=MAX_DOMAIN),
        global_interface=section.text("global_interface", interface),
        local_interface=section.text("local_interface", None),
        processes=section.whole("processes", 1, low=1),
        lifecycle=section.flag("lifecycle", default=True),
        sensors=tuple(_sensor(item) for item in section.items("sensors")),
        tf=_tf(section.section("tf")),
        publishes=tuple(_topic(item) for item in section.items("publishes", short="name")),
        subscribes=tuple(_topic(item) for item in section.items("subscribes", short="name")),
        host=read_host(section.section("host")) if section.has("host") else None,
        place=section.here,
        **{key: _uses(section, key, kind) for key, kind in _NAMES.items()},
    )
    section.close()
    return agent


_NAMES = {
    "serves": ResourceKind.SERVICE,
    "calls": ResourceKind.SERVICE,
    "action_servers": ResourceKind.ACTION,
    "action_clients": ResourceKind.ACTION,
}


def _uses(section: Section, key: str, kind: ResourceKind) -> tuple[NameUse, ...]:
    return tuple(_use(item, kind) for item in section.items(key, short="name"))


def _use(section: Section, kind: ResourceKind) -> NameUse:
    use = NameUse(name=_name(section, kind=kind), type=section.text("type", ""), place=section.here)
    section.close()
    return use


def _topic(section: Section) -> TopicUse:
    topic = TopicUse(
        name=_name(section),
        type=section.text("type", ""),
        qos=_qos(section),
        rate_hz=section.positive("rate_hz", None),
        size_bytes=section.whole("size_bytes", None, low=0),
        count=section.whole("count", 1, low=1),
        place=section.here,
    )
    section.close()
    return topic


def _name(section: Section, key: str = "name", kind: ResourceKind = ResourceKind.TOPIC) -> str:
    name = section.text(key)
    try:
        return validate_ros_name(name, kind)
    except FqnError as error:
        raise section.refusal(key, name, error.allowed) from error


def _optional_name(section: Section, key: str) -> str:
    return _name(section, key) if section.get(key, "") else ""


def _qos(section: Section) -> QoSProfile | None:
    given = section.get("qos", None)
    if given is None:
        return None
    if isinstance(given, str):
        return PROFILES[section.text("qos", choices=tuple(PROFILES))]
    inner = section.section("qos")
    profile = QoSProfile(
        reliability=_choice(inner, "reliability", Reliability, DEFAULT.reliability),
        durability=_choice(inner, "durability", Durability, DEFAULT.durability),
        history=_choice(inner, "history", History, DEFAULT.history),
        depth=inner.whole("depth", DEFAULT.depth, low=1),
        deadline_ns=_nanoseconds(inner.positive("deadline_s", None)),
        lifespan_ns=_nanoseconds(inner.positive("lifespan_s", None)),
    )
    inner.close()
    return profile


def _choice(section: Section, key: str, values: type[Enum], default: Enum) -> Any:
    return values(section.text(key, default.value, choices=tuple(str(v.value) for v in values)))


def _nanoseconds(value_s: float | None) -> int | None:
    return None if value_s is None else max(1, round(value_s * NS))


def _sensor(section: Section) -> SensorSpec:
    sensor = SensorSpec(
        name=section.text("name"),
        model=section.text("model", ""),
        streams=tuple(_stream(item) for item in section.items("streams")),
        place=section.here,
    )
    section.close()
    return sensor


def _stream(section: Section) -> StreamSpec:
    stream = StreamSpec(
        topic=_name(section, "topic"),
        type=section.text("type"),
        codec=section.text("codec", choices=CODECS),
        width=section.whole("width", low=1),
        height=section.whole("height", low=1),
        rate_hz=section.positive("rate_hz"),
        size_bytes=section.whole("size_bytes", None, low=1),
        decoded_topic=_optional_name(section, "decoded_topic"),
        camera_info_topic=_optional_name(section, "camera_info_topic"),
        place=section.here,
    )
    section.close()
    return stream


def _tf(section: Section) -> FrameTree:
    tree = FrameTree(
        frames=tuple(_frame(item) for item in section.items("frames")),
        prefix_frames=section.flag("prefix_frames", default=True),
        shared_frames=section.texts("shared_frames", SHARED_FRAMES),
        placed_by_others=section.texts("placed_by_others"),
        static_broadcasters=section.whole("static_broadcasters", 1, low=1),
        place=section.here,
    )
    section.close()
    return tree


def _frame(section: Section) -> FrameSpec:
    static = section.flag("static", default=False)
    frame = FrameSpec(
        child=section.text("child"),
        parent=section.text("parent"),
        static=static,
        rate_hz=section.positive("rate_hz", 0.0) if static else section.positive("rate_hz"),
        place=section.here,
    )
    section.close()
    return frame
