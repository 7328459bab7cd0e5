"""The bridge: captures in, transforms and a status out.

`BridgeCore` decides, without clock and socket, and `MocapBridge` is its node. The status,
`sfglab_interfaces/msg/MocapStatus`, has a global topic, so that it crosses the routers (paper A, section 4.1).
"""

from __future__ import annotations

import asyncio
import logging
import math
import statistics
from collections import Counter, deque
from contextlib import aclosing
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from sfglab.messages import message_type, stamp_from_ns
from sfglab.names import TF, Custom, RosFqnBuilder, Scope
from sfglab.qos import Durability, QoSProfile
from sfglab.spatial.frames.buffer import FrameBuffer, FrameError
from sfglab.spatial.frames.listener import TF_QOS, TRANSFORMS, FramesListener
from sfglab.spatial.mocap.mapping import (
    MappedObject,
    MocapMapping,
    PlacingError,
    direct_name,
    direct_transforms,
    place_via_proxy,
)
from sfglab.spatial.mocap.tracking import (
    Capture,
    MocapSource,
    Sight,
    Track,
    TrackState,
    Verdict,
    judge,
)
from sfglab.spatial.poses import Pose, StampedTransform
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.bus import Node, Publisher


_log = logging.getLogger(__name__)

_WINDOW = 1000


@dataclass(slots=True)
class Latency:
    """A delay over the last 1000 transforms."""

    largest_ns: int | None = None  #: The largest one ever; None before the first.
    #: The last ones, in ns.
    recent: deque[int] = field(default_factory=lambda: deque(maxlen=_WINDOW))

    def add(self, delay_ns: int) -> None:
        """Take one more."""
        self.recent.append(delay_ns)
        self.largest_ns = delay_ns if self.largest_ns is None else max(self.largest_ns, delay_ns)

    @property
    def median_ns(self) -> float | None:
        """Its median; None before the first."""
        return statistics.median(self.recent) if self.recent else None


@dataclass(slots=True)
class MocapObjectStatus:
    """How it stands with one object."""

    mapped: MappedObject  #: Which frame it stands for.
    track: Track = field(default_factory=Track)  #: What is remembered of it.
    frame: str = ""  #: The frame that was published for it last; empty before the first.
    published: int = 0  #: How many transforms left.
    unplaced: int = 0  #: How many believed poses the agent's tree did not allow to publish.
    absent: int = 0  #: In how many captures it did not occur at all.
    #: How many sights got each `Verdict.value`.
    verdicts: Counter[str] = field(default_factory=Counter)
    capture_ns: int | None = None  #: The stamp of the last transform; None before the first.
    receipt_latency: Latency = field(default_factory=Latency)  #: From capture to receipt.
    publication_latency: Latency = field(default_factory=Latency)  #: From receipt to publication.
    problem: str = ""  #: Why the last believed pose was not published; empty when it was.
    problem_kind: str = ""  #: The error's name.


class BridgeCore:
    """Turns captures into transforms that keep agents' trees whole, which may lag by `reach_s`."""

    def __init__(self, mapping: MocapMapping, buffer: FrameBuffer, *, reach_s: float = 0.1) -> None:
        self.world = mapping.world  #: The frame in which the capture system measures.
        self._mapping = mapping
        self._buffer = buffer
        self._reach_ns = round(reach_s * NS_PER_S)
        self._objects = {id_: MocapObjectStatus(mapped) for id_, mapped in mapping.objects.items()}
        self._holders: dict[str, str] = {}
        self._number: int | None = None
        self.captures = 0  #: How many captures came.
        self.dropped = 0  #: How many frame numbers are missing between those that came.
        #: How often objects came that the mapping lacks, by id.
        self.unmapped: Counter[str] = Counter()

    def take(self, capture: Capture, now_ns: int) -> tuple[StampedTransform, ...]:
        """Take a capture, and return what is to be published now, stamped with the capture time."""
        self._count(capture)
        transforms = []
        for id_, object_ in self._objects.items():
            if id_ not in capture.sights:
                object_.absent += 1
            elif transform := self._placed(object_, capture.sights[id_], capture, now_ns):
                transforms.append(transform)
        return tuple(transforms)

    @property
    def statuses(self) -> tuple[MocapObjectStatus, ...]:
        """How it stands with every object of the mapping; they go on changing."""
        return tuple(self._objects.values())

    def verdicts(self, object_id: str) -> dict[str, int]:
        """Return how many sights of an object got each `Verdict.value`; KeyError for an unknown object."""
        return dict(self._objects[object_id].verdicts)

    def _count(self, capture: Capture) -> None:
        self.captures += 1
        self.unmapped.update(id_ for id_ in capture.sights if id_ not in self._objects)
        if capture.number is None:
            return
        if self._number is not None and capture.number > self._number:
            self.dropped += capture.number - self._number - 1
        self._number = capture.number  # a lower one is a server that began anew

    def _placed(
        self, object_: MocapObjectStatus, sight: Sight, capture: Capture, now_ns: int
    ) -> StampedTransform | None:
        object_.track, verdict = judge(
            object_.track, sight, capture.capture_ns, self._mapping.limits
        )
        object_.verdicts[verdict.value] += 1
        if not verdict.believed or not isinstance(sight, Pose):
            return None
        try:
            transform = self._transform(object_.mapped, sight, capture.capture_ns)
        except (FrameError, PlacingError) as error:
            object_.unplaced += 1
            object_.problem_kind, object_.problem = type(error).__name__, str(error)
            return None
        object_.published += 1
        object_.problem_kind, object_.problem, object_.frame = "", "", transform.child
        object_.capture_ns = capture.capture_ns
        object_.receipt_latency.add(capture.receipt_ns - capture.capture_ns)
        object_.publication_latency.add(now_ns - capture.receipt_ns)
        return transform

    def _transform(self, mapped: MappedObject, pose: Pose, capture_ns: int) -> StampedTransform:
        seen = StampedTransform(parent=self.world, child=mapped.id, stamp_ns=capture_ns, pose=pose)
        transform = place_via_proxy(self._buffer, mapped, seen, reach_ns=self._reach_ns)
        holder = self._holders.setdefault(transform.child, mapped.id)
        if holder != mapped.id:
            raise PlacingError(transform.child, f"object {holder!r} moves it already")
        return transform


_ROBOT, _CAMERAS = "robot", "mocap"


@dataclass(frozen=True, slots=True, kw_only=True)
class MocapTrees:
    """One robot's tree with motion capture joined to it in three ways; see `lint_frames` for what is wrong."""

    direct: FrameBuffer  #: With the direct receiver's transforms: Fig. 6, left.
    #: With the same under the right names, as if the receiver could be told: "even if this naming conflict were
    #: resolved".
    renamed: FrameBuffer
    proxy: FrameBuffer  #: With the bridge's: Fig. 6, right.


def mocap_trees(
    description: Sequence[StampedTransform], mapping: MocapMapping, captures: Sequence[Capture]
) -> MocapTrees:
    """Join captures to the tree of a robot's own, static frames in three ways."""
    direct, renamed, proxy = (_described(description) for _ in range(3))
    right = {direct_name(id_): mapped.via for id_, mapped in mapping.objects.items()}
    core = BridgeCore(mapping, proxy)
    for capture in captures:
        for transform in direct_transforms(capture, world=mapping.world):
            direct.insert(transform, authority=_CAMERAS)
            child = right.get(transform.child, transform.child)
            renamed.insert(replace(transform, child=child), authority=_CAMERAS)
        for transform in core.take(capture, capture.receipt_ns):
            proxy.insert(transform, authority=_CAMERAS)
    return MocapTrees(direct=direct, renamed=renamed, proxy=proxy)


def _described(description: Sequence[StampedTransform]) -> FrameBuffer:
    buffer = FrameBuffer()
    for transform in description:
        buffer.insert(transform, static=True, authority=_ROBOT)
    return buffer


STATUS = "sfglab_interfaces/msg/MocapStatus"
#: Late joiners get the last one.
STATUS_QOS = QoSProfile(depth=1, durability=Durability.TRANSIENT_LOCAL)
_OBJECT = "sfglab_interfaces/msg/MocapObject"


def status_topic(agent: str = "") -> str:
    """Return where a bridge tells its status; an empty agent: it is nobody's in particular."""
    name = RosFqnBuilder().scope(Scope.GLOBAL).resource(Custom("mocap_status"))
    return str((name.agent(agent) if agent else name.without_agent()).build())


def status_message(core: BridgeCore, now_ns: int) -> Any:
    """Return a `sfglab_interfaces/msg/MocapStatus` of a bridge."""
    return message_type(STATUS)(
        stamp=stamp_from_ns(now_ns),
        world=core.world,
        captures=core.captures,
        dropped=core.dropped,
        unmapped=core.unmapped.total(),
        objects=[_object(status) for status in core.statuses],
    )


def _object(status: MocapObjectStatus) -> Any:
    make = message_type(_OBJECT)
    states = {state: getattr(make, state.name) for state in TrackState}
    return make(
        id=status.mapped.id,
        frame=status.frame,
        state=states[status.track.state],
        published=status.published,
        unplaced=status.unplaced,
        absent=status.absent,
        **{verdict.value: status.verdicts.get(verdict.value, 0) for verdict in Verdict},
        captured=stamp_from_ns(status.capture_ns or 0),
        receipt_latency_s=_seconds(status.receipt_latency),
        publication_latency_s=_seconds(status.publication_latency),
        problem=status.problem,
    )


def _seconds(latency: Latency) -> float:
    return math.nan if latency.median_ns is None else latency.median_ns / NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgeOptions:
    """How a bridge behaves."""

    #: How far the agents' transforms may be continued when they lag behind the cameras.
    reach_s: float = 0.1
    agent: str = ""  #: The agent on which the bridge runs, for the topic's name; empty: nobody's.
    status_period_s: float = 1.0  #: Time between two messages about the status.


class MocapBridge:
    """Publishes where a capture system sees the agents, in a way that keeps their trees whole.

    Its node listens to /tf and /tf_static, and publishes on /tf, and its status on `status_topic`.

    ```python
    bridge = MocapBridge(node, ViconSource("192.168.10.1", clock=node.get_clock()), load_mapping(path))
    await bridge.run()
    ```
    """

    def __init__(
        self,
        node: Node,
        source: MocapSource,
        mapping: MocapMapping,
        options: BridgeOptions | None = None,
    ) -> None:
        self.buffer = FrameBuffer()  #: All transforms heard, the bridge's own included.
        self._node, self._source = node, source
        self._options = options or BridgeOptions()
        self.core = BridgeCore(mapping, self.buffer, reach_s=self._options.reach_s)  #: It decides.
        self._said: set[tuple[str, str]] = set()

    async def run(self) -> None:
        """Run until the source ends, or until cancelled; MocapError where it cannot be opened, or broke."""
        publisher = self._node.create_publisher(TRANSFORMS, TF, TF_QOS)
        status = self._node.create_publisher(STATUS, status_topic(self._options.agent), STATUS_QOS)
        telling = asyncio.create_task(self._tell(status))
        try:
            async with (
                FramesListener(self._node, self.buffer),
                aclosing(self._source.captures()) as captures,
            ):
                async for capture in captures:
                    self._pass_on(capture, publisher)
        finally:
            telling.cancel()
            await asyncio.gather(telling, return_exceptions=True)
            status.close()
            publisher.close()

    def _pass_on(self, capture: Capture, publisher: Publisher) -> None:
        if transforms := self.core.take(capture, self._node.get_clock().now_ns()):
            publisher.publish(message_type(TRANSFORMS)(transforms=[t.to_msg() for t in transforms]))
        self._say_problems()

    async def _tell(self, status: Publisher) -> None:
        clock = self._node.get_clock()
        while True:
            status.publish(status_message(self.core, clock.now_ns()))
            await clock.sleep_for(self._options.status_period_s)

    def _say_problems(self) -> None:
        """Log each kind of problem of each object once."""
        for status in self.core.statuses:
            key = (status.mapped.id, status.problem_kind)
            if status.problem and key not in self._said:
                self._said.add(key)
                _log.warning("object %r: %s", status.mapped.id, status.problem)
