"""Test peer that publishes, subscribes, serves and calls: ``python -m sfglab.lab.workers.test_peer CONFIG``.

Publishes on all topics that it is given, once or at a rate, and keeps count of what arrives from whom: how
often, in which order, with which time stamp. Sees every endpoint of its domain. Orders and reports are JSON
lines; see `_TestPeer.obey`.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

from sfglab.bus import Node, Service, Subscription
from sfglab.bus.address import BusAddress
from sfglab.bus.api import EndpointAdded, MessageInfo
from sfglab.bus.errors import BusError
from sfglab.component import Orders, Report, Reporter, end_tasks, run_component
from sfglab.messages import (
    default_message,
    message_type,
    ns_from_stamp,
    serialize,
    service_type,
    stamp_from_ns,
)
from sfglab.names import TF_STATIC
from sfglab.qos import LATCHED, QoSProfile


@dataclass(slots=True)
class ReceiveStatistics:
    """What arrived of one source under one name."""

    numbers: set[int] = field(default_factory=set)  #: Numbers that arrived.
    received: int = 0  #: Messages, repeated ones counted again.
    repeated: int = 0  #: Messages whose number had arrived before.
    disordered: int = 0  #: Messages that arrived after a later number.
    restamped: int = 0  #: Messages whose source time stamp is not the publisher's.
    #: Transforms without their source's prefix, or with one that they must not have.
    misnamed: int = 0
    ages_ns: list[int] = field(default_factory=list)  #: From publishing to receiving.

    def note(self, number: int, stamp_ns: int, info: MessageInfo) -> None:
        """Count one message."""
        self.received += 1
        self.repeated += number in self.numbers
        self.disordered += bool(self.numbers) and number < max(self.numbers)
        self.restamped += info.source_timestamp_ns != stamp_ns
        self.numbers.add(number)
        self.ages_ns.append(info.received_timestamp_ns - stamp_ns)

    def report(self) -> dict[str, Any]:
        """Return the counts as JSON values."""
        span = max(self.numbers) - min(self.numbers) + 1 if self.numbers else 0
        ages = sorted(self.ages_ns)
        return {
            "received": self.received,
            "repeated": self.repeated,
            "disordered": self.disordered,
            "restamped": self.restamped,
            "missing": span - len(self.numbers),
            "misnamed": self.misnamed,
            "age_ns": ages[len(ages) // 2] if ages else None,
        }


TRANSFORMS = "tf2_msgs/msg/TFMessage"
SERVICE = "sfglab_interfaces/srv/GetMetadata"
QUIET_S = 0.3  #: Nothing more is on its way when nothing has arrived for this long.

VOLATILE = QoSProfile(depth=200)
LATE = QoSProfile(depth=100, durability=LATCHED.durability)
"""Of whoever wants the last message of each of many publishers, as tf2's listeners do."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicUse:
    """One topic and what the peer does with it."""

    name: str  #: ROS name.
    type: str  #: ROS type.
    latched: bool  #: Published once, transient local.
    publish: bool  #: Whether it publishes.
    subscribe: bool  #: Whether it subscribes.

    @property
    def qos(self) -> QoSProfile:
        """Of its endpoints."""
        return LATCHED if self.latched else VOLATILE


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerConfig:
    """What a peer is told when it starts."""

    party: str  #: Its name.
    address: BusAddress  #: Where on the bus it stands.
    #: Whether its transforms get its prefix from a router; else it writes it itself.
    behind_router: bool
    topics: tuple[TopicUse, ...]  #: What it does.
    serves: tuple[str, ...]  #: Services that it answers.
    rate_hz: float  #: Messages a second on every topic that is not latched.


class _TestPeer:
    """A test peer on its node."""

    def __init__(self, node: Node, config: PeerConfig, report: Reporter) -> None:
        self._node, self._config, self._report = node, config, report
        self._heard: dict[tuple[str, str], ReceiveStatistics] = defaultdict(ReceiveStatistics)
        self._last_s = 0.0
        self._endpoints: set[tuple[str, str, str, str]] = set()
        self._sent = 0
        self._tasks: list[asyncio.Task[None]] = []
        self._services: list[Service] = []
        self._talking: asyncio.Task[None] | None = None
        own = [topic for topic in config.topics if topic.publish]
        self._publishers = {
            topic: node.create_publisher(topic.type, topic.name, topic.qos) for topic in own
        }

    async def serve(self, orders: Orders) -> None:
        """Listen, report ``ready``, and follow orders until cancelled."""
        try:
            self._begin()
            self._report({"is": "ready"})
            while True:
                await self.obey(await orders.get())
        finally:
            await end_tasks(*self._tasks)

    def _begin(self) -> None:
        self._spawn(self._watch())
        for topic in self._config.topics:
            if topic.subscribe:
                qos = LATE if topic.latched else topic.qos
                subscription = self._node.create_subscription(topic.type, topic.name, qos=qos)
                self._spawn(self._listen(subscription, topic.name))
        for name in self._config.serves:
            self._services.append(self._node.create_service(SERVICE, name, self._answer))
        self._publish(latched=True)

    async def obey(self, order: Report) -> None:
        """Follow one order: ``talk``, ``hush``, ``late``, ``call`` or ``tell``."""
        match order["do"]:
            case "talk":
                self._talking = self._spawn(self._talk())
            case "hush":
                assert self._talking is not None
                self._talking.cancel()
                await self._quiet()
                self._report({"is": "hushed", "sent": self._sent})
            case "late":
                counts = await self._come_late(order["expected"], order["timeout_s"])
                self._report({"is": "late", "received": counts})
            case "call":
                answers = await asyncio.gather(
                    *(self._call(n, order["timeout_s"]) for n in order["names"])
                )
                self._report({"is": "called", "answers": answers})
            case "tell":
                self._report(self._told())

    def _spawn(self, coroutine: Any) -> asyncio.Task[None]:
        task = asyncio.create_task(coroutine)
        self._tasks.append(task)
        return task

    async def _watch(self) -> None:
        async for event in self._node.graph.events():
            if isinstance(event, EndpointAdded):
                end = event.endpoint
                owner, tag = end.participant.hex(), end.user_data.decode(errors="replace")
                self._endpoints.add((end.dds_topic, end.kind.value, owner, tag))

    async def _talk(self) -> None:
        while True:
            self._sent += 1
            self._publish(latched=False)
            await asyncio.sleep(1 / self._config.rate_hz)

    def _publish(self, *, latched: bool) -> None:
        for topic, publisher in self._publishers.items():
            if topic.latched is latched:
                stamp_ns = time.time_ns()
                message = self._message(topic, self._sent, stamp_ns)
                publisher.publish_raw(serialize(message), source_timestamp_ns=stamp_ns)

    def _message(self, topic: TopicUse, number: int, stamp_ns: int) -> Any:
        party = self._config.party
        if topic.type != TRANSFORMS:
            return message_type(topic.type)(data=f"{party} {number} {stamp_ns}")
        stamped = default_message("geometry_msgs/msg/TransformStamped")
        stamped.header.stamp, stamped.header.frame_id = stamp_from_ns(stamp_ns), "map"
        stamped.child_frame_id = "probe" if self._config.behind_router else f"{party}/probe"
        stamped.transform.translation.x, stamped.transform.rotation.w = float(number), 1.0
        return message_type(TRANSFORMS)(transforms=[stamped])

    async def _listen(self, subscription: Subscription, name: str) -> None:
        while True:
            message, info = await subscription.take_with_info()
            self._last_s = time.monotonic()
            source, number, stamp_ns, named = self._read(message)
            tally = self._heard[name, source]
            tally.note(number, stamp_ns, info)
            tally.misnamed += not named

    def _read(self, message: Any) -> tuple[str, int, int, bool]:
        """Return source, number and stamp of a message, and whether a transform bears the right frame."""
        if not hasattr(message, "transforms"):
            source, number, stamp = message.data.split()
            return source, int(number), int(stamp), True
        transform = message.transforms[0]
        owner, slash, frame = transform.child_frame_id.partition("/")
        source = owner if slash else self._config.party
        stamp_ns = ns_from_stamp(transform.header.stamp)
        named = bool(slash) is not (self._config.behind_router and source == self._config.party)
        named = named and transform.header.frame_id == "map" and frame in {"probe", ""}
        return source, int(transform.transform.translation.x), stamp_ns, named

    async def _quiet(self) -> None:
        """Return when nothing has arrived for a while."""
        while (left_s := self._last_s + QUIET_S - time.monotonic()) > 0:  # noqa: ASYNC110 - quiet is no event
            await asyncio.sleep(left_s)

    async def _come_late(self, expected: int, timeout_s: float) -> dict[str, int]:
        """Subscribe static transforms anew and return how many came from whom."""
        counts: dict[str, int] = defaultdict(int)
        subscription = self._node.create_subscription(TRANSFORMS, TF_STATIC, qos=LATE)
        deadline_s = time.monotonic() + timeout_s
        with contextlib.suppress(BusError, TimeoutError):
            while (left_s := deadline_s - time.monotonic()) > 0:
                message = await subscription.take(timeout_s=left_s)
                counts[self._read(message)[0]] += 1
                if len(counts) == expected:  # then only what comes too much is waited for
                    deadline_s = min(deadline_s, time.monotonic() + QUIET_S)
        subscription.close()
        return counts

    async def _call(self, name: str, timeout_s: float) -> str:
        """Return who answered a call, empty when nobody did in time."""
        client = self._node.create_client(SERVICE, name)
        try:
            await client.wait_for_service(timeout_s=timeout_s)
            answer = await client.call(
                service_type(SERVICE).request(), timeout_s=max(timeout_s, 5.0)
            )
        except BusError:
            return ""
        finally:
            client.close()
        return str(answer.message)

    def _answer(self, _request: Any) -> Any:
        metadata = default_message("sfglab_interfaces/msg/AgentMetadata")
        return service_type(SERVICE).response(
            success=True, message=self._config.party, metadata=metadata
        )

    def _told(self) -> Report:
        heard = [
            {"name": n, "source": s, **tally.report()}
            for (n, s), tally in sorted(self._heard.items())
        ]
        participant = self._node.guid.hex()
        return {
            "is": "told",
            "heard": heard,
            "endpoints": sorted(self._endpoints),
            "participant": participant,
        }


async def serve(config: PeerConfig, report: Reporter, orders: Orders) -> None:
    """Be the process."""
    async with Node(config.party, **config.address.options()) as node:
        await _TestPeer(node, config, report).serve(orders)


if __name__ == "__main__":
    run_component(PeerConfig, serve)
