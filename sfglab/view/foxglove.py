"""Foxglove beside Rerun: a WebSocket server from which its app sees every topic of a domain.

Nothing is decoded or drawn here: bytes go as they are on the wire. A topic is advertised with its definition as
soon as it is in the graph, and read from the bus only while a client looks at it, once for all clients (on
demand, as in A 4.3). The protocol is the vendor's library (`foxglove-sdk`); it serves without a password, on
loopback unless asked.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from sfglab.bus import ClosedError, EndpointAdded, EndpointEvent, EndpointKind, Node
from sfglab.bus.listing import requested
from sfglab.component import end_tasks
from sfglab.errors import MissingExtraError, SfglabError
from sfglab.fleet.decoder.streams import routes_of_topic
from sfglab.fleet.status.heartbeat import heartbeat_topic
from sfglab.messages import definition
from sfglab.qos import Durability, QoSProfile

if TYPE_CHECKING:
    from sfglab.fleet.fleet_file import Fleet

PORT = 8765  #: Where Foxglove's app looks when nothing else is said.

_BACKLOG = 64
"""Messages that wait for a slow client, over all topics; the oldest are dropped. Of 1 MB, that is 64 MB."""

_QOS = QoSProfile(durability=Durability.TRANSIENT_LOCAL)
"""What is asked for where a publisher offers as much, so that the past of latched topics is seen, too."""


def _library() -> Any:
    if find_spec("foxglove") is None:
        raise MissingExtraError("foxglove-sdk", extra="view", purpose="Foxglove")
    import foxglove

    return foxglove


class FoxgloveBridge(contextlib.AbstractAsyncContextManager["FoxgloveBridge"]):
    """Serves a node's domain to Foxglove until closed, as an async context manager.

    Args:
        node: On the domain to look at; it stays open.
        host: Address to bind to; everybody who reaches it sees everything.
        port: Port to bind to; 0 is any free one.
        topics: Only topics with one of these beginnings.

    Raises:
        MissingExtraError: foxglove-sdk is not installed.
        SfglabError: The port is taken.
    """

    def __init__(
        self,
        node: Node,
        *,
        host: str = "127.0.0.1",
        port: int = PORT,
        topics: tuple[str, ...] = ("/",),
    ) -> None:
        foxglove = _library()

        self._node, self._topics = node, topics
        self._context = foxglove.Context()
        self._channels: dict[str, Any] = {}  # by topic
        self._types: dict[str, str] = {}
        self._clients: Counter[str] = Counter()  # how many look at a topic
        self._readers: dict[str, asyncio.Task[None]] = {}
        self._loop = asyncio.get_running_loop()
        self.left_out: dict[str, str] = {}  #: Topics that cannot be shown, and why.
        try:
            self._server = foxglove.start_server(
                name=f"sfglab: {node.name}",
                host=host,
                port=port,
                capabilities=[],
                supported_encodings=["cdr"],
                server_listener=self,
                context=self._context,
                message_backlog_size=_BACKLOG,
            )
        except RuntimeError as error:
            raise SfglabError(
                f"foxglove: given {host}:{port}, needed is an address that is free ({error})"
            ) from error
        self._unlisten = node.graph.listen(self._heard)

    @property
    def port(self) -> int:
        """Port that is bound."""
        return int(self._server.port)

    async def __aexit__(self, *_: object) -> None:
        self._unlisten()
        await end_tasks(*self._readers.values())
        await asyncio.to_thread(self._server.stop)
        for channel in self._channels.values():
            channel.close()

    def _heard(self, event: EndpointEvent) -> None:
        endpoint = event.endpoint
        known = endpoint.topic in self._channels or endpoint.topic in self.left_out
        ours = endpoint.kind is EndpointKind.PUBLISHER and endpoint.dds_topic.startswith("rt/")
        if (
            ours
            and isinstance(event, EndpointAdded)
            and endpoint.topic.startswith(self._topics)
            and not known
        ):
            self._advertise(endpoint.topic, endpoint.type)

    def _advertise(self, topic: str, type_name: str) -> None:
        foxglove = _library()
        try:
            text = definition(type_name)
        except SfglabError as error:
            self.left_out[topic] = str(error)
            return
        schema = foxglove.Schema(name=type_name, encoding="ros2msg", data=text.encode())
        self._types[topic] = type_name
        self._channels[topic] = foxglove.Channel(
            topic, schema=schema, message_encoding="cdr", context=self._context
        )

    # The library calls these in threads of its own.

    def on_subscribe(self, _: object, channel: Any) -> None:
        """Read a topic from now on."""
        self._loop.call_soon_threadsafe(self._looked_at, channel.topic, 1)

    def on_unsubscribe(self, _: object, channel: Any) -> None:
        """Stop reading a topic when nobody looks any more."""
        with contextlib.suppress(RuntimeError):  # the loop has ended before its last client
            self._loop.call_soon_threadsafe(self._looked_at, channel.topic, -1)

    def _looked_at(self, topic: str, change: int) -> None:
        self._clients[topic] += change
        if self._clients[topic] <= 0 and topic in self._readers:
            self._readers.pop(topic).cancel()
        elif self._clients[topic] > 0 and topic not in self._readers:
            self._readers[topic] = self._loop.create_task(self._read(topic))

    async def _read(self, topic: str) -> None:
        type_name, channel = self._types[topic], self._channels[topic]
        offers = [e.qos for e in self._node.graph.publishers(topic) if e.type == type_name]
        try:
            qos = requested(_QOS, offers)
            subscription = self._node.create_subscription(type_name, topic, qos=qos, raw=True)
        except SfglabError as error:
            self.left_out[topic] = str(error)
            return
        with contextlib.closing(subscription), contextlib.suppress(ClosedError):
            while True:
                cdr, info = await subscription.take_with_info()
                channel.log(bytes(cdr), log_time=info.received_timestamp_ns)


def layout_of_fleet(fleet: Fleet, *, frame: str = "map") -> str:
    """Return the layout, as JSON that Foxglove imports, of a fleet: space, each stream's picture, heartbeats.

    Pictures are those that the decoder offers on this device (A 4.3), raw, since the app knows no FFMPEGPacket.
    Raises MissingExtraError without foxglove-sdk.
    """
    _library()
    from foxglove import layouts

    topics = [s.topic for agent in fleet.agents for sensor in agent.sensors for s in sensor.streams]
    pictures = [
        layouts.ImagePanel(
            config=layouts.ImageConfig(image_mode=layouts.ImageModeConfig(image_topic=topic)),
            title=topic,
        )
        for topic in (routes_of_topic(topic)[0].local_topic for topic in topics)
    ]
    space = layouts.ThreeDeePanel(config=layouts.ThreeDeeConfig(follow_tf=frame, fixed_frame=frame))
    beats = layouts.RawMessagesPanel(config=layouts.RawMessagesConfig(topic_path=heartbeat_topic()))
    side = [layouts.SplitItem(content=picture) for picture in pictures] or [
        layouts.SplitItem(content=beats)
    ]
    upper = layouts.SplitContainer(
        items=[
            layouts.SplitItem(proportion=3, content=space),
            layouts.SplitItem(
                proportion=2, content=layouts.SplitContainer(direction="column", items=side)
            ),
        ]
    )
    rows = [layouts.SplitItem(proportion=3, content=upper), layouts.SplitItem(content=beats)]
    return layouts.Layout(content=layouts.SplitContainer(direction="column", items=rows)).to_json()
