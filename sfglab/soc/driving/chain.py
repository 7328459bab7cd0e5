"""The node chain alpha of paper C, section 6: transfer times from an image to a command.

The memory model gives the time of each message, with topic A mapped to software or to a gateway and all
other topics alike. The paper does not list the members of the chain (a red dotted line in Fig. 9), so
`CHAIN` is a reading of it. Execution times of nodes are not part of this module.

One thing differs between frames: the order in which a software-mapped topic serves its subscribers. That
order decides which subscribers share the memory interface. A gateway serves all at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, permutations
from typing import TYPE_CHECKING

from sfglab.soc.graph import TopicMapping
from sfglab.soc.mapping import arrival_s, link, map_communication, message_bytes
from sfglab.soc.memory import STORED, round_robin_s

if TYPE_CHECKING:
    from sfglab.soc.graph import Edge, Graph, Topic


CHAIN = ("compensation", "gaussian_blur", "lane_planner", "polyfit", "lane_control")
"""Nodes of the chain in their order."""

#: Topic that the paper maps to software in one version, to a gateway in the other.
SHARED_TOPIC = "/A"

Order = tuple[str, ...]  #: Subscribers of a software-mapped topic in the order of their delivery.


@dataclass(frozen=True)  # without slots: computed properties are kept
class Chain:
    """Transfers of the chain in a graph.

    Topics between two hardware nodes are hardware-mapped and the others software-mapped, except A, which
    joins two nodes in hardware. Properties raise an InvalidValueError if the graph lacks a topic that they need.
    """

    graph: Graph  #: Graph in which the chain's nodes are placed.

    @cached_property
    def _mapped(self) -> Graph:
        return map_communication(self.graph).hardware

    @cached_property
    def _edges(self) -> list[Edge]:
        """Edges from the chain's topics to their next nodes."""
        return [link(self._mapped, before, after) for before, after in pairwise(CHAIN)]

    @property
    def _shared(self) -> Topic:
        return self._mapped.topic(SHARED_TOPIC)

    @cached_property
    def fixed_s(self) -> dict[str, float]:
        """Return the transfer time, in seconds, of each topic of the chain except topic A."""
        return {edge.topic: arrival_s(self._mapped, edge) for edge in self._edges[1:]}

    @cached_property
    def gateway_s(self) -> float:
        """Transfer time of A from compensation to blur through a gateway, s."""
        mapped = self._mapped.with_mappings({SHARED_TOPIC: TopicMapping.GATEWAY})
        return arrival_s(mapped, self._edges[0])

    @cached_property
    def orders(self) -> tuple[Order, ...]:
        """All orders in which a software-mapped A can serve its subscribers; equally likely."""
        return tuple(permutations(self._shared.subscribers))

    @cached_property
    def software_s(self) -> dict[Order, float]:
        """Transfer time of A from compensation to blur through main memory by order, s."""
        return {order: self.read_s(order)[CHAIN[1]] for order in self.orders}

    def read_s(self, order: Order) -> dict[str, float]:
        """Return when each hardware subscriber of A has read its message, s after its publication."""
        memory = STORED.memory
        topic = self._shared
        size_bytes = message_bytes(topic)
        written_s = STORED.endpoint_s + memory.write_s(size_bytes) + STORED.delegate_s
        published_s = written_s + STORED.published_s(size_bytes)
        # The ports of the memory interface have the order of the graph.
        readers = [name for name in topic.subscribers if name in self.graph.in_hardware]
        releases_s = []
        for name in readers:
            deliveries = order.index(name) + 1
            delivered_s = published_s + deliveries * STORED.delivery_s(size_bytes)
            releases_s.append(delivered_s + STORED.delegate_s)
        chunks = memory.chunks(size_bytes)
        ends_s = round_robin_s(releases_s, chunks, memory.read_s(size_bytes) / chunks)
        return {name: s + STORED.endpoint_s for name, s in zip(readers, ends_s, strict=True)}
