"""Captures from topics of the bus, from a log of such, or from a Vicon Tracker.

The Tracker speaks through `pyvicon-datastream`, which is installed only where it is needed. It gives
millimetres, quaternions as w, x, y, z, None for what is occluded, and the latency from the cameras to its own
hands in seconds; receipt less that latency is when the cameras saw it. It blocks, so it runs in a thread.

Source: pyvicon_datastream/pyvicon_datastream.py of pyvicon-datastream 0.2; Vicon DataStream SDK 1.11 manual.
"""

from __future__ import annotations

import asyncio
import importlib
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from heapq import merge
from typing import TYPE_CHECKING, Any

from sfglab.messages import ns_from_stamp
from sfglab.qos import SENSOR_DATA, QoSProfile
from sfglab.spatial.mocap.tracking import Capture, Lapse, MocapError, Sight
from sfglab.spatial.poses import Pose, PoseError
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Iterator, Mapping

    from sfglab.bus import Clock, Node
    from sfglab.record import LogReader


POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
_QUEUE = 1000


def capture_of(object_id: str, message: Any, receipt_ns: int) -> Capture:
    """Return the capture of one object in a `POSE` or `TRANSFORM` message, stamped as its header says."""
    content = message.transform if hasattr(message, "transform") else message.pose
    try:
        sight: Sight = Pose.from_msg(content, place=object_id)
    except PoseError:
        sight = Lapse.INVALID
    capture_ns = ns_from_stamp(message.header.stamp)
    return Capture(
        number=None, capture_ns=capture_ns, receipt_ns=receipt_ns, sights={object_id: sight}
    )


class TopicSource:
    """Captures from topics, one per object, all `POSE` or all `TRANSFORM`; best effort unless told otherwise.

    Raises:
        MocapError: Another type, or no topic.
    """

    def __init__(
        self,
        node: Node,
        topics: Mapping[str, str],
        *,
        type_: str = POSE,
        qos: QoSProfile = SENSOR_DATA,
    ) -> None:
        if type_ not in {POSE, TRANSFORM}:
            raise MocapError(
                f"topic source: given the type {type_!r}, allowed are {POSE} and {TRANSFORM}"
            )
        if not topics:
            raise MocapError(
                "topic source: no topic is given, allowed is a topic per object, at least one"
            )
        self._node, self._topics, self._type, self._qos = node, dict(topics), type_, qos
        self._queue: deque[Capture] = deque(maxlen=_QUEUE)
        self._came = asyncio.Event()
        self.overflowed = 0  #: How many messages newer ones pushed out, as the bridge was late.

    async def captures(self) -> AsyncGenerator[Capture, None]:
        """Subscribe, and yield what comes."""
        subscriptions = [
            self._node.create_subscription(self._type, topic, partial(self._hear, id_), self._qos)
            for id_, topic in self._topics.items()
        ]
        try:
            while True:
                while self._queue:
                    yield self._queue.popleft()
                self._came.clear()
                await self._came.wait()
        finally:
            for subscription in subscriptions:
                subscription.close()

    def _hear(self, object_id: str, message: Any) -> None:
        self.overflowed += len(self._queue) == _QUEUE
        self._queue.append(capture_of(object_id, message, self._node.get_clock().now_ns()))
        self._came.set()


class LogSource:
    """Captures from a log's `POSE` or `TRANSFORM` topics as received; with a clock at the log's pace."""

    def __init__(
        self, reader: LogReader, topics: Mapping[str, str], *, clock: Clock | None = None
    ) -> None:
        self._reader, self._topics, self._clock = reader, dict(topics), clock

    def recorded(self) -> Iterator[Capture]:
        """Yield all captures, received at log time; LogError without a topic, MocapError for another type."""
        types = {topic: info.type_name for topic, info in self._reader.topics.items()}
        for topic in self._topics.values():
            if types.get(topic, POSE) not in {POSE, TRANSFORM}:
                raise MocapError(
                    f"{topic}: given the type {types[topic]}, allowed are {POSE} and {TRANSFORM}"
                )
        streams = [self._stream(id_, topic) for id_, topic in self._topics.items()]
        return merge(*streams, key=lambda capture: capture.receipt_ns)

    def _stream(self, object_id: str, topic: str) -> Iterator[Capture]:
        for recorded in self._reader.decoded(topic):
            yield capture_of(object_id, recorded.message, recorded.log_time_ns)

    async def captures(self) -> AsyncGenerator[Capture, None]:
        """Yield all captures at the pace of the log, if there is a clock."""
        ahead_ns: int | None = None
        for capture in self.recorded():
            if self._clock is not None:
                now_ns = self._clock.now_ns()
                ahead_ns = now_ns - capture.receipt_ns if ahead_ns is None else ahead_ns
                await self._clock.sleep_for(
                    max(0.0, (capture.receipt_ns + ahead_ns - now_ns) / NS_PER_S)
                )
            yield capture


_MODULE = "pyvicon_datastream"
_NO_FRAME_PAUSE_S = 0.002


class ViconSource:
    """Captures of all subjects that a Vicon Tracker has, each by its root segment.

    Objects are called ``subject/segment``, or ``subject`` where both have the same name. The host is as in
    "192.168.10.1:801"; the clock gives the times of receipt.

    Raises:
        MocapError: `pyvicon-datastream` is not installed; says how to install it.
    """

    def __init__(self, host: str, *, clock: Clock) -> None:
        try:
            self._library: Any = importlib.import_module(_MODULE)
        except ImportError as error:
            raise MocapError(
                f"the Vicon source needs {_MODULE!r}, which is not installed: pip install pyvicon-datastream"
            ) from error
        self._host, self._clock = host, clock

    async def captures(self) -> AsyncGenerator[Capture, None]:
        """Connect, and yield what is sent.

        Raises:
            MocapError: The Tracker does not answer, or refuses a setting; also later, when the connection ends.
        """
        client = self._library.PyViconDatastream()
        loop = asyncio.get_running_loop()
        with ThreadPoolExecutor(1, thread_name_prefix="vicon") as thread:
            try:
                await loop.run_in_executor(thread, self._connect, client)
                while True:
                    capture = await loop.run_in_executor(thread, self._frame, client)
                    if capture is not None:
                        yield capture
                    else:
                        await asyncio.sleep(_NO_FRAME_PAUSE_S)
            finally:
                await loop.run_in_executor(thread, client.disconnect)

    def _connect(self, client: Any) -> None:
        library = self._library
        self._demand("connect", client.connect(self._host))
        self._demand("enable segment data", client.enable_segment_data())
        self._demand("set the stream mode", client.set_stream_mode(library.StreamMode.ServerPush))
        axes = (library.Direction.Forward, library.Direction.Left, library.Direction.Up)
        self._demand("set the axes", client.set_axis_mapping(*axes))

    def _demand(self, what: str, result: Any) -> None:
        if result != self._library.Result.Success:
            raise MocapError(
                f"Vicon Tracker at {self._host}: asked to {what}, it answered {result.name}"
            )

    def _frame(self, client: Any) -> Capture | None:
        result = client.get_frame()
        receipt_ns = self._clock.now_ns()
        if result == self._library.Result.NoFrame:
            return None
        self._demand("send a frame", result)
        subjects = [client.get_subject_name(i) for i in range(client.get_subject_count())]
        sights = dict(self._sight(client, subject) for subject in subjects if subject is not None)
        latency_ns = round(client.get_latency_total() * NS_PER_S)
        return Capture(
            number=int(client.get_frame_number()),
            capture_ns=receipt_ns - latency_ns,
            receipt_ns=receipt_ns,
            sights=sights,
        )

    @staticmethod
    def _sight(client: Any, subject: str) -> tuple[str, Sight]:
        segment = client.get_subject_root_segment_name(subject) or subject
        object_id = subject if segment == subject else f"{subject}/{segment}"
        position_mm = client.get_segment_global_translation(subject, segment)
        quat_wxyz = client.get_segment_global_quaternion(subject, segment)
        if position_mm is None or quat_wxyz is None:
            return object_id, Lapse.OCCLUDED
        w, x, y, z = quat_wxyz
        try:
            return object_id, Pose.at(
                (v / 1000.0 for v in position_mm), (x, y, z, w), place=object_id
            )
        except PoseError:
            return object_id, Lapse.INVALID
