"""The publisher that users hold, whatever the transport below."""

from __future__ import annotations

import asyncio
import copy
from typing import TYPE_CHECKING, Any, Protocol

from sfglab.bus.errors import ClosedError, DiscoveryTimeoutError, WrongTypeError

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from sfglab.bus.bridge import Signal
    from sfglab.bus.core import Core


class Writer(Protocol):
    """A transport's outgoing side."""

    gid: bytes

    @property
    def matched(self) -> int:
        """How many subscriptions match now."""

    def write(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Send serialized bytes."""

    def write_message(self, message: Any) -> None:
        """Serialize and send."""

    def wait_for_acks(self, timeout_s: float) -> bool:
        """Block until reliable readers have everything."""

    def close(self) -> None:
        """Release everything."""


def checked_type(message: Any, *, type_: str, where: str) -> None:
    """Refuse a message of another type.

    Raises:
        WrongTypeError: It is of another type, or no message at all.
    """
    given = getattr(message, "__msgtype__", None)
    if given != type_:
        raise WrongTypeError(where, type_, given=given or type(message).__name__)


class Publisher:
    """One topic's outgoing messages; made by `Node.create_publisher`.

    Attributes:
        gid: The 16-byte DDS GUID under which others know it.
    """

    def __init__(
        self, node: Any, core: Core, writer: Writer, *, topic: tuple[str, str], changed: Signal
    ) -> None:
        self.gid = writer.gid
        self._node = node  # keeps the node alive for as long as one of its endpoints is held
        self._core = core
        self._writer = writer
        self._topic, self._type = topic
        self._changed = changed
        self._closed = False

    def without_node(self) -> Publisher:
        """Return this publisher as something that the node itself may run with: it keeps no node alive."""
        twin = copy.copy(self)
        vars(twin)["_node"] = None
        return twin

    @property
    def topic_name(self) -> str:
        """The fully resolved ROS topic."""
        return self._topic

    @property
    def type_name(self) -> str:
        """The ROS type, e.g. "std_msgs/msg/String"."""
        return self._type

    def publish(self, message: Any) -> None:
        """Serialize and send one message.

        Args:
            message: A message of the topic's type.

        Raises:
            WrongTypeError: It is of another type.
            PublishError: The transport could not send it.
            ClosedError: The publisher is closed.
        """
        self._check_open()
        checked_type(message, type_=self._type, where=self._topic)
        self._writer.write_message(message)

    def publish_raw(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Send one message that is already CDR, its 4-byte header included.

        Args:
            cdr: Any contiguous buffer.
            source_timestamp_ns: Unix time in nanoseconds to stamp it with; None is now.

        Raises:
            InvalidMessageError: The bytes are no message of the topic's type (DDS only; shared memory does
                not look into them).
            PublishError: The transport could not send it.
            ClosedError: The publisher is closed.
        """
        self._check_open()
        self._writer.write(cdr, source_timestamp_ns)

    def loan(self, size_bytes: int) -> AbstractContextManager[memoryview]:
        """Return a context with memory to write a message's CDR into; leaving it publishes the message.

        Shared memory only, where it saves the publisher's only copy. Leaving by an exception publishes
        nothing.

        Args:
            size_bytes: The length of the CDR, its header included.

        Raises:
            ClosedError: The publisher is closed.
            MessageTooLargeError: Above the publisher's limit.
            TypeError: The transport has no memory to lend.
        """
        self._check_open()
        loan = getattr(self._writer, "loan", None)
        if loan is None:
            raise TypeError(f"topic {self._topic!r}: only a publisher with transport='shm' lends memory")
        context: AbstractContextManager[memoryview] = loan(size_bytes)
        return context

    def get_subscription_count(self) -> int:
        """Return how many subscriptions match now."""
        return self._writer.matched

    async def wait_for_subscriptions(self, count: int = 1, timeout_s: float = 5.0) -> None:
        """Return once at least `count` subscriptions match.

        Raises:
            DiscoveryTimeoutError: Fewer matched within `timeout_s`.
        """
        if not await self._changed.wait_until(lambda: self._writer.matched >= count, timeout_s):
            raise DiscoveryTimeoutError(
                f"topic {self._topic!r}: {count} matching subscription(s), found {self._writer.matched},",
                timeout_s=timeout_s,
            )

    async def wait_for_all_acked(self, timeout_s: float = 5.0) -> bool:
        """Return True once all reliable subscriptions have acknowledged everything, False after `timeout_s`."""
        loop = self._core.loop
        deadline_s = loop.time() + timeout_s
        while not self._writer.wait_for_acks(0.0):
            if loop.time() >= deadline_s:
                return False
            await asyncio.sleep(0.001)  # the C call can only poll or block
        return True

    def close(self) -> None:
        """End the publisher; again is harmless."""
        if not self._closed and not self._core.closed:
            self._core.disown(self._writer)
            self._writer.close()
        self._closed = True

    def _check_open(self) -> None:
        if self._closed or self._core.closed:
            raise ClosedError(f"publisher {self._topic!r}")
