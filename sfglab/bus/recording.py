"""Recording of topics of a domain into a log, and playing of a log into a domain.

A separate thread writes and reads files, so that no message waits for a disk.
"""

from __future__ import annotations

import asyncio
import itertools
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import EndpointAdded, EndpointEvent, EndpointInfo, EndpointKind
from sfglab.bus.errors import BusTimeoutError
from sfglab.bus.listing import settled, tells_no_history, usual_qos, view
from sfglab.component import end_tasks
from sfglab.messages import MessageError, UnknownTypeError, register_definition, type_name
from sfglab.names import FqnError
from sfglab.qos import Durability, History, QoSProfile
from sfglab.record import LogError, LogReader, LogWriter
from sfglab.record.traffic import COMPUTATION_GRAPH
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from sfglab.bus.node import Node
    from sfglab.bus.pubsub import Publisher, Subscription
    from sfglab.record.parts import LogMessage

    OnLog = Callable[[str], None]

_BATCH = 256
_LAST_BATCHES = 8
_OTHERS_S = 0.2  #: Time for the publishers of one topic to appear together, s.
#: Least history depth of a played volatile topic; the player waits for its readers after each half of it.
_UNACKNOWLEDGED = 256
#: Time after which a stalled reader is not waited for again, s; a reader that ended is noticed earlier.
_STANDS_STILL_S = 15.0
_MATCH_S = 3.0
_LATE_S = 2.0  #: Time for readers to acknowledge the last samples, s.


class Recorder:
    """Recorder of topics of a domain, each from the time when it appears.

    At the end the recorder writes the publishers and subscribers of each topic into the log.

    Args:
        node: Node in the domain.
        open_log: Function that creates the log; it is called in the thread that writes the log.
        wanted: Whether a topic, given by name, is recorded.
        on_log: Called with sentences for the user.
    """

    def __init__(
        self,
        node: Node,
        open_log: Callable[[], LogWriter],
        *,
        wanted: Callable[[str], bool],
        on_log: OnLog,
    ) -> None:
        self.counts: Counter[str] = Counter()  #: Number of written messages per topic.
        self._node = node
        self._open = open_log
        self._wanted = wanted
        self._on_log = on_log
        self._queue: asyncio.Queue[tuple[Any, ...]] = asyncio.Queue(_BATCH)
        self._topics: dict[str, asyncio.Task[None]] = {}
        self._subscriptions: list[Subscription] = []

    @property
    def lost(self) -> int:
        """Number of messages that the transport lost or the full queue dropped."""
        return sum(one.lost + one.dropped for one in self._subscriptions)

    async def run(self) -> None:
        """Record until cancelled, then write the messages that have arrived and close the log."""
        with ThreadPoolExecutor(1) as thread:
            do = partial(asyncio.get_running_loop().run_in_executor, thread)
            log = await do(self._open)
            self._node.graph.nodes()  # the first call starts the reading of nodes
            unlisten = self._node.graph.listen(self._heard)
            self._on_log("Listening for topics...")
            try:
                while True:
                    batch = [await self._queue.get(), *self._waiting()]
                    await asyncio.shield(do(self._write, log, batch))
            except asyncio.CancelledError:
                for _ in range(_LAST_BATCHES):  # messages that had arrived before the cancellation
                    await do(self._write, log, self._waiting())
                    await asyncio.sleep(0)
                raise
            finally:
                unlisten()
                await end_tasks(*self._topics.values())
                await do(log.write_metadata, COMPUTATION_GRAPH, self._sides())
                await do(log.close)

    def _sides(self) -> dict[str, dict[str, list[str]]]:
        """Return the publishing and subscribing nodes of each recorded topic that has a known publisher."""
        seen, sides = view(self._node), {}
        for topic in self.counts:
            publishers, subscribers = (
                sorted({end.node for end in seen.ends(topic, kind) if end.node})
                for kind in (EndpointKind.PUBLISHER, EndpointKind.SUBSCRIPTION)
            )
            if publishers:
                sides[topic] = {"publishers": publishers, "subscribers": subscribers}
        return sides

    def _heard(self, event: EndpointEvent) -> None:
        end, topic = event.endpoint, event.endpoint.topic
        sends = isinstance(event, EndpointAdded) and end.kind is EndpointKind.PUBLISHER
        is_topic = end.transport == "dds" and topic.startswith("/")
        if sends and is_topic and topic not in self._topics and self._wanted(topic):
            self._topics[topic] = asyncio.ensure_future(self._follow(topic))

    async def _follow(self, topic: str) -> None:
        """Put messages of a topic into the queue; while it is full, they wait in the subscription."""
        await asyncio.sleep(_OTHERS_S)
        publishers = view(self._node).ends(topic, EndpointKind.PUBLISHER)
        if not publishers:
            del self._topics[topic]  # its publishers have left
            return
        kind = publishers[0].type
        try:
            subscription = self._node.create_subscription(
                kind, topic, qos=usual_qos(publishers), raw=True
            )
        except (UnknownTypeError, FqnError) as error:
            self._on_log(f"Topic '{topic}' is not recorded: {error}")
            return
        self._subscriptions.append(subscription)
        self._on_log(f"Subscribed to topic '{topic}'")
        qos = _offered(publishers)
        while True:
            cdr, info = await subscription.take_with_info()
            await self._queue.put(
                (topic, kind, cdr, info.received_timestamp_ns, info.source_timestamp_ns, qos)
            )

    def _waiting(self) -> list[tuple[Any, ...]]:
        return [self._queue.get_nowait() for _ in range(self._queue.qsize())]

    def _write(self, log: LogWriter, messages: Iterable[tuple[Any, ...]]) -> None:
        for topic, type_, cdr, received_ns, sent_ns, qos in messages:
            times = {"log_time_ns": received_ns, "publish_time_ns": max(sent_ns, 0)}
            log.write_raw(topic, type_, cdr, qos=qos, **times)
            self.counts[topic] += 1


def _offered(publishers: list[EndpointInfo]) -> QoSProfile:
    """Return a topic's QoS for a log, with the default depth for Fast DDS, which does not announce it."""
    first = publishers[0]
    if tells_no_history(first):
        return replace(first.qos, history=History.KEEP_LAST, depth=QoSProfile().depth)
    return first.qos


@dataclass(frozen=True, slots=True, kw_only=True)
class Playing:
    """Options of playing a log."""

    rate: float = 1.0  #: Speed, as a multiple of the recorded speed.
    start_s: float = 0.0  #: Start of the played part, s after the log's first message.
    #: Length of the played part, s of the recording; None for the rest of the log.
    duration_s: float | None = None


class Player:
    """Player of topics of a log at the recorded pace, once subscriptions match.

    Args:
        node: Node in the domain.
        path: MCAP file or bag.
        how: Options of playing.
        wanted: Whether a topic, given by name, is played.
        on_log: Called with sentences for the user.
    """

    def __init__(
        self, node: Node, path: Path, how: Playing, *, wanted: Callable[[str], bool], on_log: OnLog
    ) -> None:
        self.counts: Counter[str] = Counter()  #: Number of played messages per topic.
        self._node = node
        self._path = path
        self._how = how
        self._wanted = wanted
        self._on_log = on_log
        self._publishers: dict[str, Publisher] = {}
        self._left_behind: set[str] = set()

    async def run(self) -> None:
        """Play to the end, and wait for the acknowledgements of all reliable subscriptions.

        Raises:
            LogError: The log cannot be read.
        """
        with ThreadPoolExecutor(1) as thread:
            do = partial(asyncio.get_running_loop().run_in_executor, thread)
            reader = await do(LogReader, self._path)
            try:
                chosen = list(filter(self._wanted, reader.topics))
                if reader.topics and not chosen:
                    there = ", ".join(reader.topics)
                    raise LogError(f"log {self._path}: no topic is selected; it has {there}")
                for topic in chosen:
                    self._open(topic, reader)
                await self._matched()
                await self._play(reader, do)
                for publisher in self._publishers.values():
                    await publisher.wait_for_all_acked(_LATE_S)
            finally:
                await do(reader.close)

    def _open(self, topic: str, reader: LogReader) -> None:
        name, qos = reader.topics[topic].type_name, reader.offered_qos(topic)
        if qos.durability is Durability.VOLATILE and qos.history is History.KEEP_LAST:
            qos = replace(qos, depth=max(qos.depth, _UNACKNOWLEDGED))
        try:
            text = reader.topics[topic].definition
            if text:
                register_definition(name, text)
            self._publishers[topic] = self._node.create_publisher(type_name(name), topic, qos)
        except (MessageError, UnknownTypeError, FqnError) as error:
            self._on_log(f"Topic '{topic}' is not played: {error}")

    async def _matched(self) -> None:
        """Wait until existing subscriptions are discovered and matched."""
        seen = await settled(self._node)
        for topic, publisher in self._publishers.items():
            ends = seen.ends(topic, EndpointKind.SUBSCRIPTION)
            count = sum(end.transport == "dds" for end in ends)
            with suppress(BusTimeoutError):
                await publisher.wait_for_subscriptions(count, _MATCH_S)

    async def _play(self, reader: LogReader, do: Callable[..., Any]) -> None:
        begin_ns = reader.span_ns[0] + round(self._how.start_s * NS_PER_S)
        more_s = self._how.duration_s
        end_ns = None if more_s is None else begin_ns + round(more_s * NS_PER_S)
        messages = reader.messages(start_ns=begin_ns, end_ns=end_ns)
        loop = self._node.backend.loop
        start_s = loop.time()
        batch: list[LogMessage] = await do(_next, messages)
        while batch:
            later = asyncio.ensure_future(do(_next, messages))
            for message in batch:
                if publisher := self._publishers.get(message.topic):
                    due_s = start_s + (message.log_time_ns - begin_ns) / NS_PER_S / self._how.rate
                    if (wait_s := due_s - loop.time()) > 0:
                        await asyncio.sleep(wait_s)
                    publisher.publish_raw(message.cdr)
                    self.counts[message.topic] += 1
                    await self._wait_for_slow_readers(message.topic, publisher)
            batch = await later

    async def _wait_for_slow_readers(self, topic: str, publisher: Publisher) -> None:
        """Wait for readers slower than the log, before an unacknowledged sample is overwritten."""
        if self.counts[topic] % (_UNACKNOWLEDGED // 2) or topic in self._left_behind:
            return
        if not await publisher.wait_for_all_acked(_STANDS_STILL_S):
            self._left_behind.add(topic)
            self._on_log(
                f"Topic '{topic}': a subscription stands still, and is not waited for any more"
            )


def _next(messages: Iterable[LogMessage]) -> list[LogMessage]:
    return list(itertools.islice(messages, _BATCH))
