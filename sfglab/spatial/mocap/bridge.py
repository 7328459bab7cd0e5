"""Motion-capture bridge: it converts captures into transforms, and publishes a status.

`BridgeCore` makes the decisions without clock and node, and `MocapBridge` is its node. The topic of the status,
`sfglab_interfaces/msg/MocapStatus`, is global, so that routers forward it (paper A, section 4.1).
"""

from __future__ import annotations

import asyncio
import logging
import math
import statistics
from collections import Counter, deque
from contextlib import aclosing
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
    SettlingError,
    place_via_proxy,
)
from sfglab.spatial.mocap.tracking import (
    Capture,
    Limits,
    MocapSource,
    Sight,
    Track,
    TrackState,
    Verdict,
)
from sfglab.spatial.poses import Pose, StampedTransform
from sfglab.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from sfglab.bus import Node, Publisher


STATUS = "sfglab_interfaces/msg/MocapStatus"
#: Late joiners receive the latest status.
STATUS_QOS = QoSProfile(depth=1, durability=Durability.TRANSIENT_LOCAL)
_OBJECT = "sfglab_interfaces/msg/MocapObject"
_RECENT = 1000  # transforms whose latency counts
_STATUS_PERIOD_S = 1.0
#: Time, ns, by which an agent's transforms are extrapolated if they are older than a capture.
_REACH_NS = 100 * NS_PER_MS
_SETTLE_NS = 500 * NS_PER_MS

_log = logging.getLogger(__name__)


class ObjectStatus:
    """State and counters of one captured object, as the bridge reports them."""

    def __init__(self, mapped: MappedObject, limits: Limits) -> None:
        self.mapped = mapped  #: Object of the mapping.
        self.track = Track(limits)  #: Poses of the object over time.
        self.frame = ""  #: Frame that was published latest; empty before the first one.
        self.published = 0  #: Number of published transforms.
        self.unplaced = 0  #: Number of sound poses that the agent's tree did not allow to publish.
        self.absent = 0  #: Number of captures without the object.
        self.verdicts: Counter[Verdict] = Counter()  #: Number of captures by verdict.
        self.capture_ns = 0  #: Stamp of the latest transform, ns; 0 before the first one.
        self.problem = ""  #: Reason why the latest sound pose was not published; empty if it was.
        self._logged: set[type[Exception]] = set()
        self.root = ""  #: Root of the agent's tree, at the latest sound pose.
        self.root_since_ns = 0  #: Time of the first capture with this root, ns.
        self._latencies_ns: deque[int] = deque(maxlen=_RECENT)

    @property
    def latency_s(self) -> float:
        """Median time from capture to receipt over the latest 1000 transforms, s; NaN without any."""
        latencies = self._latencies_ns
        return statistics.median(latencies) / NS_PER_S if latencies else math.nan

    def note_published(self, frame: str, capture: Capture) -> None:
        """Record a transform of the object that is published now."""
        self.published += 1
        self.frame = frame
        self.problem = ""
        self.capture_ns = capture.capture_ns
        self._latencies_ns.append(capture.receipt_ns - capture.capture_ns)

    def note_unplaced(self, error: Exception) -> None:
        """Record a sound pose that cannot be published; each kind of fault is logged once."""
        self.unplaced += 1
        self.problem = str(error)
        is_fault = not isinstance(error, SettlingError)
        if is_fault and type(error) not in self._logged:
            self._logged.add(type(error))
            _log.warning("object %r: %s", self.mapped.id, error)


class BridgeCore:
    """Converts captures into transforms that keep the agents' trees whole.

    The agents' transforms are extrapolated by up to 0.1 s if they are older than a capture.

    Args:
        mapping: Objects and their frames.
        buffer: Transforms of the agents.
        settle_ns: Time for which a root that the mapping does not name must be the same before it is
            published, ns: an agent's static transforms may be received before its odometry.
    """

    def __init__(self, mapping: MocapMapping, buffer: FrameBuffer, *, settle_ns: int = 0) -> None:
        self.world = mapping.world  #: Frame in which the capture system measures.
        self.captures = 0  #: Number of captures.
        self.dropped = 0  #: Number of lost captures: gaps in the frame numbers.
        self.unmapped: Counter[str] = Counter()  #: Detections of objects without a mapping, by id.
        self._buffer = buffer
        self._settle_ns = settle_ns
        self._number: int | None = None
        self._objects: dict[str, ObjectStatus] = {}
        for id_, mapped in mapping.objects.items():
            self._objects[id_] = ObjectStatus(mapped, mapping.limits)
        self._movers: dict[str, str] = {}  # object that moves a frame

    @property
    def statuses(self) -> tuple[ObjectStatus, ...]:
        """Status of each object of the mapping; the objects change with the next capture."""
        return tuple(self._objects.values())

    def take(self, capture: Capture) -> list[StampedTransform]:
        """Process a capture, and return the transforms to publish now, stamped with the capture time."""
        self._count(capture)
        transforms = []
        for id_, status in self._objects.items():
            sight = capture.sights.get(id_)
            if sight is None:
                status.absent += 1
                continue
            transform = self._placed(status, sight, capture)
            if transform is not None:
                status.note_published(transform.child, capture)
                transforms.append(transform)
        return transforms

    def _count(self, capture: Capture) -> None:
        self.captures += 1
        self.unmapped.update(id_ for id_ in capture.sights if id_ not in self._objects)
        if capture.number is None:
            return
        if self._number is not None and capture.number > self._number:
            self.dropped += capture.number - self._number - 1
        self._number = capture.number  # a lower number is that of a restarted server

    def _placed(
        self, status: ObjectStatus, sight: Sight, capture: Capture
    ) -> StampedTransform | None:
        verdict = status.track.judge(sight, capture.capture_ns)
        status.verdicts[verdict] += 1
        if not verdict.is_published or not isinstance(sight, Pose):
            return None
        mapped = status.mapped
        seen = StampedTransform(
            parent=self.world, child=mapped.id, stamp_ns=capture.capture_ns, pose=sight
        )
        try:
            transform = place_via_proxy(self._buffer, mapped, seen, reach_ns=_REACH_NS)
            self._check_root(status, transform)
        except (FrameError, PlacingError) as error:
            status.note_unplaced(error)
            return None
        return transform

    def _check_root(self, status: ObjectStatus, transform: StampedTransform) -> None:
        root = transform.child
        if root != status.root:
            status.root, status.root_since_ns = root, transform.stamp_ns
        known_ns = transform.stamp_ns - status.root_since_ns
        if not status.mapped.frame and known_ns < self._settle_ns:
            why = f"it is the root for less than {self._settle_ns / NS_PER_S:g} s"
            raise SettlingError(root, why)
        mover = self._movers.setdefault(root, status.mapped.id)
        if mover != status.mapped.id:
            raise PlacingError(root, f"object {mover!r} moves it already")


def status_topic(agent: str = "") -> str:
    """Return the topic of a bridge's status, below the agent's name if an agent is given."""
    name = RosFqnBuilder().scope(Scope.GLOBAL).resource(Custom("mocap_status"))
    return str((name.agent(agent) if agent else name.without_agent()).build())


def status_message(core: BridgeCore, now_ns: int) -> Any:
    """Return the `sfglab_interfaces/msg/MocapStatus` of a bridge."""
    return message_type(STATUS)(
        stamp=stamp_from_ns(now_ns),
        world=core.world,
        captures=core.captures,
        dropped=core.dropped,
        unmapped=core.unmapped.total(),
        objects=[_object_message(status) for status in core.statuses],
    )


def _object_message(status: ObjectStatus) -> Any:
    make = message_type(_OBJECT)
    states = {state: getattr(make, state.name) for state in TrackState}
    counts = {verdict.value: status.verdicts[verdict] for verdict in Verdict}
    return make(
        id=status.mapped.id,
        frame=status.frame,
        state=states[status.track.state],
        published=status.published,
        unplaced=status.unplaced,
        absent=status.absent,
        captured=stamp_from_ns(status.capture_ns),
        receipt_latency_s=status.latency_s,
        publication_latency_s=math.nan,
        problem=status.problem,
        **counts,
    )


class MocapBridge:
    """Bridge that publishes poses from a capture system as TF, so that each agent keeps one TF tree.

    The node subscribes to /tf and /tf_static. It publishes transforms on /tf, and the status on `status_topic`.

    ```python
    bridge = MocapBridge(node, ViconSource("192.168.10.1", clock=node.get_clock()), load_mapping(path))
    await bridge.run()
    ```

    Args:
        node: Node in the domain.
        source: Source of captures.
        mapping: Objects and their frames.
        agent: Agent in the name of the status topic; empty: none.
    """

    def __init__(
        self, node: Node, source: MocapSource, mapping: MocapMapping, *, agent: str = ""
    ) -> None:
        self._node, self._source, self._agent = node, source, agent
        self._buffer = FrameBuffer()
        #: Core that makes the decisions.
        self.core = BridgeCore(mapping, self._buffer, settle_ns=_SETTLE_NS)

    async def run(self) -> None:
        """Run until the source ends, or until cancelled.

        Raises:
            MocapError: The source cannot be opened, or fails.
        """
        publisher = self._node.create_publisher(TRANSFORMS, TF, TF_QOS)
        status = self._node.create_publisher(STATUS, status_topic(self._agent), STATUS_QOS)
        reporting = asyncio.create_task(self._report(status))
        try:
            async with (
                FramesListener(self._node, self._buffer),
                aclosing(self._source.captures()) as captures,
            ):
                async for capture in captures:
                    self._publish(capture, publisher)
        finally:
            reporting.cancel()
            await asyncio.gather(reporting, return_exceptions=True)
            status.close()
            publisher.close()

    def _publish(self, capture: Capture, publisher: Publisher) -> None:
        transforms = self.core.take(capture)
        if transforms:
            messages = [transform.to_msg() for transform in transforms]
            publisher.publish(message_type(TRANSFORMS)(transforms=messages))

    async def _report(self, status: Publisher) -> None:
        clock = self._node.get_clock()
        while True:
            status.publish(status_message(self.core, clock.now_ns()))
            await clock.sleep_for(_STATUS_PERIOD_S)
