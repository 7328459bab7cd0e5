"""Laps by seeds, and the chain timed frame by frame: what the sweeps run, and what the memory model adds.

Node times are processor time on this machine with OpenCV in one thread, as a node's one executor runs: what a
node works, not what it waits while others have the processor. Laps may run beside each other; the chain is
timed with no other lap beside it, at the image size of the graph.
"""

from __future__ import annotations

import math
import time
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.driving.config import MAPPINGS, ChainPoint, LapPoint
from sfglab.lab.experiments.driving.rows import (
    DrivingChainRow,
    DrivingLapRow,
    DrivingNodeRow,
    DrivingTransferRow,
)
from sfglab.lab.paths import find_project
from sfglab.soc import load_graph
from sfglab.soc.driving import CHAIN, SHARED_TOPIC, Camera, Chain, Rules, Stack, make_town, run_lap
from sfglab.soc.memory import CUT_THROUGH, STORED

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.soc.driving import Lap


def drive_lap(point: LapPoint, seed: int) -> DrivingLapRow:
    """Drive one lap; all but the node times depends on the arguments alone.

    Args:
        point: How long at most.
        seed: Of the town.
    """
    with _one_thread():
        lap = run_lap(seed, stack=Stack(Camera(), time.thread_time_ns), rules=Rules(timeout_s=point.limit_s))
    return lap_row(lap)


def lap_row(lap: Lap) -> DrivingLapRow:
    """Return a timed lap's row."""
    node_s: dict[str, Any] = {f"{node}_s": mean_s for node, mean_s in lap.node_s.items()}
    return DrivingLapRow(
        seed=lap.seed,
        **asdict(lap.verdict),
        lane_m=make_town(np.random.default_rng(lap.seed)).lane.length_m,
        frames=lap.frames,
        lanes_missed=lap.lanes_missed,
        odometry_error_m=lap.odometry_error_m,
        odometry_lost=lap.odometry_lost,
        **node_s,
    )


def chain_of(point: ChainPoint) -> Chain:
    """Return the chain in the graph's file."""
    return Chain(load_graph(find_project().data / point.graph_file))


def time_chain(point: ChainPoint, seed: int) -> tuple[DrivingChainRow, ...]:
    """Drive with images of the graph's size; return each frame's node times and its drawn way over topic A.

    Args:
        point: How long, how large.
        seed: Of the town, and of the orders of deliveries.
    """
    chain = chain_of(point)
    stack = Stack(Camera(width=point.width, height=point.height), time.thread_time_ns)
    with _one_thread():
        frames = run_lap(seed, stack=stack, rules=Rules(timeout_s=point.limit_s)).frames
    orders = chain.draw(frames, np.random.default_rng((seed, 1)))
    return tuple(_chain_row(stack, chain, frame, int(order)) for frame, order in enumerate(orders))


def _chain_row(stack: Stack, chain: Chain, frame: int, order: int) -> DrivingChainRow:
    served = chain.orders[order]
    return DrivingChainRow(
        **{f"{node}_ns": stack.timed.frames_ns[node][frame] for node in CHAIN},
        order=order,
        place=served.index(CHAIN[1]) + 1,
        smt_s=chain.smt_s[served],
        gateway_s=chain.gateway_s,
    )


def nodes_of(chain: Chain) -> list[DrivingNodeRow]:
    """Return what the graph assumes of the chain's nodes."""
    nodes = [chain.graph.node(name) for name in CHAIN]
    return [
        DrivingNodeRow(
            node=node.name,
            in_hardware=node.in_hardware,
            hardware_s=node.hardware.time_s if node.in_hardware and node.hardware else math.nan,
        )
        for node in nodes
    ]


def transfers_of(chain: Chain) -> list[DrivingTransferRow]:
    """Return every transfer along the chain, by both sets of the model's constants."""
    return [
        _transfer_row(costs.memory.forwarding.value, topic, mapping, times_s)
        for costs in (STORED, CUT_THROUGH)
        for topic, mapping, times_s in _ways(Chain(chain.graph, costs))
    ]


def _ways(chain: Chain) -> Iterator[tuple[str, str, list[float]]]:
    yield SHARED_TOPIC, MAPPINGS[0], list(chain.smt_s.values())
    yield SHARED_TOPIC, MAPPINGS[1], [chain.gateway_s]
    for topic, seconds in chain.fixed_s.items():
        yield topic, "as placed", [seconds]


def _transfer_row(forwarding: str, topic: str, mapping: str, times_s: list[float]) -> DrivingTransferRow:
    return DrivingTransferRow(
        forwarding=forwarding,
        topic=topic,
        mapping=mapping,
        mean_s=float(np.mean(times_s)),
        deviation_s=float(np.std(times_s)),
        shortest_s=min(times_s),
        longest_s=max(times_s),
    )


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let OpenCV work in this thread alone."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
