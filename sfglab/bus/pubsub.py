"""Publishers and subscriptions as users hold them, over any backend."""

from __future__ import annotations

import asyncio
import logging
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from sfglab import names
from sfglab.bus.api import EndpointAdded, EndpointKind, MessageInfo, RawEndpoint
from sfglab.bus.endpoints import Endpoint, Inbox, Sample, ThreadInbox
from sfglab.bus.errors import (
    BusTimeoutError,
    ClosedError,
    InvalidMessageError,
    discovery_timeout_error,
)
from sfglab.bus.loop import Signal
from sfglab.messages import decoder, message_type, type_name
from sfglab.qos import QoSProfile, incompatibilities

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from contextlib import AbstractContextManager

    from sfglab.bus.api import Callback, EndpointEvent, EndpointInfo, MessageType
    from sfglab.bus.backend import Backend

_log = logging.getLogger("sfglab.bus")
_ACK_S = 0.01  #: Interval at which acknowledgements are checked, s.


def topic_endpoint(
    type_: MessageType, topic: str, qos: QoSProfile | int, **options: Any
) -> RawEndpoint:
    """Return the endpoint of a topic by its resolved name; a number is the depth of a default profile."""
    profile = QoSProfile(depth=qos) if isinstance(qos, int) else qos
    return RawEndpoint(
        dds_topic=names.dds_topic(topic), type=type_name(type_), qos=profile, name=topic, **options
    )


def checked_type(message: Any, *, type_: str, where: str) -> None:
    """Check the type of a message.

    Raises:
        InvalidMessageError: The value has another type, or is no message.
    """
    given = getattr(message, "__msgtype__", None)
    if given != type_:
        raise InvalidMessageError(
            f"{where!r}: given a {given or type(message).__name__}, allowed: {type_}"
        )


class TopicEnd:
    """User's handle of a publisher or subscription; the handle does not keep its node alive."""

    def __init__(self, backend: Backend, endpoint: RawEndpoint) -> None:
        self._backend = backend
        self.topic_name = endpoint.name  #: Fully resolved ROS topic.
        self.type_name = endpoint.type  #: ROS type, such as "std_msgs/msg/String".
        self._changed = Signal(backend.loop)

    async def _wait_for(self, end: Endpoint, count: int, peers: str, timeout_s: float) -> None:
        if not await self._changed.wait_until(lambda: end.matched >= count, timeout_s):
            what = f"topic {self.topic_name!r}: {count} matching {peers}(s) ({end.matched} found)"
            raise discovery_timeout_error(what, timeout_s)


class Publisher(TopicEnd):
    """Publisher of one topic; made by `Node.create_publisher`."""

    def __init__(self, backend: Backend, endpoint: RawEndpoint) -> None:
        super().__init__(backend, endpoint)
        self._writer = backend.open_writer(endpoint, self._changed.notify)
        self._closed = False
        self.gid = self._writer.gid  #: 16-byte DDS GUID, as other nodes discover it.
        backend.register(self._writer.close)

    def publish(self, message: Any) -> None:
        """Serialize and send one message.

        Raises:
            InvalidMessageError: The message has another type, or is too large for shared memory.
            PublishError: The transport could not send it.
            ClosedError: The publisher is closed.
        """
        self._check_open()
        checked_type(message, type_=self.type_name, where=self.topic_name)
        self._writer.write_message(message)

    def publish_raw(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Send CDR with its 4-byte header from any contiguous buffer, stamped with a Unix time (ns) or now.

        Raises:
            InvalidMessageError: The CDR is no message of the topic's type, which shared memory does not
                check, or it is too large.
            PublishError: The transport could not send it.
            ClosedError: The publisher is closed.
        """
        self._check_open()
        self._writer.write(cdr, source_timestamp_ns)

    def loan(self, size_bytes: int) -> AbstractContextManager[memoryview]:
        """Return a context with `size_bytes` of shared memory for a message's CDR and its header.

        The end of the context publishes the message; after an exception nothing is published.

        Raises:
            ClosedError: The publisher is closed.
            InvalidMessageError: The size is above the publisher's limit.
            TypeError: The transport has no memory to lend.
        """
        self._check_open()
        lend: Callable[[int], AbstractContextManager[memoryview]] | None = getattr(
            self._writer, "loan", None
        )
        if lend is None:
            said = "only a live publisher lends memory; create it with transport='shm'"
            raise TypeError(f"topic {self.topic_name!r}: {said}")
        return lend(size_bytes)

    def get_subscription_count(self) -> int:
        """Return the number of matching subscriptions."""
        return self._writer.matched

    async def wait_for_subscriptions(self, count: int = 1, timeout_s: float = 5.0) -> None:
        """Return once at least `count` subscriptions match.

        Raises:
            BusTimeoutError: Fewer matched within `timeout_s`.
        """
        await self._wait_for(self._writer, count, "subscription", timeout_s)

    async def wait_for_all_acked(self, timeout_s: float = 5.0) -> bool:
        """Return True once all reliable subscriptions have acknowledged all messages, False after the time-out.

        Over shared memory the result is True at once.
        """
        asked: Callable[[], bool] = getattr(self._writer, "acknowledged", lambda: True)
        for _ in range(round(timeout_s / _ACK_S)):
            if asked():
                break
            await asyncio.sleep(_ACK_S)
        return asked()

    def close(self) -> None:
        """Close the publisher; repeated calls are harmless."""
        self._backend.end(self._writer.close)
        self._closed = True

    def _check_open(self) -> None:
        if self._closed or self._backend.closed:
            raise ClosedError(f"publisher {self.topic_name!r}")


class Subscription(TopicEnd):
    """Subscription of one topic, bounded by its QoS, for `take`, `async for` or a callback."""

    def __init__(
        self,
        backend: Backend,
        endpoint: RawEndpoint,
        callback: Callback | None,
        *,
        raw: bool,
    ) -> None:
        super().__init__(backend, endpoint)
        self._decode = itemgetter(0) if raw else _decoding(endpoint.type)
        calls = backend.calls(self._what)
        kind = ThreadInbox if endpoint.threaded else Inbox
        self._inbox = kind(
            backend.bridge, endpoint.qos, decode=self._decode, callback=callback, calls=calls
        )
        self._reader = backend.open_reader(endpoint, self._changed.notify, self._inbox)
        self.gid = self._reader.gid  #: 16-byte DDS GUID, as other nodes discover it.
        warnings = _Warnings(backend, endpoint)
        self._unwatch = backend.graph.watch(
            endpoint.dds_topic, EndpointKind.PUBLISHER, warnings.hear
        )
        backend.register(self._end)

    @property
    def dropped(self) -> int:
        """Number of messages that the full queue dropped before they were read."""
        return self._inbox.queue.dropped

    @property
    def lost(self) -> int:
        """Number of messages that the transport knows to be lost."""
        return self._reader.lost

    async def take(self, timeout_s: float | None = None) -> Any:
        """Return the oldest queued message; wait for one if there is none, without a time-out indefinitely.

        Raises:
            BusTimeoutError: Nothing arrived in time.
            ClosedError: The subscription is closed.
            CdrError: The received CDR is no message of the type.
        """
        return self._decode(await self._sample(timeout_s))

    async def take_with_info(self, timeout_s: float | None = None) -> tuple[Any, MessageInfo]:
        """Return the oldest queued message and its metadata; see `take`."""
        sample = await self._sample(timeout_s)
        _, source_ns, received_ns, gid = sample
        info = MessageInfo(
            source_timestamp_ns=source_ns, received_timestamp_ns=received_ns, publisher_gid=gid
        )
        return self._decode(sample), info

    async def __aiter__(self) -> AsyncIterator[Any]:
        """Yield messages until the subscription closes."""
        while True:
            try:
                sample = await self._inbox.get(self._what)
            except ClosedError:
                return
            yield self._decode(sample)
            del sample  # a shared-memory slot is freed when the caller drops the message

    def get_publisher_count(self) -> int:
        """Return the number of matching publishers."""
        return self._reader.matched

    async def wait_for_publishers(self, count: int = 1, timeout_s: float = 5.0) -> None:
        """Return once at least `count` publishers match.

        Raises:
            BusTimeoutError: Fewer matched within `timeout_s`.
        """
        await self._wait_for(self._reader, count, "publisher", timeout_s)

    def close(self) -> None:
        """Close the subscription; repeated calls are harmless."""
        self._backend.end(self._end)

    def _end(self) -> None:
        self._unwatch()
        self._reader.close()
        self._inbox.close()

    @property
    def _what(self) -> str:
        return f"subscription {self.topic_name!r}"

    async def _sample(self, timeout_s: float | None) -> Sample:
        if timeout_s is None:
            return await self._inbox.get(self._what)
        try:
            async with asyncio.timeout(timeout_s):
                return await self._inbox.get(self._what)
        except TimeoutError as error:
            said = (
                f"no message within {timeout_s} s from {self._reader.matched} matching publisher(s)"
            )
            said += "; check that its name, type and QoS match and that it is published"
            raise BusTimeoutError(f"topic {self.topic_name!r}: {said}") from error


def _decoding(type_: str) -> Callable[[Sample], Any]:
    message_type(type_)  # an unknown type raises before a message arrives
    decode = decoder(type_)
    return lambda sample: decode(sample[0])


_NAME_S = 10.0  # longest wait for the name of a publisher's node, s


class _Warnings:
    """Logger that warns once of each publisher that can never reach a subscription, as ROS 2 does."""

    def __init__(self, backend: Backend, wanted: RawEndpoint) -> None:
        self._backend = backend
        self._wanted = wanted
        self._suspects: dict[bytes, EndpointInfo | None] = {}  # None: the warning was logged

    def hear(self, event: EndpointEvent) -> None:
        publisher = event.endpoint
        if not isinstance(event, EndpointAdded):
            self._suspects.pop(publisher.gid, None)
        elif _mismatches(publisher, self._wanted) and self._suspects.get(publisher.gid, publisher):
            self._suspects[publisher.gid] = publisher
            if publisher.node:
                self._say(publisher.gid)
            else:
                self._backend.graph.nodes()
                self._backend.loop.call_later(_NAME_S, self._say, publisher.gid)

    def _say(self, gid: bytes) -> None:
        if self._backend.closed or (publisher := self._suspects.get(gid)) is None:
            return
        self._suspects[gid] = None
        who = f"node {publisher.node!r}" if publisher.node else "another process"
        reasons = "; ".join(_mismatches(publisher, self._wanted))
        said = "topic %r: nothing will arrive from a publisher of %s: %s"
        _log.warning(said, self._wanted.name, who, reasons)


def _mismatches(publisher: EndpointInfo, wanted: RawEndpoint) -> tuple[str, ...]:
    if publisher.transport != wanted.transport:
        return ()  # endpoints of different transports do not match on purpose
    if publisher.type != wanted.type:
        return (f"type: the reader wants {wanted.type}, the writer has {publisher.type}",)
    return incompatibilities(offered=publisher.qos, requested=wanted.qos)
