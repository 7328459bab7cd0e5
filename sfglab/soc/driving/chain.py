"""The module `chain` computes the transfer times of paper C's node chain alpha from an image to a command (section 6).

The memory model gives the time of each message, with topic A mapped to software or to a gateway. All other topics
have the same mapping in both cases. The paper draws the chain as a red dotted line in Fig. 9 and does not list the
chain's members, so `CHAIN` is our reading of the figure. The module `chain` leaves out the execution times of nodes.

By the model the time of a frame depends only on the order in which a software-mapped topic A serves its subscribers.
The order of delivery decides which subscribers share the memory interface. A gateway serves all hardware subscribers
at once.
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
"""`CHAIN` has the nodes of the chain in their order."""

#: Topic that the paper maps to software in one version of the application and to a gateway in the other version.
SHARED_TOPIC = "/A"

Order = tuple[str, ...]  #: Subscribers of a software-mapped topic in the order of their delivery.


@dataclass(frozen=True)  # The class has no slots, because its cached properties need a dictionary.
class Chain:
    """A `Chain` has the transfer times of the node chain in a graph.

    The graph's topics have the mappings of section 5's cases without gateways. Only topic A also has a time through a
    gateway.

    Raises:
        InvalidValueError: A property was read, and the graph lacks a topic of the chain.
    """

    graph: Graph  #: Graph in which the chain's nodes are placed.

    @cached_property
    def _mapped(self) -> Graph:
        return map_communication(self.graph).without_gateways

    @cached_property
    def _edges(self) -> list[Edge]:
        """Return the edge from each topic of the chain to the next node of the chain."""
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
        """Return the transfer time of topic A from compensation to blur through a gateway, s."""
        mapped = self._mapped.with_mappings({SHARED_TOPIC: TopicMapping.GATEWAY})
        return arrival_s(mapped, self._edges[0])

    @cached_property
    def orders(self) -> tuple[Order, ...]:
        """Return all orders, equally likely, in which a software-mapped topic A can serve its subscribers."""
        return tuple(permutations(self._shared.subscribers))

    @cached_property
    def software_s(self) -> dict[Order, float]:
        """Return the transfer time of topic A from compensation to blur through main memory for each order, s."""
        return {order: self.read_s(order)[CHAIN[1]] for order in self.orders}

    def read_s(self, order: Order) -> dict[str, float]:
        """Return the time from the publication until each hardware subscriber of A has read the message, s."""
        topic = self._shared
        size_bytes = message_bytes(topic)
        written_s = STORED.endpoint_s + STORED.write_s(size_bytes) + STORED.delegate_s
        published_s = written_s + STORED.published_s(size_bytes)
        # The ports of the memory interface have the order of the graph.
        readers = [name for name in topic.subscribers if name in self.graph.hardware_nodes]
        releases_s = []
        for name in readers:
            deliveries = order.index(name) + 1
            delivered_s = published_s + deliveries * STORED.delivery_s(size_bytes)
            releases_s.append(delivered_s + STORED.delegate_s)
        chunks = STORED.chunks(size_bytes)
        ends_s = round_robin_s(releases_s, chunks, STORED.read_s(size_bytes) / chunks)
        return {name: s + STORED.endpoint_s for name, s in zip(readers, ends_s, strict=True)}
