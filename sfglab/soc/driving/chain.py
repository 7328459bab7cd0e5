"""The node chain alpha of paper C, section 6: from an image to a command, over topic A.

What the memory model says of a chain's time: how long its messages travel, with topic A mapped to software or
to a gateway, everything else alike. The text does not list the chain's members (a red dotted line in Fig. 9):
`CHAIN` is our reading, from when the compensation has its image. Refuses to know what a node takes.

Frames differ only in what the model leaves open: the order in which a software-mapped topic serves its readers,
and so how they meet at the memory interface, chunk by chunk in turn. Through a gateway nobody waits.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, permutations
from typing import TYPE_CHECKING

from sfglab.errors import SfglabError
from sfglab.soc.memory import (
    STORED,
    Costs,
    Setup,
    Side,
    Times,
    Transport,
    round_robin_s,
    transfer_times,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from sfglab.soc.graph import Graph, Topic


CHAIN = ("compensation", "gaussian_blur", "lane_planner", "polyfit", "lane_control")
"""The chain's nodes, in order: our reading of Fig. 9."""

#: What is mapped to software in the paper's one version and to a gateway in the other.
SHARED_TOPIC = "/A"

Order = tuple[str, ...]  #: Readers of a software-mapped topic, as they are served.


@dataclass(frozen=True)  # without slots: what is computed stays
class Chain:
    """The chain's transfers in a graph."""

    #: With the chain's nodes placed; topics between two hardware nodes alone are hardware-mapped, the others
    #: software-mapped, whatever the graph says.
    graph: Graph
    costs: Costs = STORED  #: The memory model's constants.

    def __post_init__(self) -> None:
        if self._topics[0].name != SHARED_TOPIC:
            raise SfglabError(
                f"graph {self.graph.name}: {CHAIN[0]} must reach {CHAIN[1]} over {SHARED_TOPIC}"
            )
        if {CHAIN[0], CHAIN[1]} - self.graph.in_hardware:
            raise SfglabError(
                f"graph {self.graph.name}: {CHAIN[0]} and {CHAIN[1]} must be in hardware"
            )

    @cached_property
    def _topics(self) -> list[Topic]:
        return [self._between(before, after) for before, after in pairwise(CHAIN)]

    def _between(self, before: str, after: str) -> Topic:
        for topic in self.graph.topics:
            if before in topic.publishers and after in topic.subscribers and topic.size_bytes:
                return topic
        raise SfglabError(
            f"graph {self.graph.name}: no topic with a size goes from {before} to {after}"
        )

    @cached_property
    def orders(self) -> tuple[Order, ...]:
        """Every order in which topic A's readers can be served; each is as likely as the others."""
        return tuple(permutations(self._topics[0].subscribers))

    @cached_property
    def fixed_s(self) -> dict[str, float]:
        """Seconds on the chain's other topics, by topic: streams among hardware, else in memory."""
        found = {}
        for topic in self._topics[1:]:
            streams = self.graph.in_hardware.issuperset(topic.subscribers)
            times = self._times(topic, Transport.HMT if streams else Transport.SMT)
            found[topic.name] = times.hardware_s if streams else times.software_s
        return {name: time_s for name, time_s in found.items() if time_s is not None}

    @cached_property
    def gateway_s(self) -> float:
        """Seconds from the compensation to the blur through a gateway, where no order is left to chance."""
        found = self._times(self._topics[0], Transport.GATEWAY).hardware_s
        assert found is not None, "the blur is in hardware"
        return found

    def _times(self, topic: Topic, transport: Transport) -> Times:
        hardware = len(self.graph.in_hardware.intersection(topic.subscribers))
        setup = Setup(
            publisher=Side.HARDWARE,
            transport=transport,
            message_bytes=topic.size_bytes or 0,
            hardware=hardware,
            software=len(topic.subscribers) - hardware,
        )
        return transfer_times(setup, self.costs)

    @cached_property
    def smt_s(self) -> dict[Order, float]:
        """Seconds from the compensation to the blur over main memory, by the order of deliveries."""
        return {order: self.read_s(order)[CHAIN[1]] for order in self.orders}

    def read_s(self, order: Order) -> dict[str, float]:
        """Return when each hardware reader of A, served in this order, has its message, s from its start."""
        costs, memory = self.costs, self.costs.memory
        size_bytes = self._topics[0].size_bytes or 0
        sent_s = costs.endpoint_s + memory.write_s(size_bytes) + costs.delegate_s
        start_s, deliver_s = sent_s + costs.published_s(size_bytes), costs.delivery_s(size_bytes)
        # Ports of the memory interface in the graph's order; it decides turns of one chunk, 0.7 us.
        readers = [name for name in self._topics[0].subscribers if name in self.graph.in_hardware]
        releases_s = [
            start_s + (order.index(name) + 1) * deliver_s + costs.delegate_s for name in readers
        ]
        chunks = memory.chunks(size_bytes)
        ends_s = round_robin_s(releases_s, chunks, memory.read_s(size_bytes) / chunks)
        return {name: end_s + costs.endpoint_s for name, end_s in zip(readers, ends_s, strict=True)}

    def draw(self, frames: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """Draw the order of deliveries of each frame, as places in `orders`."""
        return rng.integers(0, len(self.orders), frames)
