"""Transforms from the bus or from a log into a buffer.

What is refused is counted and said once: one node's broken transform must not blind all listeners.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

from sfglab.component import end_tasks
from sfglab.errors import SfglabError
from sfglab.names import TF, TF_STATIC, prefixed_frame
from sfglab.qos import Durability, QoSProfile
from sfglab.spatial.frames.buffer import (
    ExtrapolationError,
    FrameBuffer,
    NotConnectedError,
    UnknownFrameError,
)
from sfglab.spatial.poses import Pose, StampedTransform

if TYPE_CHECKING:
    from sfglab.bus import Node, Subscription
    from sfglab.record import LogReader


TRANSFORMS = "tf2_msgs/msg/TFMessage"
#: tf2_ros: DynamicListenerQoS, DynamicBroadcasterQoS (tf2_ros/qos.hpp, Humble).
TF_QOS = QoSProfile(depth=100)
TF_STATIC_QOS = QoSProfile(depth=100, durability=Durability.TRANSIENT_LOCAL)
"""tf2_ros: StaticListenerQoS; a broadcaster offers depth 1, or more if it splits its transforms."""

_log = logging.getLogger(__name__)


class TransformIntake:
    """Takes messages into a buffer, and counts what was refused; frames without prefix get the agent's."""

    def __init__(self, buffer: FrameBuffer, *, agent: str = "") -> None:
        self._buffer = buffer
        self._agent = agent
        self._said: set[tuple[str, str]] = set()
        #: How many transforms ended in each way (`Insertion.value`).
        self.taken: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()  #: How many were refused, by the error's name.

    def take(self, message: Any, *, static: bool, authority: str = "") -> None:
        """Take all transforms of a `tf2_msgs/msg/TFMessage`."""
        for transform in message.transforms:
            try:
                value = self._renamed(StampedTransform.from_msg(transform, place="tf"))
                insertion = self._buffer.insert(value, static=static, authority=authority)
            except SfglabError as error:
                self._refuse(str(transform.child_frame_id), error)
            else:
                self.taken[insertion.value] += 1

    def _renamed(self, value: StampedTransform) -> StampedTransform:
        if not self._agent:
            return value
        parent, child = (prefixed_frame(f, self._agent) for f in (value.parent, value.child))
        return replace(value, parent=parent, child=child)

    def _refuse(self, child: str, error: SfglabError) -> None:
        kind = type(error).__name__
        self.refused[kind] += 1
        if (kind, child) not in self._said:
            self._said.add((kind, child))
            _log.warning("transform refused: %s", error)


class FramesListener(TransformIntake):
    """Feeds /tf and /tf_static of a domain into a buffer, as `TransformIntake`, while its context is open.

    ```python
    async with FramesListener(node, buffer):
        pose = await listener.wait_for("map", "go2/base", time_ns)
    ```
    """

    def __init__(self, node: Node, buffer: FrameBuffer, *, agent: str = "") -> None:
        super().__init__(buffer, agent=agent)
        self._node = node
        self._subscriptions: list[Subscription] = []
        self._tasks: list[asyncio.Task[None]] = []
        self._changed = asyncio.Event()

    async def __aenter__(self) -> Self:
        for topic, qos in ((TF_STATIC, TF_STATIC_QOS), (TF, TF_QOS)):
            subscription = self._node.create_subscription(TRANSFORMS, topic, qos=qos)
            self._subscriptions.append(subscription)
            self._tasks.append(
                asyncio.create_task(self._feed(subscription, static=topic == TF_STATIC))
            )
        return self

    async def __aexit__(self, *_: object) -> None:
        await end_tasks(*self._tasks)
        for subscription in self._subscriptions:
            subscription.close()

    async def wait_for(
        self, target: str, source: str, time_ns: int | None = None, *, timeout_s: float = 1.0
    ) -> Pose:
        """Return a pose, as `FrameBuffer.look_up` does, as soon as the transforms for it are there.

        Raises:
            UnknownFrameError: A frame is still unknown at the end.
            NotConnectedError: The frames are still not connected at the end.
            ExtrapolationError: A transform is still missing at the end.
        """
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                while True:
                    self._changed.clear()
                    with suppress(UnknownFrameError, NotConnectedError, ExtrapolationError):
                        return self._buffer.look_up(target, source, time_ns)
                    await self._changed.wait()
        return self._buffer.look_up(target, source, time_ns)

    async def _feed(self, subscription: Subscription, *, static: bool) -> None:
        while True:
            message, info = await subscription.take_with_info()
            self.take(message, static=static, authority=info.publisher_gid.hex())
            self._changed.set()


def fill_from_log(reader: LogReader, buffer: FrameBuffer) -> TransformIntake:
    """Take all transforms of a log, for a whole one into a buffer with ``history_s=None``; return the intake.

    Raises:
        LogError: The log has neither /tf nor /tf_static.
    """
    intake = TransformIntake(buffer)
    for topic in [topic for topic in (TF_STATIC, TF) if topic in reader.topics] or [TF]:
        for recorded in reader.decoded(topic):
            intake.take(recorded.message, static=topic == TF_STATIC)
    return intake
