"""The subscription that users hold, whatever the transport below."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, Protocol

from sfglab.bus.api import MessageInfo
from sfglab.bus.errors import ClosedError, DiscoveryTimeoutError, ReceiveTimeoutError

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from sfglab.bus.bridge import Signal
    from sfglab.bus.core import Core
    from sfglab.bus.inbox import Inbox
    from sfglab.bus.mismatch import MismatchWatch
    from sfglab.bus.queue import Sample


class Reader(Protocol):
    """A transport's incoming side."""

    gid: bytes
    lost: int

    @property
    def matched(self) -> int:
        """How many publishers match now."""

    def close(self) -> None:
        """Release everything."""


class Incoming:
    """A reader and its inbox, which end together.

    Args:
        reader: The transport's side.
        inbox: The loop's side.
        decode: Makes the message of a sample.
        watch: Warns of publishers that do not match.
    """

    def __init__(
        self, reader: Reader, inbox: Inbox, decode: Callable[[Sample], Any], watch: MismatchWatch
    ) -> None:
        self.reader = reader
        self._watch = watch
        self.inbox = inbox
        self.decode = decode

    def close(self) -> None:
        """Release the transport and end whoever waits for messages."""
        self._watch.close()
        self.reader.close()
        self.inbox.close()


class Subscription:
    """One topic's incoming messages, in a queue of its own that its QoS bounds.

    Made by `Node.create_subscription`. Read it by `take`, by `async for` or by a callback.

    Attributes:
        gid: The 16-byte DDS GUID under which others know it.
    """

    def __init__(
        self, node: Any, core: Core, incoming: Incoming, *, topic: tuple[str, str], changed: Signal
    ) -> None:
        self.gid = incoming.reader.gid
        self._node = node  # keeps the node alive for as long as one of its endpoints is held
        self._core = core
        self._incoming = incoming
        self._topic, self._type = topic
        self._changed = changed

    @property
    def topic_name(self) -> str:
        """The fully resolved ROS topic."""
        return self._topic

    @property
    def type_name(self) -> str:
        """The ROS type, e.g. "std_msgs/msg/String"."""
        return self._type

    @property
    def dropped(self) -> int:
        """How many messages the queue's bound pushed out before they were read."""
        return self._incoming.inbox.queue.dropped

    @property
    def lost(self) -> int:
        """How many messages the transport knows to have lost on the way here."""
        return self._incoming.reader.lost

    @property
    def last_error(self) -> BaseException | None:
        """The latest exception of the callback, None if there was none."""
        return self._incoming.inbox.calls.last_error

    async def take(self, timeout_s: float | None = None) -> Any:
        """Return the oldest queued message, waiting for one if there is none.

        Args:
            timeout_s: How long to wait, in seconds; None waits for ever.

        Raises:
            ReceiveTimeoutError: Nothing arrived in time.
            ClosedError: The subscription is closed.
            CdrError: What arrived is no message of the type.
        """
        return self._incoming.decode(await self._sample(timeout_s))

    async def take_with_info(self, timeout_s: float | None = None) -> tuple[Any, MessageInfo]:
        """Return the oldest queued message and what is known about it; see `take`."""
        sample = await self._sample(timeout_s)
        _, source_ns, received_ns, gid = sample
        info = MessageInfo(source_timestamp_ns=source_ns, received_timestamp_ns=received_ns, publisher_gid=gid)
        return self._incoming.decode(sample), info

    async def __aiter__(self) -> AsyncIterator[Any]:
        """Yield messages until the subscription closes."""
        while True:
            try:
                sample = await self._incoming.inbox.get(self._what)
            except ClosedError:
                return
            yield self._incoming.decode(sample)
            del sample  # a shared-memory slot is free again when the caller has let go of the message

    def get_publisher_count(self) -> int:
        """Return how many publishers match now."""
        return self._incoming.reader.matched

    async def wait_for_publishers(self, count: int = 1, timeout_s: float = 5.0) -> None:
        """Return once at least `count` publishers match.

        Raises:
            DiscoveryTimeoutError: Fewer matched within `timeout_s`.
        """
        reader = self._incoming.reader
        if not await self._changed.wait_until(lambda: reader.matched >= count, timeout_s):
            raise DiscoveryTimeoutError(
                f"topic {self._topic!r}: {count} matching publisher(s), found {reader.matched},",
                timeout_s=timeout_s,
            )

    def close(self) -> None:
        """End the subscription; again is harmless."""
        if not self._incoming.inbox.closed and not self._core.closed:
            self._core.disown(self._incoming)
            self._incoming.close()

    @property
    def _what(self) -> str:
        return f"subscription {self._topic!r}"

    async def _sample(self, timeout_s: float | None) -> Sample:
        inbox = self._incoming.inbox
        if timeout_s is None:
            return await inbox.get(self._what)
        try:
            async with asyncio.timeout(timeout_s):
                return await inbox.get(self._what)
        except TimeoutError as error:
            raise ReceiveTimeoutError(
                self._topic, timeout_s=timeout_s, publishers=self._incoming.reader.matched
            ) from error
