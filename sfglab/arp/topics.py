"""Topics that QoS is planned for, and the YAML file that names them with their link.

Knows topics, links and vendors by their keys, and says for every refusal file, topic, key, what was given and
what is allowed. Refuses to know how rates are found.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any

from sfglab.documents import ByName, Document, Matching, named
from sfglab.fields import between, bounds, check_bounds
from sfglab.names.grammar import ROS_NAME
from sfglab.qos import Durability, Reliability
from sfglab.rtps import FAST_DDS, PRESETS, Medium, Vendor
from sfglab.rtps.vendors import PresetName  # noqa: TC001 - read at run time
from sfglab.units import NS_PER_MS

if TYPE_CHECKING:
    from pathlib import Path


_RATE_MOST_HZ = 1e9  # as often as the nanoseconds of a log tell apart
_FIELD_MOST = 1e6  # of the link's numbers: what is larger has no solution that a solver finds


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """One topic: its hosts, size, rates and weight."""

    #: Full name, with its leading slash.
    name: Annotated[str, Matching(ROS_NAME, "a full topic name of ROS 2, such as '/robot1/lidar'")]
    source: str = field(metadata=named("from"))  #: Host that publishes.
    #: Host that subscribes, or hosts, each of which gets a copy and acknowledges it, as DDS sends over Wi-Fi.
    target: str | tuple[str, ...] = field(metadata=named("to"))
    #: CDR size of a message; large ones take several frames.
    size_bytes: int = field(metadata=bounds(0, 10**9))
    #: Lowest rate that is of use, Hz.
    rate_min_hz: float = between(1.0, 1 / _RATE_MOST_HZ, _RATE_MOST_HZ)
    #: Highest rate that is possible, Hz.
    rate_max_hz: float = between(1000.0, 1 / _RATE_MOST_HZ, _RATE_MOST_HZ)
    #: Mean time between changes of its value; what a higher rate is worth follows from it.
    change_s: float = between(1.0, 1 / _RATE_MOST_HZ, _RATE_MOST_HZ)
    #: Weight in the objective, compared with the other topics.
    weight: float = between(1.0, 1 / _FIELD_MOST, _FIELD_MOST)
    #: Whether a local cache holds repeated values back (paper B, section 2.2): then only changes travel, and
    #: the rate is that of the readings.
    cached: bool = False
    #: BEST_EFFORT topics cost no acknowledgements, and lose what the medium loses.
    reliability: Reliability = Reliability.RELIABLE
    #: With Fast DDS it decides when heartbeats come (`repairs`), and so rates and depths.
    durability: Durability = Durability.VOLATILE

    def __post_init__(self) -> None:
        check_bounds(self, f"topic {self.name!r}: ")

    @property
    def targets(self) -> tuple[str, ...]:
        """Hosts that subscribe."""
        return (self.target,) if isinstance(self.target, str) else self.target

    @property
    def reliable(self) -> bool:
        """Whether what is lost is repaired."""
        return self.reliability is Reliability.RELIABLE


@dataclass(frozen=True, slots=True, kw_only=True)
class _Link:
    """The link that all topics share: one half-duplex medium for all hosts, as Wi-Fi is."""

    #: Megabits per second.
    rate_mbps: float = between(20.0, 1 / _FIELD_MOST, _FIELD_MOST)
    loss: float = between(0.01, 0, 1, without=(1,))  #: Share of frames that are lost.
    overhead_us: float = between(300.0, 0, _FIELD_MOST)  #: Airtime of a frame beside its bits.
    #: By which share each further host that wants to send stretches a frame.
    contention: float = between(0.15, 0, _FIELD_MOST)
    #: Time from the end of sending to arrival.
    latency_ms: float = between(0.0, 0, _FIELD_MOST)
    queue_frames: int = between(500, 1, 10**6)  #: Frames that a host's queue holds.

    @property
    def medium(self) -> Medium:
        """The same for the model."""
        return Medium(
            rate_bps=self.rate_mbps * 1e6,
            loss=self.loss,
            overhead_s=self.overhead_us / 1e6,
            contention=self.contention,
            latency_s=self.latency_ms / 1e3,
            queue_frames=self.queue_frames,
        )


_MILLISECONDS = bounds(1e-3, _FIELD_MOST)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Timing:
    """Times of the DDS implementation that are not its vendor's own."""

    #: Time between two heartbeats.
    heartbeat_ms: float | None = field(default=None, metadata=_MILLISECONDS)
    #: Time from a loss to its request.
    nack_delay_ms: float | None = field(default=None, metadata=_MILLISECONDS)
    #: Time from a heartbeat to its answer.
    ack_delay_ms: float | None = field(default=None, metadata=_MILLISECONDS)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Shared:
    """Fields that a file of topics and its values have in common."""

    #: The most of the medium's time that may be planned.
    utilisation_max: float = between(0.9, 0.01, 1, without=(1,))
    #: Share of samples that may stay lost after repairs, where a history can keep it; a plan says what it
    #: expects (`TopicPlan.loss`).
    residual_loss: float = between(1e-4, 1e-9, 1, without=(1,))
    topics: Annotated[tuple[Topic, ...], ByName("name")]  #: In the file's order.
    #: Hosts that the paper's problem counts as agents; by default all that publish.
    agents: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicKeys(_Shared):
    """A file of topics for `sfglab qos`: who sends what to whom over which link."""

    #: No topic may be sent more often.
    rate_max_hz: float = between(1000.0, 1 / _RATE_MOST_HZ, _RATE_MOST_HZ)
    link: _Link = field(default_factory=_Link)  #: The link that all topics share.
    #: The DDS implementation, a preset of `sfglab.rtps`.
    vendor: PresetName = "fast_dds"
    timing: _Timing = field(default_factory=_Timing)  #: Its times, where they are not its own.


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicFile(_Shared):
    """Topics with the link that all of them share."""

    #: The link that all of them share; its `shared` and `access_point` are not reckoned with.
    medium: Medium = field(default_factory=Medium)
    #: The DDS implementation, with the file's timing where it says any.
    vendor: Vendor = FAST_DDS

    def limited_to(self, rate_max_hz: float | None) -> TopicFile:
        """Return the same with no topic faster than a rate; a minimal rate above it is lowered to it."""
        if rate_max_hz is None:
            return self
        topics = []
        for topic in self.topics:
            least_hz = min(topic.rate_min_hz, rate_max_hz)
            most_hz = min(topic.rate_max_hz, rate_max_hz)
            topics.append(replace(topic, rate_min_hz=least_hz, rate_max_hz=most_hz))
        return replace(self, topics=tuple(topics))

    def topics_of_agents(self) -> tuple[int, ...]:
        """Return T_a of paper B, Eq. 1: how many topics each agent sends or hears."""
        return tuple(
            sum(agent in (t.source, *t.targets) for t in self.topics) for agent in self.agents
        )


def load_topics(path: Path | str) -> TopicFile:
    """Read a YAML file of topics; a DocumentError names the place of a mistake and what is allowed there."""
    return read_topics(Document.of_file(path))


def read_topics(document: Document) -> TopicFile:
    """Read topics; raises `DocumentError`, as `load_topics`."""
    file = document.read(TopicKeys)
    if not file.topics:
        raise document.refusal(("topics",), document.value["topics"], "one topic at least")
    hosts = sorted({host for t in file.topics for host in (t.source, *t.targets)})
    agents = file.agents or tuple(sorted({t.source for t in file.topics}))
    wrong = not set(agents) <= set(hosts) or len(set(agents)) < len(agents)
    if wrong or document.value.get("agents") == []:
        allowed = f"a list of hosts among {', '.join(hosts)}, each once"
        raise document.refusal(("agents",), document.value["agents"], allowed)
    return TopicFile(
        topics=tuple(_topic(document, topic, file.rate_max_hz) for topic in file.topics),
        utilisation_max=file.utilisation_max,
        residual_loss=file.residual_loss,
        agents=agents,
        medium=file.link.medium,
        vendor=_vendor(PRESETS[file.vendor], file.timing),
    )


def _topic(document: Document, topic: Topic, ceiling_hz: float) -> Topic:
    """Return a topic with the rates that the file leaves open, after checking what it says."""
    path = ("topics", topic.name)
    given = document.value["topics"][topic.name]
    most_hz = min(topic.rate_max_hz, ceiling_hz) if "rate_max_hz" in given else ceiling_hz
    least_hz = topic.rate_min_hz if "rate_min_hz" in given else min(1.0, most_hz)
    if least_hz > most_hz:
        allowed = f"up to the topic's rate_max_hz, {most_hz:g}"
        raise document.refusal((*path, "rate_min_hz"), given.get("rate_min_hz"), allowed)
    if not topic.targets or len({topic.source, *topic.targets}) <= len(topic.targets):
        allowed = f"another host than 'from', {topic.source}, each once"
        raise document.refusal((*path, "to"), given["to"], allowed)
    return replace(topic, rate_min_hz=least_hz, rate_max_hz=most_hz)


def _vendor(vendor: Vendor, timing: _Timing) -> Vendor:
    changes: dict[str, Any] = {}
    for name, value_ms in asdict(timing).items():
        if value_ms is not None:
            changes[name.removesuffix("_ms") + "_ns"] = round(value_ms * NS_PER_MS)
    return replace(vendor, **changes)
