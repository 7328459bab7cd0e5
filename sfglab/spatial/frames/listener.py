"""Transforms from the bus or from a log, inserted into a buffer.

Transforms that tf2 would ignore are refused, counted and reported once per frame and reason. One broken
publisher does not keep a listener from receiving the others.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections import Counter
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Self

from sfglab.component import end_tasks
from sfglab.errors import SfglabError
from sfglab.names import TF, TF_STATIC
from sfglab.qos import Durability, QoSProfile
from sfglab.spatial.frames.buffer import FrameBuffer, FrameError, FrameLoopError
from sfglab.spatial.poses import Pose, StampedTransform

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from sfglab.bus import Node, Subscription
    from sfglab.record import LogReader


TRANSFORMS = "tf2_msgs/msg/TFMessage"
#: tf2_ros: DynamicListenerQoS, DynamicBroadcasterQoS (tf2_ros/qos.hpp, Humble).
TF_QOS = QoSProfile(depth=100)
TF_STATIC_QOS = QoSProfile(depth=100, durability=Durability.TRANSIENT_LOCAL)
"""tf2_ros: StaticListenerQoS. A broadcaster offers depth 1, or more if it splits its transforms."""
LOOP = "it would close a loop"  #: Reason of a refused transform that `lint_frames` finds as a loop.
_UNIT_TOLERANCE = 10e-3

_log = logging.getLogger(__name__)


class TransformIntake:
    """Intake that inserts the transforms of messages into a buffer, and counts refused ones."""

    def __init__(self, buffer: FrameBuffer) -> None:
        self._buffer = buffer
        self.taken = 0  #: Number of transforms that were inserted.
        #: Number of transforms that were refused, by parent, child and reason.
        self.refused: Counter[tuple[str, str, str]] = Counter()

    def take(self, message: Any, *, static: bool, authority: str = "") -> None:
        """Insert all transforms of a `tf2_msgs/msg/TFMessage`; an invalid one is counted in `refused` and skipped.

        Args:
            message: The message.
            static: Whether it is from /tf_static.
            authority: Name of its publisher, for error messages.
        """
        for transform in message.transforms:
            try:
                _check_numbers(transform)
                value = StampedTransform.from_msg(transform)
                self._buffer.insert(value, static=static, authority=authority)
                self.taken += 1
            except SfglabError as error:
                why = LOOP if isinstance(error, FrameLoopError) else str(error)
                refused = transform.header.frame_id, transform.child_frame_id, why
                self.refused[refused] += 1
                if self.refused[refused] == 1:
                    _log.warning("transform %r -> %r refused: %s", *refused)


def _check_numbers(transform: Any) -> None:
    """Check that tf2 accepts the numbers of a `geometry_msgs/msg/TransformStamped`.

    The error's text does not contain the numbers, so that a stream of such transforms has one reason.

    Raises:
        FrameError: tf2 ignores the transform because of its numbers.

    Source:
        tf2, buffer_core.cpp, `BufferCore::setTransformImpl` (Humble to Rolling).
    """
    at, q = transform.transform.translation, transform.transform.rotation
    if not math.isfinite(at.x + at.y + at.z):
        raise FrameError("its position is not finite")
    length = math.hypot(q.x, q.y, q.z, q.w)
    if not abs(length * length - 1.0) < _UNIT_TOLERANCE:  # also of NaN
        raise FrameError("the length of its quaternion is not 1 within 0.5 %")


class FramesListener(TransformIntake):
    """A `TransformIntake` of the topics /tf and /tf_static of a domain, while its context is open.

    ```python
    async with FramesListener(node, buffer) as listener:
        pose = await listener.wait_for("map", "go2/base", time_ns)
    ```
    """

    def __init__(self, node: Node, buffer: FrameBuffer) -> None:
        super().__init__(buffer)
        self._node = node
        self._subscriptions: list[Subscription] = []
        self._tasks: list[asyncio.Task[None]] = []
        self._changed = asyncio.Event()

    async def __aenter__(self) -> Self:
        for topic, qos in ((TF_STATIC, TF_STATIC_QOS), (TF, TF_QOS)):
            subscription = self._node.create_subscription(TRANSFORMS, topic, qos=qos)
            self._subscriptions.append(subscription)
            feeding = self._feed(subscription, static=topic == TF_STATIC)
            self._tasks.append(asyncio.create_task(feeding))
        return self

    async def __aexit__(self, *_: object) -> None:
        await end_tasks(*self._tasks)
        for subscription in self._subscriptions:
            subscription.close()

    async def wait_for(
        self, target: str, source: str, time_ns: int | None = None, *, timeout_s: float = 1.0
    ) -> Pose:
        """Return the pose of the source frame in the target frame as soon as the transforms for it are known.

        Args:
            target: Target frame.
            source: Source frame.
            time_ns: Time, ns; None: the latest time at which all transforms are known.
            timeout_s: Longest wait, s.

        Raises:
            UnknownFrameError: A frame is still unknown after the timeout.
            NotConnectedError: The frames are still not connected after the timeout.
            ExtrapolationError: A transform is still missing after the timeout.
        """
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                while True:
                    self._changed.clear()
                    with suppress(FrameError):
                        return self._buffer.look_up(target, source, time_ns)
                    await self._changed.wait()
        return self._buffer.look_up(target, source, time_ns)

    async def _feed(self, subscription: Subscription, *, static: bool) -> None:
        while True:
            message, info = await subscription.take_with_info()
            self.take(message, static=static, authority=info.publisher_gid.hex())
            self._changed.set()


def fill_from_log(reader: LogReader, buffer: FrameBuffer) -> TransformIntake:
    """Insert all transforms on /tf and /tf_static of a log into a buffer, and return the intake.

    A buffer with ``history_s=None`` keeps all transforms.
    """
    intake = TransformIntake(buffer)
    for topic in (TF_STATIC, TF):
        if topic in reader.topics:
            for recorded in reader.decoded(topic):
                intake.take(recorded.message, static=topic == TF_STATIC)
    return intake


def namespaced_topics(types: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the topics with transforms other than /tf and /tf_static, given the types of all topics."""
    found = {topic for topic, names in types.items() if TRANSFORMS in names}
    return sorted(found - {TF, TF_STATIC})
