"""A process of the live run of experiment `mocap`: ``python -m sfglab.lab.workers.mocap CONFIG``.

The ``robot`` publishes its TF tree with odometry that drifts. The ``bridge`` runs the mocap bridge and,
with the same captures, the direct receiver under both names. The ``listener`` builds the trees and performs TF
lookups of the robot's camera. Each method of joining has its own domain, so that each tree is received alone.
"""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from contextlib import AsyncExitStack, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from sfglab.bus import Node
from sfglab.bus.address import BusAddress
from sfglab.component import Orders, Report, Reporter, run_component
from sfglab.fields import to_json
from sfglab.lab.checks.trees import AGENT, DIRECT, OBJECT, PROXY, RENAMED, WAYS, WORLD
from sfglab.messages import message_type
from sfglab.names import TF, TF_STATIC
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.buffer import FrameBuffer, FrameError
from sfglab.spatial.frames.listener import TF_QOS, TF_STATIC_QOS, TRANSFORMS, FramesListener
from sfglab.spatial.mocap.bridge import MocapBridge
from sfglab.spatial.mocap.mapping import MappedObject, MocapMapping, direct_transforms
from sfglab.spatial.mocap.synthetic import (
    SyntheticConfig,
    SyntheticMotion,
    SyntheticSource,
    synthetic_captures,
)
from sfglab.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator, Mapping

    from sfglab.bus import Clock, Publisher

    Nodes = Mapping[str, Node]  # by way

CAMERA = f"{AGENT}/camera"
MOTION = SyntheticMotion()  #: Path of the markers in the world.
CAMERAS = SyntheticConfig(occlusions_hz=0.5, occlusion_s=0.15, dropped=0.02)
"""The simulated capture system, with noise, occlusions and lost captures."""
MAPPING = MocapMapping(
    world=WORLD, objects={OBJECT: MappedObject(id=OBJECT, via=OBJECT, frame=f"{AGENT}/odom")}
)
"""Mapping of the bridge. It names the root of the robot's tree, because without odometry, which may be
received later than the static transforms, the root is another frame."""
#: Time for which robot and bridge continue after the run, so that the last look-ups are answered, ns.
TAIL_NS = 600 * NS_PER_MS
_FIRST_NS = 250 * NS_PER_MS  # time of the first look-up
_BASE_FROM_MARKERS = Pose.at((0.1, 0.0, 0.2), (0.0, 0.05, 0.0, 1.0))
_BASE_FROM_CAMERA = Pose.at((0.33, 0.0, 0.13), (0.5, -0.5, 0.5, -0.5))
_WORLD_FROM_ODOM = Pose.from_yaw((1.5, -0.7, 0.1), 0.6)
# Drift of the odometry, typical of wheels and legs.
_DRIFT_M_S = 0.02
_DRIFT_RAD_S = 0.01
_MOTION_HZ = 50.0
_LOOK_UP_HZ = 50.0
_PATIENCE_S = 2.0  # longest wait of a look-up
_SAMPLE_NS = 100 * NS_PER_MS  # time between transforms in the log


@dataclass(frozen=True, slots=True, kw_only=True)
class MocapWorkerConfig:
    """Configuration of a process in the experiment on motion capture, with its role."""

    role: str  #: ``robot``, ``bridge`` or ``listener``.
    ways: dict[str, BusAddress]  #: Domain of each of `WAYS`.
    seed: int  #: Seed of the cameras, and of the times of look-ups.


# --- The robot: its TF tree, its true pose, and its odometry ---


def description() -> tuple[StampedTransform, ...]:
    """Return the robot's static transforms: markers and a camera on its base."""
    markers = _step("base", "markers", 0, _BASE_FROM_MARKERS)
    return markers, _step("base", "camera", 0, _BASE_FROM_CAMERA)


def odometry(time_s: float, stamp_ns: int) -> StampedTransform:
    """Return the pose of the base in the odometry, which drifts from time 0."""
    drift = Pose.from_yaw((_DRIFT_M_S * time_s, 0.0, 0.0), _DRIFT_RAD_S * time_s)
    world_from_base = MOTION.pose_at(time_s) @ _BASE_FROM_MARKERS.inverse()
    return _step("odom", "base", stamp_ns, drift @ _WORLD_FROM_ODOM.inverse() @ world_from_base)


def world_from_camera(time_s: float) -> Pose:
    """Return the true pose of the camera."""
    return MOTION.pose_at(time_s) @ _BASE_FROM_MARKERS.inverse() @ _BASE_FROM_CAMERA


def _step(parent: str, child: str, stamp_ns: int, pose: Pose) -> StampedTransform:
    return StampedTransform(
        parent=f"{AGENT}/{parent}", child=f"{AGENT}/{child}", stamp_ns=stamp_ns, pose=pose
    )


# --- The roles ---


def _publish(publisher: Publisher, *transforms: StampedTransform) -> None:
    messages = [transform.to_msg() for transform in transforms]
    publisher.publish(message_type(TRANSFORMS)(transforms=messages))


async def _until(clock: Clock, time_ns: int) -> None:
    await clock.sleep_for(max(0.0, (time_ns - clock.now_ns()) / NS_PER_S))


def _publish_odometry(publisher: Publisher, clock: Clock, start_ns: int) -> None:
    now_ns = clock.now_ns()
    _publish(publisher, odometry((now_ns - start_ns) / NS_PER_S, now_ns))


async def play_robot(nodes: Nodes, start_ns: int, end_ns: int, _seed: int) -> Report:
    """Publish the robot's tree in all domains, from the order to a little after the run."""
    clock = nodes[PROXY].get_clock()
    for node in nodes.values():
        _publish(node.create_publisher(TRANSFORMS, TF_STATIC, TF_STATIC_QOS), *description())
        publisher = node.create_publisher(TRANSFORMS, TF, TF_QOS)
        node.create_timer(1 / _MOTION_HZ, partial(_publish_odometry, publisher, clock, start_ns))
    await _until(clock, end_ns + TAIL_NS)
    return {}


async def play_bridge(nodes: Nodes, start_ns: int, end_ns: int, seed: int) -> Report:
    """Run sfglab's bridge and the direct receivers on the same synthetic captures, a little beyond `end_ns`."""
    sources = []
    for _ in range(2):
        captures = synthetic_captures(
            {OBJECT: MOTION},
            CAMERAS,
            np.random.default_rng(seed),
            start_ns=start_ns,
            duration_s=(end_ns + TAIL_NS - start_ns) / NS_PER_S,
        )
        sources.append(SyntheticSource(captures, nodes[PROXY].get_clock()))
    bridge = MocapBridge(nodes[PROXY], sources[0], MAPPING)
    await asyncio.gather(bridge.run(), _receive_directly(nodes, sources[1]))
    return {}


async def _receive_directly(nodes: Nodes, source: SyntheticSource) -> None:
    """Publish the transforms of the direct receiver, with the receiver's own frame name and with the right one."""
    direct = nodes[DIRECT].create_publisher(TRANSFORMS, TF, TF_QOS)
    renamed = nodes[RENAMED].create_publisher(TRANSFORMS, TF, TF_QOS)
    async for capture in source.captures():
        for transform in direct_transforms(capture, world=WORLD):
            _publish(direct, transform)
            _publish(renamed, replace(transform, child=OBJECT))


async def play_listener(nodes: Nodes, start_ns: int, end_ns: int, seed: int) -> Report:
    """Receive all trees, and look up the camera at random times while the robot moves."""
    buffers = {way: FrameBuffer(history_s=None) for way in WAYS}
    rng = np.random.default_rng(seed)
    clock = nodes[PROXY].get_clock()
    tries = {DIRECT: Counter[str](), RENAMED: Counter[str]()}
    waiting = []
    async with AsyncExitStack() as stack:
        listeners = {}
        for way in WAYS:
            listener = FramesListener(nodes[way], buffers[way])
            listeners[way] = await stack.enter_async_context(listener)
        due_ns = start_ns + _FIRST_NS
        while due_ns < end_ns:
            await _until(clock, due_ns)
            for way, outcomes in tries.items():
                outcomes[_outcome(buffers[way])] += 1
            row = _look_row(start_ns, listeners[PROXY], buffers[PROXY], clock)
            waiting.append(asyncio.create_task(row))
            due_ns += round(float(rng.uniform(0.5, 1.5)) / _LOOK_UP_HZ * NS_PER_S)
        looks = await asyncio.gather(*waiting)
    edges = [{"way": way, **asdict(edge)} for way in WAYS for edge in buffers[way].edges]
    sampled = to_json(list(_sampled(buffers[PROXY], start_ns)))
    return {"looks": looks, "tries": tries, "edges": edges, "sampled": sampled}


def _sampled(buffer: FrameBuffer, start_ns: int) -> Iterator[tuple[bool, StampedTransform]]:
    """Yield whether a transform is static, and the transform; those that are not, every 0.1 s."""
    for edge in buffer.edges:
        span = range(edge.first_ns, edge.last_ns, _SAMPLE_NS)
        for at_ns in [start_ns] if edge.static else span:
            with suppress(FrameError):  # of an edge with a former parent
                pose = buffer.look_up(edge.parent, edge.child, at_ns)
                step = StampedTransform(
                    parent=edge.parent, child=edge.child, stamp_ns=at_ns, pose=pose
                )
                yield edge.static, step


def _outcome(buffer: FrameBuffer) -> str:
    try:
        buffer.look_up(WORLD, CAMERA)
    except FrameError as error:
        return type(error).__name__
    return "found"


async def _look_row(
    start_ns: int, listener: FramesListener, buffer: FrameBuffer, clock: Clock
) -> dict[str, float]:
    """Look up the camera at the current time, and return the row of table ``look``."""
    now_ns = clock.now_ns()
    at_s = (now_ns - start_ns) / NS_PER_S
    true = world_from_camera(at_s)
    row = dict.fromkeys(("wait_ms", "error_mm", "error_mrad", "latest_mm"), math.nan)
    with suppress(FrameError):
        row["latest_mm"] = 1e3 * buffer.look_up(WORLD, CAMERA).distance_m(true)
    with suppress(FrameError):
        pose = await listener.wait_for(WORLD, CAMERA, now_ns, timeout_s=_PATIENCE_S)
        row["wait_ms"] = (clock.now_ns() - now_ns) / NS_PER_MS
        row["error_mm"] = 1e3 * pose.distance_m(true)
        row["error_mrad"] = 1e3 * pose.angle_rad(true)
    return {"at_s": at_s, **row}


ROLES: dict[str, Callable[[Nodes, int, int, int], Awaitable[Report]]] = {
    "robot": play_robot,
    "bridge": play_bridge,
    "listener": play_listener,
}


async def serve(config: MocapWorkerConfig, report: Reporter, orders: Orders) -> None:
    """Open a node per method, and play the configured role from ``start_ns`` to ``end_ns`` of each order."""
    async with AsyncExitStack() as stack:
        nodes = {}
        for way, address in config.ways.items():
            node = Node(config.role, **address.options())
            nodes[way] = await stack.enter_async_context(node)
        report({"is": "ready"})
        while True:
            order = await orders.get()
            played = await ROLES[config.role](
                nodes, order["start_ns"], order["end_ns"], config.seed
            )
            report({"is": "played", **played})


if __name__ == "__main__":
    run_component(MocapWorkerConfig, serve)
