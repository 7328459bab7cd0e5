"""The module `topics` has the topics of a QoS plan, and the YAML file that names these topics with their link.

The module reads topics, links and vendors by their keys. Each error names the file, the topic, the key, the given
value and the allowed values. The module does not choose rates.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any

from sfglab.documents import ByName, Document, Matching, named
from sfglab.errors import InvalidValueError
from sfglab.fields import between, bounds, check_bounds
from sfglab.names.grammar import ROS_NAME
from sfglab.qos import Durability, Reliability
from sfglab.rtps import FAST_DDS, PRESETS, Medium, Vendor
from sfglab.rtps.vendors import PresetName  # noqa: TC001 - read at run time
from sfglab.units import NS_PER_MS

if TYPE_CHECKING:
    from pathlib import Path


_RATE_MOST_HZ = 1e9  # The nanoseconds of a log distinguish samples at this rate.
# The link's fields have at most this value; for larger values the solver finds no solution.
_FIELD_MOST = 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """A `Topic` is one topic: its hosts, size, rates and weight."""

    #: Full name of the topic, with its leading slash.
    name: Annotated[str, Matching(ROS_NAME, "a full topic name of ROS 2, such as '/robot1/lidar'")]
    source: str = field(metadata=named("from"))  #: Host that publishes.
    #: Host or hosts that subscribe; each host gets a copy and acknowledges the copy, as DDS sends over Wi-Fi.
    target: str | tuple[str, ...] = field(metadata=named("to"))
    #: CDR size of a message, bytes; large messages take several frames.
    size_bytes: int = field(metadata=bounds(0, 10**9))
    #: Lowest useful rate, Hz.
    rate_min_hz: float = between(1.0, 1 / _RATE_MOST_HZ, _RATE_MOST_HZ)
    #: Highest possible rate, Hz.
    rate_max_hz: float = between(1000.0, 1 / _RATE_MOST_HZ, _RATE_MOST_HZ)
    #: Mean time between changes of the topic's value; the time determines the use of a higher rate.
    change_s: float = between(1.0, 1 / _RATE_MOST_HZ, _RATE_MOST_HZ)
    #: Weight in the objective, compared with the other topics.
    weight: float = between(1.0, 1 / _FIELD_MOST, _FIELD_MOST)
    #: Whether a local cache suppresses repeated values (paper B, section 2.2). Then only changes travel, and
    #: the rate is that of the readings.
    cached: bool = False
    #: Reliability; BEST_EFFORT topics cause no acknowledgements, and the medium's losses are final.
    reliability: Reliability = Reliability.RELIABLE
    #: Durability; with Fast DDS the durability decides when heartbeats come (`repairs`), and so rates and depths.
    durability: Durability = Durability.VOLATILE

    def __post_init__(self) -> None:
        check_bounds(self, f"topic {self.name!r}: ")

    @property
    def targets(self) -> tuple[str, ...]:
        """Hosts that subscribe."""
        return (self.target,) if isinstance(self.target, str) else self.target

    @property
    def reliable(self) -> bool:
        """Whether the writer retransmits lost samples."""
        return self.reliability is Reliability.RELIABLE


@dataclass(frozen=True, slots=True, kw_only=True)
class _Link:
    """The link that all topics share: one half-duplex medium for all hosts, as Wi-Fi is."""

    #: Bit rate of the link, Mbit/s.
    rate_mbps: float = between(20.0, 1 / _FIELD_MOST, _FIELD_MOST)
    loss: float = between(0.01, 0, 1, without=(1,))  #: Share of frames that are lost.
    overhead_us: float = between(300.0, 0, _FIELD_MOST)  #: Airtime of a frame beside its bits, µs.
    #: Share by which each further host that wants to send lengthens a frame.
    contention: float = between(0.15, 0, _FIELD_MOST)
    #: Time from the end of sending to arrival of a frame, ms.
    latency_ms: float = between(0.0, 0, _FIELD_MOST)
    queue_frames: int = between(500, 1, 10**6)  #: Number of frames that a host's queue holds.

    @property
    def medium(self) -> Medium:
        """The link as a medium of the RTPS model."""
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
    """A `_Timing` has the times that replace the vendor's own times."""

    #: Time between two heartbeats, ms.
    heartbeat_ms: float | None = field(default=None, metadata=_MILLISECONDS)
    #: Time from a loss to the request for the lost sample, ms.
    nack_delay_ms: float | None = field(default=None, metadata=_MILLISECONDS)
    #: Time from a heartbeat to the response to the heartbeat, ms.
    ack_delay_ms: float | None = field(default=None, metadata=_MILLISECONDS)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Shared:
    """`_Shared` has the fields that a file of topics and its values have in common."""

    #: Largest share of the medium's time that a plan may use.
    utilisation_max: float = between(0.9, 0.01, 1, without=(1,))
    #: Share of samples that may stay lost after retransmissions, if a history can keep this share; a plan has the
    #: expected share (`TopicPlan.loss`).
    residual_loss: float = between(1e-4, 1e-9, 1, without=(1,))
    topics: Annotated[tuple[Topic, ...], ByName("name")]  #: Topics in the order of the file.
    #: Hosts that the paper's problem counts as agents; by default all hosts that publish.
    agents: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicKeys(_Shared):
    """A file of topics for `sfglab qos` describes the topics between hosts, and their link."""

    #: Largest rate of any topic, Hz.
    rate_max_hz: float = between(1000.0, 1 / _RATE_MOST_HZ, _RATE_MOST_HZ)
    link: _Link = field(default_factory=_Link)  #: The link that all topics share.
    #: DDS implementation, a preset of `sfglab.rtps`.
    vendor: PresetName = "fast_dds"
    #: Times that replace the implementation's own times.
    timing: _Timing = field(default_factory=_Timing)


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicFile(_Shared):
    """A `TopicFile` has topics with the link that all topics share.

    Raises:
        InvalidValueError: The medium is not shared, or has an access point.
    """

    medium: Medium = field(default_factory=Medium)  #: Link that all topics share.
    #: Timing of the DDS implementation, with the times that the file replaces.
    vendor: Vendor = FAST_DDS

    def __post_init__(self) -> None:
        medium = self.medium
        if not medium.shared or medium.access_point:
            given = f"shared={medium.shared}, access_point={medium.access_point}"
            allowed = "a shared medium without an access point"
            raise InvalidValueError("topics: medium", given, allowed)

    def limited_to(self, rate_max_hz: float | None) -> TopicFile:
        """Return the file with all rates limited to a rate; a higher minimal rate is lowered to the limit."""
        if rate_max_hz is None:
            return self
        topics = []
        for topic in self.topics:
            least_hz = min(topic.rate_min_hz, rate_max_hz)
            most_hz = min(topic.rate_max_hz, rate_max_hz)
            topics.append(replace(topic, rate_min_hz=least_hz, rate_max_hz=most_hz))
        return replace(self, topics=tuple(topics))

    def topics_of_agents(self) -> tuple[int, ...]:
        """Return T_a of paper B, Eq. 1: the number of topics that each agent sends or receives."""
        return tuple(
            sum(agent in (t.source, *t.targets) for t in self.topics) for agent in self.agents
        )


def load_topics(path: Path | str) -> TopicFile:
    """Read a YAML file of topics.

    Raises:
        DocumentError: The file cannot be read, or has a mistake; the error names its place and the allowed values.
    """
    return read_topics(Document.of_file(path))


def read_topics(document: Document) -> TopicFile:
    """Read topics from a document.

    Raises:
        DocumentError: As for `load_topics`.
    """
    file = document.read(TopicKeys)
    if not file.topics:
        raise document.refusal(("topics",), document.value["topics"], "at least one topic")
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
    """Return a topic with the rates that the file leaves open, after a check of the topic's keys."""
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
