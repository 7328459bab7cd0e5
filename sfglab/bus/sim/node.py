"""The simulated node: the bus's interface in a world of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Self, cast

from sfglab import names
from sfglab.bus.actions import ActionClient, ActionServer
from sfglab.bus.bridge import Signal
from sfglab.bus.clock import Timer
from sfglab.bus.errors import ClosedError
from sfglab.bus.inbox import Inbox
from sfglab.bus.publisher import Publisher
from sfglab.bus.queue import Sample, SampleQueue
from sfglab.bus.service import Client, Service
from sfglab.bus.sim.core import SimCore
from sfglab.bus.sim.loop import START_NS
from sfglab.bus.sim.raw import SimInlet, SimOutlet
from sfglab.bus.subscription import Incoming, Subscription
from sfglab.bus.transports import DEFAULT_MAX_MESSAGE_BYTES, Target, check_transport
from sfglab.messages import message_type, type_name
from sfglab.qos import DEFAULT, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable
    from typing import Unpack

    from sfglab.bus.actions import ActionServerOptions
    from sfglab.bus.actions.engine import ExecuteCallback
    from sfglab.bus.api import Callback, Handler, MessageType, Transport
    from sfglab.bus.calls import OnError
    from sfglab.bus.core import Core
    from sfglab.bus.forwarding import RawEndpoint, Sink
    from sfglab.bus.sim.graph import SimGraph
    from sfglab.bus.sim.loop import VirtualLoop
    from sfglab.bus.sim.participant import Participant


class SimClock:
    """The time of a simulated world.

    Args:
        loop: The world's loop.
    """

    def __init__(self, loop: VirtualLoop) -> None:
        self._loop = loop

    def now_ns(self) -> int:
        """Return the current virtual time, in nanoseconds since the Unix epoch."""
        return START_NS + self._loop.now_ns

    async def sleep_for(self, duration_s: float) -> None:
        """Return after `duration_s` virtual seconds."""
        import asyncio

        await asyncio.sleep(duration_s)


class SimNode:
    """A participant in the computation graph of a simulated world; made by `World.node`, already started.

    Use it as a live node, in `async with` too. Messages that several subscriptions receive are one object, so
    treat them as read only.

    Args:
        participant: Its place in its domain.
        name: Its name.
        namespace: Where relative topic names live.
        on_error: Called with every exception of a callback and a text that names its place; None logs it.
    """

    def __init__(
        self, participant: Participant, name: str, *, namespace: str, on_error: OnError | None
    ) -> None:
        self._name = name
        self._namespace = namespace
        self._clock = SimClock(participant.domain.world.loop)
        self._sim = SimCore(participant, on_error)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    @property
    def name(self) -> str:
        """The node's name, without its namespace."""
        return self._name

    @property
    def namespace(self) -> str:
        """The node's namespace."""
        return self._namespace

    @property
    def graph(self) -> SimGraph:
        """What the node knows about the domain's endpoints."""
        return self._core.graph

    @property
    def guid(self) -> bytes:
        """The 16-byte GUID of the node's participant."""
        return self._core.participant.guid

    def get_clock(self) -> SimClock:
        """Return the world's clock."""
        return self._clock

    def create_publisher(
        self,
        type_: MessageType,
        topic: str,
        qos: QoSProfile | int = DEFAULT,
        *,
        transport: Transport = "dds",
        max_message_bytes: int = DEFAULT_MAX_MESSAGE_BYTES,
    ) -> Publisher:
        """Create a publisher; see `sfglab.bus.Node.create_publisher`."""
        core = self._core
        check_transport(transport)
        target = self._target(type_, topic, qos)
        changed = Signal(core.loop)
        writer = core.open_writer(target, transport, notify=changed.notify, max_message_bytes=max_message_bytes)
        core.own(writer)
        return Publisher(self, cast("Core", core), writer, topic=(target.topic, target.type), changed=changed)

    def create_subscription(  # noqa: PLR0913 - rclpy's signature
        self,
        type_: MessageType,
        topic: str,
        callback: Callback | None = None,
        qos: QoSProfile | int = DEFAULT,
        *,
        raw: bool = False,
        transport: Transport = "dds",
    ) -> Subscription:
        """Create a subscription; see `sfglab.bus.Node.create_subscription`."""
        core = self._core
        check_transport(transport)
        target = self._target(type_, topic, qos)
        changed = Signal(core.loop)
        decode = _raw if raw else self._decoding(target.type)
        calls = core.calls(f"subscription {target.topic!r}")
        inbox = Inbox(core.bridge, SampleQueue(target.qos), decode=decode, callback=callback, calls=calls)
        reader, watch = core.open_reader(target, transport, notify=changed.notify, inbox=inbox)
        incoming = Incoming(reader, inbox, decode, watch)
        core.own(incoming)
        return Subscription(
            self, cast("Core", core), incoming, topic=(target.topic, target.type), changed=changed
        )

    def create_service(self, type_: str, name: str, handler: Handler) -> Service:
        """Create a service; see `sfglab.bus.Node.create_service`."""
        return Service(self, cast("Core", self._core), type_, name=self._resolve(name), handler=handler)

    def create_client(self, type_: str, name: str) -> Client:
        """Create a client; see `sfglab.bus.Node.create_client`."""
        return Client(self, cast("Core", self._core), type_, name=self._resolve(name))

    def create_action_server(
        self,
        type_: str,
        name: str,
        execute_callback: ExecuteCallback,
        **options: Unpack[ActionServerOptions],
    ) -> ActionServer:
        """Create an action's server; see `sfglab.bus.Node.create_action_server`."""
        name = self._resolve(name)
        return ActionServer(
            self, cast("Core", self._core), type_, name=name, execute=execute_callback, **options
        )

    def create_action_client(self, type_: str, name: str) -> ActionClient:
        """Create an action's client; see `sfglab.bus.Node.create_action_client`."""
        return ActionClient(self, cast("Core", self._core), type_, name=self._resolve(name))

    def create_timer(self, period_s: float, callback: Callable[[], Awaitable[None] | None]) -> Timer:
        """Create a timer; see `sfglab.bus.Node.create_timer`."""
        timer = Timer(period_s, callback, self._core.calls(f"timer of {period_s} s"))
        self._core.own(timer)
        return timer

    def open_inlet(self, endpoint: RawEndpoint, sink: Sink) -> SimInlet:
        """Open a raw reader, which the graph shows like any subscription; see `ForwardingNode`."""
        return SimInlet(self._core, endpoint, sink)

    def open_outlet(self, endpoint: RawEndpoint) -> SimOutlet:
        """Open a raw writer, which the graph shows like any publisher; see `ForwardingNode`."""
        return SimOutlet(self._core, endpoint)

    async def close(self) -> None:
        """End all endpoints, timers and callbacks and leave the domain; again is harmless."""
        self.destroy_node()
        await self._sim.ended()

    def destroy_node(self) -> None:
        """Do what `close` does without waiting for cancelled callbacks."""
        self._sim.close()

    def crash(self) -> None:
        """Die without a word: the others notice when the lease has run out."""
        self._sim.crash()

    @property
    def _core(self) -> SimCore:
        if self._sim.closed:
            raise ClosedError(f"node {self._name!r}")
        return self._sim

    def _resolve(self, name: str) -> str:
        return names.resolve(name, self._namespace, node_name=self._name)

    def _target(self, type_: MessageType, topic: str, qos: QoSProfile | int) -> Target:
        profile = QoSProfile(depth=qos) if isinstance(qos, int) else qos
        return Target(topic=self._resolve(topic), type=type_name(type_), qos=profile)

    def _decoding(self, type_: str) -> Callable[[Sample], Any]:
        message_type(type_)
        decode = self._core.world.decoder(type_)
        return lambda sample: decode(cast("bytes", sample[0]))


def _raw(sample: Sample) -> Any:
    return sample[0]
