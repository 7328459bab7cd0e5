"""From which size on a gateway is worth it, and what a mapping that knows sizes makes of Fig. 8."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from sfglab.lab.experiments.transfer.rows import BreakEvenRow, SizedMappingRow
from sfglab.soc import (
    TopicMapping,
    carriages_per_message,
    faster_by_gateway,
    map_communication,
    transfer_s,
)
from sfglab.soc.mapping import more_than_one_hardware_subscriber
from sfglab.soc.memory import (
    LARGEST_BYTES,
    STORED,
    Judge,
    Setup,
    Side,
    Transport,
    break_even_bytes,
    faster_transport,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sfglab.soc import Graph, Topic


JUDGES = {"hardware": Judge.HARDWARE, "software": Judge.SOFTWARE, "last": Judge.LAST}

RULES: dict[str, Callable[[Graph, Topic], bool]] = {
    "none": lambda _graph, _topic: False,
    "paper": more_than_one_hardware_subscriber,
    "size-aware": faster_by_gateway(judge=Judge.LAST),
}
"""Who gets a gateway: nobody, by section 5's rule, or by predicted time to the last subscriber."""

_GRID = np.unique(np.geomspace(STORED.memory.chunk_bytes, LARGEST_BYTES, 200).astype(int))


def break_even_rows(most_subscribers: int) -> Iterator[BreakEvenRow]:
    """Return the size from which on a gateway is faster, for every publisher, judge and number.

    Args:
        most_subscribers: Largest number of hardware subscribers.
    """
    for side in Side:
        for name, judge in JUDGES.items():
            for count in range(1, most_subscribers + 1):
                setup = Setup(publisher=side, transport=Transport.SMT, message_bytes=1, hardware=count)
                found = break_even_bytes(setup, judge)
                yield BreakEvenRow(
                    publisher=side.value,
                    judge=name,
                    subscribers=count,
                    worth=found is not None,
                    from_bytes=found or 0,
                    changes=_changes(setup, judge),
                )


def _changes(setup: Setup, judge: Judge) -> int:
    """Return how often the faster transport changes from the smallest to the largest size."""
    faster = [faster_transport(replace(setup, message_bytes=int(size)), judge) for size in _GRID]
    return sum(one is not other for one, other in pairwise(faster))


def sized_mapping_rows(graph: Graph, sizes: int) -> Iterator[SizedMappingRow]:
    """Map a graph by each rule, all its messages of one size after the other.

    Args:
        graph: Placed.
        sizes: How many sizes from 100 B to 10 MB.
    """
    for size in np.geomspace(100, 10_000_000, sizes).round().astype(int):
        topics = tuple(replace(topic, size_bytes=int(size)) for topic in graph.topics)
        sized = replace(graph, topics=topics)
        for name, rule in RULES.items():
            mapped = map_communication(sized, gateway=rule).gateways
            chosen = mapped.mapped_to(TopicMapping.GATEWAY)
            yield SizedMappingRow(
                message_bytes=int(size),
                rule=name,
                gateways=len(chosen),
                topics=", ".join(chosen),
                predicted_s=sum(transfer_s(mapped, topic) for topic in mapped.topics),
                carriages=float(sum(carriages_per_message(mapped, topic) for topic in mapped.topics)),
            )
