"""How long a topic's messages take as the topic is mapped, and a gateway rule that knows their size.

Joins graphs to the model of the memory interface (`sfglab.soc.memory`): a topic's nodes are counted by side,
and the model says the rest. One message at a time has the interface for itself; topics do not wait for each
other.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from sfglab.soc.graph import GraphError, TopicMapping
from sfglab.soc.memory import STORED, Judge, Setup, Side, Transport, judged_s, transfer_times

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.soc.graph import Graph, Topic
    from sfglab.soc.memory import Costs


_TRANSPORTS = {
    TopicMapping.SOFTWARE: Transport.SMT,
    TopicMapping.HARDWARE: Transport.HMT,
    TopicMapping.GATEWAY: Transport.GATEWAY,
}


def transfer_s(graph: Graph, topic: Topic, *, judge: Judge = Judge.LAST, costs: Costs = STORED) -> float:
    """Return how long a message takes from its publisher to its subscribers as its topic is mapped, s.

    Where publishers stand on both sides, it is the longer of the two times.

    Args:
        graph: With the topic in it.
        topic: Which.
        judge: Which subscriber's time counts.
        costs: The model's constants.

    Raises:
        GraphError: The topic's size is unknown.
    """
    return max(judged_s(transfer_times(setup, costs), setup, judge) for setup in _setups(graph, topic))


def faster_by_gateway(*, judge: Judge = Judge.LAST, costs: Costs = STORED) -> Callable[[Graph, Topic], bool]:
    """Return a rule for `map_communication`: a gateway where it is predicted to be faster.

    The paper's rule knows no sizes, although its own measurements show that small messages lose by a gateway
    (section 4).

    Args:
        judge: Which subscriber's time counts.
        costs: The model's constants.
    """

    def rule(graph: Graph, topic: Topic) -> bool:
        software, gateway = (
            transfer_s(graph, replace(topic, mapping=mapping), judge=judge, costs=costs)
            for mapping in (TopicMapping.SOFTWARE, TopicMapping.GATEWAY)
        )
        return gateway < software

    return rule


def _setups(graph: Graph, topic: Topic) -> list[Setup]:
    """Return the model's view of a topic, once for each side from which it is published."""
    if topic.size_bytes is None:
        raise GraphError(f"topics.{topic.name}.size_bytes", None, "the size of a message, to know its time")
    placed = graph.in_hardware
    hardware = len(placed.intersection(topic.subscribers))
    sides = {Side.HARDWARE if name in placed else Side.SOFTWARE: None for name in topic.publishers}
    return [
        Setup(
            publisher=side,
            transport=_TRANSPORTS[topic.mapping],
            message_bytes=max(topic.size_bytes, 1),
            hardware=hardware,
            software=len(topic.subscribers) - hardware,
        )
        for side in sides
    ]
