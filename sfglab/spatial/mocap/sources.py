"""Captures from ROS topics, from a log, or from a Vicon Tracker.

The Tracker is read with `pyvicon-datastream`, which users install only if they need it. The package returns
millimetres, quaternions as w, x, y, z, and None for an occluded object. It also returns the latency from
the cameras to its output in seconds: the capture time is the time of receipt minus this latency. The package's calls
block, so they run in a thread.

Source: pyvicon_datastream/pyvicon_datastream.py of pyvicon-datastream 0.2; Vicon DataStream SDK 1.11 manual.
"""

from __future__ import annotations

import asyncio
import importlib
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from heapq import merge
from typing import TYPE_CHECKING, Any

from sfglab.messages import ns_from_stamp
from sfglab.qos import SENSOR_DATA
from sfglab.spatial.mocap.tracking import Capture, Lapse, MocapError, Sight
from sfglab.spatial.poses import Pose, PoseError
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Iterable, Iterator, Mapping

    from sfglab.bus import Clock, Node
    from sfglab.record import LogReader


POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
_WAITING = 1000  # messages


def capture_of(object_id: str, message: Any, receipt_ns: int) -> Capture:
    """Return the capture of one object from a `POSE` or `TRANSFORM` message, with the stamp of its header."""
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
    """Captures from one topic per object, received with best effort.

    Args:
        node: Node that subscribes to the topic.
        topics: Topics by object.
        type_: Type of all topics: `POSE` or `TRANSFORM`.
    """

    def __init__(self, node: Node, topics: Mapping[str, str], type_: str = POSE) -> None:
        self._node, self._topics, self._type = node, topics, type_

    async def captures(self) -> AsyncGenerator[Capture, None]:
        """Subscribe, and yield one capture per message; of waiting captures, the latest 1000 are kept."""
        waiting: asyncio.Queue[Capture] = asyncio.Queue(_WAITING)

        def receive(object_id: str, message: Any) -> None:
            if waiting.full():
                waiting.get_nowait()
            waiting.put_nowait(capture_of(object_id, message, self._node.get_clock().now_ns()))

        subscriptions = [
            self._node.create_subscription(self._type, topic, partial(receive, id_), SENSOR_DATA)
            for id_, topic in self._topics.items()
        ]
        try:
            while True:
                yield await waiting.get()
        finally:
            for subscription in subscriptions:
                subscription.close()


class LogSource:
    """Captures from the `POSE` or `TRANSFORM` topics of a log, in the order and at the pace of receipt.

    Args:
        reader: The log.
        topics: Topics by object.
        clock: Clock of the pace.
    """

    def __init__(self, reader: LogReader, topics: Mapping[str, str], clock: Clock) -> None:
        self._reader, self._topics, self._clock = reader, topics, clock

    async def captures(self) -> AsyncGenerator[Capture, None]:
        """Yield all captures at the pace of the log; the time of receipt is the log time.

        Raises:
            LogError: The log has no such topic.
            MocapError: A topic has another type.
        """
        ahead_ns: int | None = None
        for capture in self._recorded():
            now_ns = self._clock.now_ns()
            ahead_ns = now_ns - capture.receipt_ns if ahead_ns is None else ahead_ns
            wait_ns = capture.receipt_ns + ahead_ns - now_ns
            await self._clock.sleep_for(max(0, wait_ns) / NS_PER_S)
            yield capture

    def _recorded(self) -> Iterable[Capture]:
        for topic in self._topics.values():
            info = self._reader.topics.get(topic)
            if info is not None and info.type_name not in {POSE, TRANSFORM}:
                raise MocapError(
                    f"{topic}: given the type {info.type_name}, allowed: {POSE} and {TRANSFORM}"
                )
        streams = [self._stream(id_, topic) for id_, topic in self._topics.items()]
        return merge(*streams, key=lambda capture: capture.receipt_ns)

    def _stream(self, object_id: str, topic: str) -> Iterator[Capture]:
        for recorded in self._reader.decoded(topic):
            yield capture_of(object_id, recorded.message, recorded.log_time_ns)


_MODULE = "pyvicon_datastream"
_NO_FRAME_PAUSE_S = 0.002


class ViconSource:
    """Captures of all subjects of a Vicon Tracker: one pose per subject, that of its root segment.

    Objects are named ``subject/segment``, or ``subject`` if both have the same name.

    Args:
        host: Address of the Tracker, e.g. "192.168.10.1:801".
        clock: Clock of the times of receipt.

    Raises:
        MocapError: `pyvicon-datastream` is not installed; the error says how to install it.
    """

    def __init__(self, host: str, *, clock: Clock) -> None:
        try:
            self._library: Any = importlib.import_module(_MODULE)
        except ImportError as error:
            raise MocapError(
                f"the Vicon source needs {_MODULE!r}, which is not installed; run pip install pyvicon-datastream"
            ) from error
        self._host, self._clock = host, clock

    async def captures(self) -> AsyncGenerator[Capture, None]:
        """Connect, and yield the captures that the Tracker sends.

        Raises:
            MocapError: The Tracker does not respond, rejects a setting, or ends the connection.
        """
        client = self._library.PyViconDatastream()
        loop = asyncio.get_running_loop()
        with ThreadPoolExecutor(1, thread_name_prefix="vicon") as thread:
            try:
                await loop.run_in_executor(thread, self._connect, client)
                while True:
                    capture = await loop.run_in_executor(thread, self._capture, client)
                    if capture is not None:
                        yield capture
                    else:
                        await asyncio.sleep(_NO_FRAME_PAUSE_S)
            finally:
                await loop.run_in_executor(thread, client.disconnect)

    def _connect(self, client: Any) -> None:
        library = self._library
        self._check("connect", client.connect(self._host))
        self._check("enable segment data", client.enable_segment_data())
        self._check("set the stream mode", client.set_stream_mode(library.StreamMode.ServerPush))
        axes = (library.Direction.Forward, library.Direction.Left, library.Direction.Up)
        self._check("set the axes", client.set_axis_mapping(*axes))

    def _check(self, what: str, result: Any) -> None:
        if result != self._library.Result.Success:
            raise MocapError(
                f"Vicon Tracker at {self._host}: it cannot {what} ({result.name}); check the address and Tracker"
            )

    def _capture(self, client: Any) -> Capture | None:
        result = client.get_frame()
        receipt_ns = self._clock.now_ns()
        if result == self._library.Result.NoFrame:
            return None
        self._check("send a frame", result)
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
        position_m = [value / 1000.0 for value in position_mm]
        try:
            return object_id, Pose.at(position_m, (x, y, z, w), place=object_id)
        except PoseError:
            return object_id, Lapse.INVALID
