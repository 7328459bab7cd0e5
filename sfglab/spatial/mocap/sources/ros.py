"""Captures that came as ROS messages: from topics of the bus, or from a log of such."""

from __future__ import annotations

import asyncio
from collections import deque
from contextlib import aclosing, asynccontextmanager
from functools import partial
from heapq import merge
from typing import TYPE_CHECKING, Any

from sfglab.messages import ns_from_stamp
from sfglab.qos import SENSOR_DATA
from sfglab.spatial.mocap.capture import Capture, Lapse, MocapError
from sfglab.spatial.poses import Pose, PoseError

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, AsyncIterator, Iterator, Mapping

    from sfglab.bus.api import Clock, Node
    from sfglab.qos import QoSProfile
    from sfglab.record import LogReader
    from sfglab.spatial.mocap.capture import Sight


POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
_QUEUE = 1000


def capture_of(object_id: str, message: Any, receipt_ns: int) -> Capture:
    """Return a message's capture: one object, stamped as its header says.

    Args:
        object_id: The object that it is about.
        message: A `geometry_msgs/msg/PoseStamped` or `geometry_msgs/msg/TransformStamped`.
        receipt_ns: When it arrived.
    """
    content = message.transform if hasattr(message, "transform") else message.pose
    try:
        sight: Sight = Pose.from_msg(content, place=object_id)
    except PoseError:
        sight = Lapse.INVALID
    capture_ns = ns_from_stamp(message.header.stamp)
    return Capture(number=None, capture_ns=capture_ns, receipt_ns=receipt_ns, sights={object_id: sight})


class TopicSource:
    """Captures from topics, one per object.

    Args:
        node: The node that subscribes.
        topics: Each object's topic.
        type_: Of all topics: `POSE` or `TRANSFORM`.
        qos: What is requested; best effort by default, which fits all publishers.

    Attributes:
        overflowed: How many messages were pushed out by newer ones because the bridge did not keep up.

    Raises:
        MocapError: Another type, or no topic.
    """

    def __init__(
        self, node: Node, topics: Mapping[str, str], *, type_: str = POSE, qos: QoSProfile = SENSOR_DATA
    ) -> None:
        if type_ not in {POSE, TRANSFORM}:
            raise MocapError(f"topic source: given the type {type_!r}, allowed are {POSE} and {TRANSFORM}")
        if not topics:
            raise MocapError("topic source: no topic is given, allowed is a topic per object, at least one")
        self._node, self._topics, self._type, self._qos = node, dict(topics), type_, qos
        self._queue: deque[Capture] = deque(maxlen=_QUEUE)
        self._came = asyncio.Event()
        self.overflowed = 0

    @asynccontextmanager
    async def captures(self) -> AsyncIterator[AsyncIterator[Capture]]:
        """Subscribe."""
        subscriptions = [
            self._node.create_subscription(self._type, topic, partial(self._hear, id_), self._qos)
            for id_, topic in self._topics.items()
        ]
        try:
            async with aclosing(self._heard()) as captures:
                yield captures
        finally:
            for subscription in subscriptions:
                subscription.close()

    def _hear(self, object_id: str, message: Any) -> None:
        self.overflowed += len(self._queue) == _QUEUE
        self._queue.append(capture_of(object_id, message, self._node.get_clock().now_ns()))
        self._came.set()

    async def _heard(self) -> AsyncGenerator[Capture, None]:
        while True:
            while self._queue:
                yield self._queue.popleft()
            self._came.clear()
            await self._came.wait()


class LogSource:
    """Captures from a log's topics, in the order in which they were received.

    Args:
        reader: The log, of any recorder.
        topics: Each object's topic, with `POSE` or `TRANSFORM` messages.
        clock: A node's clock, to hand captures out at the pace of the log; None hands them out at once.
    """

    def __init__(self, reader: LogReader, topics: Mapping[str, str], *, clock: Clock | None = None) -> None:
        self._reader, self._topics, self._clock = reader, dict(topics), clock

    def recorded(self) -> Iterator[Capture]:
        """Yield all captures; receipt is the time of the log.

        Raises:
            LogLookupError: The log has no such topic.
            MocapError: A topic has another type.
        """
        types = {topic: info.type_name for topic, info in self._reader.topics.items()}
        for topic in self._topics.values():
            if types.get(topic, POSE) not in {POSE, TRANSFORM}:
                raise MocapError(f"{topic}: given the type {types[topic]}, allowed are {POSE} and {TRANSFORM}")
        streams = [self._stream(id_, topic) for id_, topic in self._topics.items()]
        return merge(*streams, key=lambda capture: capture.receipt_ns)

    @asynccontextmanager
    async def captures(self) -> AsyncIterator[AsyncIterator[Capture]]:
        """Begin with the first one."""
        async with aclosing(self._paced()) as captures:
            yield captures

    def _stream(self, object_id: str, topic: str) -> Iterator[Capture]:
        for recorded in self._reader.decoded(topic):
            yield capture_of(object_id, recorded.message, recorded.log_time_ns)

    async def _paced(self) -> AsyncGenerator[Capture, None]:
        ahead_ns: int | None = None
        for capture in self.recorded():
            if self._clock is not None:
                now_ns = self._clock.now_ns()
                ahead_ns = now_ns - capture.receipt_ns if ahead_ns is None else ahead_ns
                await self._clock.sleep_for(max(0.0, (capture.receipt_ns + ahead_ns - now_ns) / 1e9))
            yield capture
