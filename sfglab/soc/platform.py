"""What a configurable system-on-chip offers, and what a mapped graph takes of it.

Knows areas, and times of work and of carrying messages across the memory interface, each as a sum. Refuses to
know how carriages wait for each other, which is the memory interface model's, and which mapping is best.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.soc.graph import GraphError, TopicMapping
from sfglab.soc.mapping import carriages_per_message
from sfglab.soc.memory import STORED

if TYPE_CHECKING:
    from sfglab.soc.graph import Graph, Node, Topic
    from sfglab.soc.memory import Costs


@dataclass(frozen=True, slots=True, kw_only=True)
class Platform:
    """A system-on-chip with one memory interface that all hardware nodes and gateways share."""

    name: str  #: What it is called.
    lut: int  #: Look-up tables for nodes and gateways.
    bram: float  #: Block memories of 36 kbit for them.
    bytes_per_s: float  #: Rate at which a message is carried, bytes/s.
    carriage_s: float  #: Fixed time of one carriage of a software-mapped topic, s.
    gateway_s: float  #: Fixed time of one carriage through a gateway, s.
    #: Look-up tables of one gateway; ours takes 654, 702 and 688 with 2, 4 and 8 subscribers
    #: (`sfglab.soc.rtl.gateway_area`, in the log of the experiment `transfer`).
    gateway_lut: int = 690
    gateway_bram: float = 0.0  #: Block memories of one gateway.

    def __post_init__(self) -> None:
        for key in ("lut", "bram", "gateway_lut", "gateway_bram", "carriage_s", "gateway_s"):
            if not 0 <= getattr(self, key) < float("inf"):
                raise GraphError(f"platform.{key}", getattr(self, key), "a finite number from 0")
        if not 0 < self.bytes_per_s < float("inf"):
            raise GraphError("platform.bytes_per_s", self.bytes_per_s, "a finite number above 0")


def platform_from_costs(name: str, *, lut: int, bram: float, costs: Costs = STORED) -> Platform:
    """Return a platform whose carriages take what the memory interface model says they add.

    One more carriage of a software-mapped topic is a delivery, a call to the delegate and a read of the
    message; one through a gateway is the same with the core's own work on a message. That a gateway also
    cancels its request when hardware publishes, and what writes take beyond reads, is left out: node mapping
    wants one number for each.

    Args:
        name: What the platform is called.
        lut: Look-up tables for nodes and gateways.
        bram: Block memories of 36 kbit for them.
        costs: The model's constants.
    """
    chunk_bytes = costs.memory.chunk_bytes
    carriage_s = costs.delegate_s + costs.deliver_s
    return Platform(
        name=name,
        lut=lut,
        bram=bram,
        bytes_per_s=chunk_bytes / (costs.memory.read_s(chunk_bytes) + costs.deliver_s_per_byte * chunk_bytes),
        carriage_s=carriage_s,
        gateway_s=carriage_s + costs.endpoint_s,
    )


ZCU104 = platform_from_costs("ZCU104", lut=230_400, bram=312.0)
"""The board of paper C, section 4.

Areas are those of its XCZU7EV (AMD's overview of Zynq UltraScale+, DS891), nothing set aside for what ReconROS
itself takes; a gateway's LUTs are those of our core with 2 to 8 subscribers.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """What a mapped graph takes; times are seconds of work in each second of operation, added up."""

    software_s: float  #: Nodes in software.
    hardware_s: float  #: Nodes in hardware.
    communication_s: float  #: Carriages across the memory interface.
    lut: int  #: Look-up tables of nodes and gateways.
    bram: float  #: Block memories of both.

    @property
    def total_s(self) -> float:
        """All times together: what node mapping makes small."""
        return self.software_s + self.hardware_s + self.communication_s

    def fits(self, platform: Platform) -> bool:
        """Return whether the areas are there."""
        return self.lut <= platform.lut and self.bram <= platform.bram


def assess(graph: Graph, platform: Platform) -> Load:
    """Return what a graph takes, with nodes and topics as they are mapped.

    Raises:
        GraphError: A topic that crosses has no size or no rate.
    """
    placed = [node for node in graph.nodes if node.in_hardware]
    gateways = len(graph.mapped_to(TopicMapping.GATEWAY))
    known = [node.hardware for node in placed if node.hardware is not None]
    return Load(
        software_s=sum(software_load(node) for node in graph.nodes if not node.in_hardware),
        hardware_s=sum(hardware_load(node) for node in placed),
        communication_s=sum(topic_load(graph, topic, platform) for topic in graph.topics),
        lut=sum(part.lut for part in known) + gateways * platform.gateway_lut,
        bram=sum(part.bram for part in known) + gateways * platform.gateway_bram,
    )


def topic_load(graph: Graph, topic: Topic, platform: Platform) -> float:
    """Return the seconds that a topic's messages take of the memory interface each second, as it is mapped.

    Raises:
        GraphError: It crosses, and its size or rate is unknown.
    """
    carriages = carriages_per_message(graph, topic)
    if carriages == 0:
        return 0.0
    once_s = (
        gateway_load(topic, platform)
        if topic.mapping is TopicMapping.GATEWAY
        else carriage_load(topic, platform)
    )
    return carriages * once_s


def software_load(node: Node) -> float:
    """Return a node's seconds of work each second in software."""
    return node.rate_hz * node.software_s


def hardware_load(node: Node) -> float:
    """Return the same in hardware, 0 where nothing is known of its implementation."""
    return 0.0 if node.hardware is None else node.rate_hz * node.hardware.time_s


def carriage_load(topic: Topic, platform: Platform) -> float:
    """Return the seconds each second for one carriage of each message of a software-mapped topic."""
    size_bytes, rate_hz = _traffic(topic)
    return rate_hz * (platform.carriage_s + size_bytes / platform.bytes_per_s)


def gateway_load(topic: Topic, platform: Platform) -> float:
    """Return the same through a gateway."""
    size_bytes, rate_hz = _traffic(topic)
    return rate_hz * (platform.gateway_s + size_bytes / platform.bytes_per_s)


def _traffic(topic: Topic) -> tuple[int, float]:
    if topic.size_bytes is None:
        raise GraphError(f"topics.{topic.name}.size_bytes", None, "the size of a message, to know its cost")
    if topic.rate_hz is None:
        raise GraphError(f"topics.{topic.name}.rate_hz", None, "messages per second, to know their cost")
    return topic.size_bytes, topic.rate_hz
