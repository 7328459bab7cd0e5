"""A process of the live rounds: ``python -m sfglab.lab.workers.mocap CONFIG``.

Roles: ``robot`` publishes its tree with odometry of its own, ``bridge`` runs the mocap bridge and, from the
same captures, the direct receiver under both names, ``listener`` builds the trees and looks into them. Each way
of joining has a domain of its own, so that each tree is heard as it would be.
"""

from __future__ import annotations

import asyncio
import itertools
import math
from collections import Counter
from contextlib import AsyncExitStack, aclosing, suppress
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus import Node, Publisher
from sfglab.bus.address import BusAddress
from sfglab.component import Orders, Report, Reporter, beside, run_component
from sfglab.fields import to_json
from sfglab.lab.checks.trees import AGENT, OBJECT, WAYS, WORLD
from sfglab.messages import message_type, ns_from_stamp
from sfglab.names import TF, TF_STATIC
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.buffer import FrameBuffer, FrameError
from sfglab.spatial.frames.listener import TF_QOS, TF_STATIC_QOS, TRANSFORMS, FramesListener
from sfglab.spatial.mocap.bridge import MocapBridge
from sfglab.spatial.mocap.mapping import MappedObject, MocapMapping, direct_transforms
from sfglab.spatial.mocap.synthetic import SyntheticConfig, SyntheticMotion, SyntheticSource

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Callable, Mapping, Sequence

    from sfglab.bus.api import MessageInfo
    from sfglab.spatial.mocap.tracking import Capture, MocapSource

CAMERA = f"{AGENT}/camera"
MOTION = SyntheticMotion()  #: Of the markers, in the world.
FAULTY = SyntheticConfig(
    occlusions_hz=0.5, occlusion_s=0.15, flips_hz=0.5, flip_s=0.1, dropped=0.02
)
"""Cameras with noise and every fault."""
IDEAL = SyntheticConfig(noise_m=0.0, noise_rad=0.0)
"""Cameras that see without noise and fault, and as late: what is left is the bridge's and the tree's."""
ROUNDS = {"faulty": FAULTY, "ideal": IDEAL}  #: The cameras of each live round.
#: How long robot and cameras go on behind a round, so that its last looks are answered.
TAIL_S = 0.6
_BASE_FROM_MARKERS = Pose.at((0.1, 0.0, 0.2), (0.0, 0.05, 0.0, 1.0))
_HEAD_FROM_CAMERA = Pose.at((0.08, 0.0, 0.03), (0.5, -0.5, 0.5, -0.5))
_WORLD_FROM_ODOM = Pose.from_yaw((1.5, -0.7, 0.1), 0.6)
_DRIFT_M_S, _DRIFT_RAD_S = 0.02, 0.01
"""How fast the odometry walks and turns away: as much as wheels and legs do."""
MOTION_HZ, LOOK_HZ = 50.0, 50.0
_EARLY_NS = 500_000_000
_PATIENCE_S = 2.0
_MOST_KEPT = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class MocapWorkerConfig:
    """What a process of the live rounds does."""

    role: str  #: ``robot``, ``bridge`` or ``listener``.
    ways: dict[str, BusAddress]  #: Where each of `WAYS` leads along.
    seed: int  #: Of the cameras' noise and faults, and of the listener's times.


# The robot: its tree of frames, where it really is, what its odometry says.


def description() -> tuple[StampedTransform, ...]:
    """Return what never moves in the robot: markers on its base, the camera in its head."""
    return _frame("base", "markers", 0, _BASE_FROM_MARKERS), _frame(
        "head", "camera", 0, _HEAD_FROM_CAMERA
    )


def motions(start_ns: int, time_ns: int) -> tuple[StampedTransform, ...]:
    """Return what moves: the base in its odometry, which drifts from the way's start on, and the head on it."""
    time_s = (time_ns - start_ns) / 1e9
    drift = Pose.from_yaw((_DRIFT_M_S * time_s, 0.0, 0.0), _DRIFT_RAD_S * time_s)
    odom_from_base = (
        drift @ _WORLD_FROM_ODOM.inverse() @ MOTION.pose_at(time_s) @ _BASE_FROM_MARKERS.inverse()
    )
    return (
        _frame("odom", "base", time_ns, odom_from_base),
        _frame("base", "head", time_ns, _head(time_s)),
    )


def world_from_camera(start_ns: int, time_ns: int) -> Pose:
    """Return where the camera really is."""
    time_s = (time_ns - start_ns) / 1e9
    world_from_base = MOTION.pose_at(time_s) @ _BASE_FROM_MARKERS.inverse()
    return world_from_base @ _head(time_s) @ _HEAD_FROM_CAMERA


def mapping() -> MocapMapping:
    """Return the bridge's: the markers stand for themselves, whatever is the robot's root is published."""
    return MocapMapping(world=WORLD, objects={OBJECT: MappedObject(id=OBJECT, via=OBJECT)})


def _head(time_s: float) -> Pose:
    return Pose.from_yaw((0.25, 0.0, 0.1), 0.6 * math.sin(2.0 * math.pi * time_s / 3.0))


def _frame(parent: str, child: str, stamp_ns: int, pose: Pose) -> StampedTransform:
    return StampedTransform(
        parent=f"{AGENT}/{parent}", child=f"{AGENT}/{child}", stamp_ns=stamp_ns, pose=pose
    )


# What the processes do.


@dataclass(frozen=True, slots=True, kw_only=True)
class _Round:
    """One order: a live round, its time 0 and its length."""

    name: str
    start_ns: int
    seconds: float

    @property
    def end_ns(self) -> int:
        return self.start_ns + round(self.seconds * 1e9)


class _Robot:
    """Publishes the robot's tree into all domains."""

    def __init__(self, nodes: Mapping[str, Node], _: int) -> None:
        self._nodes = tuple(nodes.values())
        self._moving = [node.create_publisher(TRANSFORMS, TF, TF_QOS) for node in self._nodes]
        self._still = [
            node.create_publisher(TRANSFORMS, TF_STATIC, TF_STATIC_QOS) for node in self._nodes
        ]

    async def play(self, round_: _Round) -> Report:
        """Publish before, in and a little after a round."""
        _send(self._still, description())
        clock = self._nodes[0].get_clock()
        period_ns = round(1e9 / MOTION_HZ)
        due_ns = round_.start_ns - _EARLY_NS
        while due_ns < round_.end_ns + round(TAIL_S * 1e9):
            await clock.sleep_for(max(0.0, (due_ns - clock.now_ns()) / 1e9))
            _send(self._moving, motions(round_.start_ns, clock.now_ns()))
            due_ns += period_ns
        return {}


class _Tee:
    """A source that also does with every capture what the direct receiver would."""

    def __init__(self, source: MocapSource, publishers: Mapping[str, Publisher]) -> None:
        self._source, self._publishers = source, publishers
        self.bridge: MocapBridge | None = None
        #: Capture and receipt of each, and whether the bridge published it.
        self.receipts: list[tuple[int, int, bool]] = []

    async def captures(self) -> AsyncGenerator[Capture, None]:
        """Open the source."""
        async with aclosing(self._source.captures()) as captures:
            async for capture in captures:
                before = self._published()
                yield capture
                self.receipts.append(
                    (capture.capture_ns, capture.receipt_ns, self._published() > before)
                )
                for transform in direct_transforms(capture, world=WORLD):
                    _send([self._publishers["direct"]], [transform])
                    _send([self._publishers["renamed"]], [replace(transform, child=OBJECT)])

    def _published(self) -> int:
        return sum(status.published for status in self.bridge.core.statuses) if self.bridge else 0


class _Bridge:
    """Runs the bridge and the direct receiver."""

    def __init__(self, nodes: Mapping[str, Node], seed: int) -> None:
        self._nodes, self._seed = nodes, seed

    async def play(self, round_: _Round) -> Report:
        """Capture through a round."""
        node = self._nodes["proxy"]
        source = SyntheticSource(
            {OBJECT: MOTION},
            ROUNDS[round_.name],
            np.random.default_rng(self._seed),
            clock=node.get_clock(),
            duration_s=round_.seconds + TAIL_S,
            start_ns=round_.start_ns,
        )
        others = ("direct", "renamed")
        publishers = {
            way: self._nodes[way].create_publisher(TRANSFORMS, TF, TF_QOS) for way in others
        }
        tee = _Tee(source, publishers)
        tee.bridge = MocapBridge(node, tee, mapping())
        await tee.bridge.run()
        for publisher in publishers.values():
            publisher.close()
        return {"receipts": tee.receipts}


class _Listener:
    """Hears all trees and looks into them while the robot moves."""

    def __init__(self, nodes: Mapping[str, Node], seed: int) -> None:
        self._nodes, self._seed = nodes, seed

    async def play(self, round_: _Round) -> Report:
        """Look through a round."""
        buffers = {way: FrameBuffer(history_s=None) for way in WAYS}
        heard: list[tuple[int, int, int]] = []
        moving: list[tuple[int, StampedTransform]] = []

        def hear(message: Any, info: MessageInfo) -> None:
            for transform in message.transforms:
                moving.append((info.received_timestamp_ns, StampedTransform.from_msg(transform)))
                if transform.header.frame_id == WORLD:
                    stamp_ns = ns_from_stamp(transform.header.stamp)
                    heard.append((stamp_ns, info.source_timestamp_ns, info.received_timestamp_ns))

        async def listen() -> None:
            while True:
                hear(*await times.take_with_info())

        async with AsyncExitStack() as stack:
            listeners = {
                way: await stack.enter_async_context(FramesListener(self._nodes[way], buffers[way]))
                for way in WAYS
            }
            times = self._nodes["proxy"].create_subscription(TRANSFORMS, TF, qos=TF_QOS)
            stack.callback(times.close)
            await stack.enter_async_context(beside(listen()))
            looks, tries = await self._look(round_, listeners["proxy"], buffers)
        edges = [{"way": way, **asdict(edge)} for way in WAYS for edge in buffers[way].edges]
        tree = to_json({"still": _still(buffers["proxy"]), "moving": _thinned(moving)})
        return {"looks": looks, "tries": tries, "heard": heard, "edges": edges, "tree": tree}

    async def _look(
        self, round_: _Round, listener: FramesListener, buffers: Mapping[str, FrameBuffer]
    ) -> tuple[list[dict[str, float]], dict[str, dict[str, int]]]:
        clock = self._nodes["proxy"].get_clock()
        rng = np.random.default_rng(self._seed)
        tries: dict[str, Counter[str]] = {way: Counter() for way in WAYS}
        waiting = []
        due_ns = round_.start_ns + _EARLY_NS // 2
        while due_ns < round_.end_ns:
            await clock.sleep_for(max(0.0, (due_ns - clock.now_ns()) / 1e9))
            now_ns = clock.now_ns()
            for way, buffer in buffers.items():
                tries[way][_outcome(buffer)] += 1
            waiting.append(
                asyncio.create_task(_asked(listener, buffers["proxy"], round_, now_ns, clock))
            )
            due_ns += round(float(rng.uniform(0.5, 1.5)) / LOOK_HZ * 1e9)
        return list(await asyncio.gather(*waiting)), {
            way: dict(counts) for way, counts in tries.items()
        }


def _still(buffer: FrameBuffer) -> list[tuple[int, StampedTransform]]:
    """Return the static transforms that were heard, with no time of arrival."""
    ends = [(edge.parent, edge.child) for edge in buffer.edges if edge.static]
    poses = [(parent, child, buffer.look_up(parent, child)) for parent, child in ends]
    return [(0, StampedTransform(parent=a, child=b, stamp_ns=0, pose=pose)) for a, b, pose in poses]


def _thinned(moving: list[tuple[int, StampedTransform]]) -> list[tuple[int, StampedTransform]]:
    """Return the same share of every frame's transforms, at most so many of each."""
    counts = Counter(transform.child for _, transform in moving)
    every = max(1, -(-max(counts.values(), default=0) // _MOST_KEPT))
    places = {child: itertools.count() for child in counts}
    return [(at_ns, one) for at_ns, one in moving if next(places[one.child]) % every == 0]


def _outcome(buffer: FrameBuffer) -> str:
    try:
        buffer.look_up(WORLD, CAMERA)
    except FrameError as error:
        return type(error).__name__
    return "found"


async def _asked(
    listener: FramesListener, buffer: FrameBuffer, round_: _Round, now_ns: int, clock: Any
) -> dict[str, float]:
    """Return a look's numbers by the columns of `MocapLookRow`."""
    true = world_from_camera(round_.start_ns, now_ns)
    look = dict.fromkeys(
        ("wait_ms", "error_mm", "error_mrad", "age_ms", "latest_mm", "latest_mrad"), math.nan
    )
    with suppress(FrameError):
        latest, known = buffer.look_up(WORLD, CAMERA), buffer.interval(WORLD, CAMERA)
        assert known is not None
        look |= {"age_ms": (now_ns - known[1]) / 1e6, **_off("latest", latest, true)}
    with suppress(FrameError):
        pose = await listener.wait_for(WORLD, CAMERA, now_ns, timeout_s=_PATIENCE_S)
        look |= {"wait_ms": (clock.now_ns() - now_ns) / 1e6, **_off("error", pose, true)}
    return {"at_s": (now_ns - round_.start_ns) / 1e9, **look}


def _off(name: str, pose: Pose, true: Pose) -> dict[str, float]:
    return {f"{name}_mm": 1e3 * pose.distance_m(true), f"{name}_mrad": 1e3 * pose.angle_rad(true)}


def _send(publishers: Sequence[Publisher], transforms: Sequence[StampedTransform]) -> None:
    for publisher in publishers:
        publisher.publish(message_type(TRANSFORMS)(transforms=[t.to_msg() for t in transforms]))


_ROLES: dict[str, Callable[[Mapping[str, Node], int], Any]] = {
    "robot": _Robot,
    "bridge": _Bridge,
    "listener": _Listener,
}


async def serve(config: MocapWorkerConfig, report: Reporter, orders: Orders) -> None:
    """Be the process: play rounds until it is told to end."""
    async with AsyncExitStack() as stack:
        nodes: dict[str, Node] = {
            way: await stack.enter_async_context(Node(config.role, **address.options()))
            for way, address in config.ways.items()
        }
        part = _ROLES[config.role](nodes, config.seed)
        FrameBuffer()  # what only the first one costs
        report({"is": "ready"})
        while True:
            order = await orders.get()
            report({"is": "played", **await part.play(_Round(**order))})


if __name__ == "__main__":
    run_component(MocapWorkerConfig, serve)
