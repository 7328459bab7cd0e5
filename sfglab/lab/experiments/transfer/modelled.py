"""The model of the memory interface: Fig. 6 and 7, its fit run anew, and what follows for mapping."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.soc import TopicMapping, carriages_per_message, faster_by_gateway, map_communication, transfer_s
from sfglab.soc.mapping import more_than_one_hardware_subscriber
from sfglab.soc.memory import (
    CUT_THROUGH,
    LARGEST_BYTES,
    STORED,
    Judge,
    Setup,
    Side,
    Transport,
    break_even_bytes,
    constants,
    faster_transport,
    fitted_values,
    with_values,
)
from sfglab.soc.paper_values import (
    FitError,
    fit,
    residuals,
    sensitivity,
    speed_ups,
    tendencies,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sfglab.soc import Graph, Topic
    from sfglab.soc.memory import Costs
    from sfglab.soc.paper_values import Fit, SpeedUp


MODELS = {"stored": STORED, "cut-through": CUT_THROUGH}
"""Both sets of constants; the first is the better fit and the one that claims are judged by."""

SPREAD = 2.5
"""A fit starts with every constant up to this factor from the committed one."""

JUDGES = {"hardware": Judge.HARDWARE, "software": Judge.SOFTWARE, "last": Judge.LAST}

RULES: dict[str, Callable[[Graph, Topic], bool]] = {
    "none": lambda _graph, _topic: False,
    "paper": more_than_one_hardware_subscriber,
    "size-aware": faster_by_gateway(judge=Judge.LAST),
}
"""Topics that get a gateway: none, by section 5's rule, or by predicted time to the last subscriber."""

_GRID = np.unique(np.geomspace(STORED.memory.chunk_bytes, LARGEST_BYTES, 200).astype(int))


def model_rows(refits: int, rng: np.random.Generator) -> Iterator[tuple[str, dict[str, Any]]]:
    """Return every row of this part, with its table.

    Args:
        refits: Starts from which each set is fitted anew.
        rng: Draws them.
    """
    for name, costs in MODELS.items():
        for bar in speed_ups(costs):
            yield "bar", bar_row(name, bar)
        for item in residuals(costs):
            yield (
                "stated",
                {
                    "model": name,
                    "panel": item.panel.value,
                    "text": item.text,
                    "stated": item.paper,
                    "found": item.model,
                },
            )
        for said, holds in tendencies(costs):
            yield (
                "tendency",
                {
                    "model": name,
                    "panel": said.panel.value,
                    "text": said.text,
                    "holds": holds,
                },
            )
        yield from _fits(name, costs, refits, rng)
        for other in sensitivity(costs):
            yield (
                "variant",
                {
                    "model": name,
                    "constant": other.name,
                    "factor": other.factor,
                    "rms": other.fit.rms,
                    "worst": other.worst,
                },
            )


def bar_row(model: str, bar: SpeedUp) -> dict[str, Any]:
    """Return a bar as a row."""
    return {
        "model": model,
        "panel": bar.panel.value,
        "message_bytes": bar.message_bytes,
        "subscribers": bar.subscribers,
        "smt_s": bar.smt_s,
        "gateway_s": bar.gateway_s,
    }


def _fits(
    name: str, costs: Costs, refits: int, rng: np.random.Generator
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Fit from drawn starts, and put the best fit's constants beside the committed ones."""
    fitted = fitted_values(costs)
    found: list[Fit] = []
    for start in range(refits):
        factors = np.exp(rng.uniform(-math.log(SPREAD), math.log(SPREAD), len(fitted)))
        drawn = {key: value * float(f) for (key, value), f in zip(fitted.items(), factors, strict=True)}
        ended = _ended(with_values(costs, drawn))
        if ended:
            found.append(ended)
        yield (
            "refit",
            {
                "model": name,
                "start": start,
                "farthest": float(np.exp(np.abs(np.log(factors)).max())),
                "rms": ended.rms if ended else math.nan,
                "shift": _shift(fitted, fitted_values(ended.costs)) if ended else math.nan,
            },
        )
    best = min(found, key=lambda item: item.rms).costs if found else costs
    for item, again in zip(constants(costs), constants(best), strict=True):
        yield (
            "constant",
            {
                "model": name,
                "constant": item.name,
                "value": item.value,
                "unit": item.unit,
                "origin": item.origin.value,
                "reason": item.reason,
                "refitted": again.value,
            },
        )


def _ended(start: Costs) -> Fit | None:
    try:
        return fit(start)
    except FitError:
        return None


def _shift(committed: dict[str, float], found: dict[str, float]) -> float:
    return max(abs(found[key] / value - 1) for key, value in committed.items())


def break_even_rows(most_subscribers: int) -> Iterator[dict[str, Any]]:
    """Return the size from which on a gateway is faster, for every publisher, judge and number.

    Args:
        most_subscribers: Largest number of hardware subscribers.
    """
    for side in Side:
        for name, judge in JUDGES.items():
            for count in range(1, most_subscribers + 1):
                setup = Setup(publisher=side, transport=Transport.SMT, message_bytes=1, hardware=count)
                found = break_even_bytes(setup, judge)
                yield {
                    "publisher": side.value,
                    "judge": name,
                    "subscribers": count,
                    "worth": found is not None,
                    "from_bytes": found or 0,
                    "changes": _changes(setup, judge),
                }


def _changes(setup: Setup, judge: Judge) -> int:
    """Return how often the faster transport changes from the smallest to the largest size."""
    faster = [faster_transport(replace(setup, message_bytes=int(size)), judge) for size in _GRID]
    return sum(one is not other for one, other in pairwise(faster))


def sized_mapping_rows(graph: Graph, sizes: int) -> Iterator[dict[str, Any]]:
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
            yield {
                "message_bytes": int(size),
                "rule": name,
                "gateways": len(chosen),
                "topics": ", ".join(chosen),
                "predicted_s": sum(transfer_s(mapped, topic) for topic in mapped.topics),
                "carriages": float(sum(carriages_per_message(mapped, topic) for topic in mapped.topics)),
            }
