"""The live node: DDS and shared memory behind the bus's interface."""

from __future__ import annotations

import weakref
from functools import partial
from typing import TYPE_CHECKING, Any, Self

from sfglab import names
from sfglab.bus.actions import ActionClient, ActionServer
from sfglab.bus.bridge import Signal
from sfglab.bus.clock import SystemClock, Timer
from sfglab.bus.core import Core
from sfglab.bus.dds.config import DomainConfig, DomainOptions
from sfglab.bus.errors import ClosedError
from sfglab.bus.inbox import Inbox
from sfglab.bus.mismatch import MismatchWatch
from sfglab.bus.publisher import Publisher
from sfglab.bus.queue import Sample, SampleQueue
from sfglab.bus.service import Client, Service
from sfglab.bus.subscription import Incoming, Subscription
from sfglab.bus.transports import DEFAULT_MAX_MESSAGE_BYTES, Target, open_reader, open_writer
from sfglab.messages import decoder, message_type, type_name
from sfglab.qos import DEFAULT, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable
    from typing import Unpack

    from sfglab.bus.actions import ActionServerOptions
    from sfglab.bus.actions.engine import ExecuteCallback
    from sfglab.bus.api import Callback, Handler, MessageType, Transport
    from sfglab.bus.calls import OnError
    from sfglab.bus.graph import Graph


class Node:
    """A participant in the computation graph, on the running asyncio loop.

    ```python
    async with Node("talker", domain_id=7, interface="lo") as node:
        publisher = node.create_publisher("std_msgs/msg/String", "/chatter")
    ```

    Or `node = await Node.create("talker")` with `await node.close()`. A node that is neither closed nor
    referenced any more closes itself, at the latest when the interpreter ends.

    Args:
        name: The node's name.
        namespace: Where relative topic names live.
        domain_id: The DDS domain, 0 to 232.
        on_error: Called with every exception of a callback and a text that names its place; None logs it.
        presence: False keeps the node off ROS 2's graph: its endpoints are seen, but not as a node's.
        domain: `interface`, `multicast`, `lease_s` and `external_domain_id` of `DomainConfig`; nodes of one
            process and domain share them.
    """

    def __init__(
        self,
        name: str,
        *,
        namespace: str = "/",
        domain_id: int = 0,
        on_error: OnError | None = None,
        presence: bool = True,
        **domain: Unpack[DomainOptions],
    ) -> None:
        self._name = name
        self._namespace = namespace
        self._config = DomainConfig(domain_id=domain_id, **domain)
        self._on_error = on_error
        self._presence = presence
        self._clock = SystemClock()
        self._live: Core | None = None
        self._finalizer: Callable[[], object] | None = None

    @classmethod
    async def create(cls, name: str, **options: Any) -> Self:
        """Return a started node; the arguments are those of the class.

        Raises:
            DomainError: The domain cannot be joined.
        """
        node = cls(name, **options)
        node._start()
        return node

    async def __aenter__(self) -> Self:
        self._start()
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
    def domain(self) -> DomainConfig:
        """The DDS domain and how it was joined."""
        return self._config

    @property
    def graph(self) -> Graph:
        """What the node knows about the domain's endpoints."""
        return self._core.graph

    @property
    def guid(self) -> bytes:
        """The 16-byte GUID of the node's DDS participant."""
        return self._core.participant.guid

    def get_clock(self) -> SystemClock:
        """Return the host's clock."""
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
        """Create a publisher.

        Args:
            type_: A message type or its name.
            topic: Absolute, relative to the namespace, or private ("~/x").
            qos: What is offered; a number is the depth of an otherwise default profile.
            transport: "dds", or "shm" for subscriptions with "shm" on the same host.
            max_message_bytes: The limit of one message's CDR with "shm". The memory file is 64 times as
                large at most; memory is taken only where messages lie, which are, besides the history for late
                joiners, at most depth + 2 (and never more than 64) per subscriber, and the newest `depth` ones.
        """
        core = self._core
        target = self._target(type_, topic, qos)
        changed = Signal(core.loop)
        notify = partial(core.bridge.post, changed.notify)
        writer = open_writer(core, target, transport, notify=notify, max_message_bytes=max_message_bytes)
        core.own(writer)
        return Publisher(self, core, writer, topic=(target.topic, target.type), changed=changed)

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
        """Create a subscription.

        Args:
            type_: A message type or its name.
            topic: Absolute, relative to the namespace, or private ("~/x").
            callback: Plain or async, given each message; None to read by `take` or `async for`.
            qos: What is requested; a number is the depth of an otherwise default profile.
            raw: Hand out CDR instead of messages.
            transport: "dds", or "shm" for publishers with "shm" on the same host.
        """
        core = self._core
        target = self._target(type_, topic, qos)
        changed = Signal(core.loop)
        notify = partial(core.bridge.post, changed.notify)
        decode = _raw if raw else _decoding(message_type(target.type))
        calls = core.calls(f"subscription {target.topic!r}")
        inbox = Inbox(core.bridge, SampleQueue(target.qos), decode=decode, callback=callback, calls=calls)
        reader = open_reader(core, target, transport, notify=notify, inbox=inbox)
        incoming = Incoming(reader, inbox, decode, MismatchWatch(core.graph, target, transport))
        core.own(incoming)
        return Subscription(self, core, incoming, topic=(target.topic, target.type), changed=changed)

    def create_service(self, type_: str, name: str, handler: Handler) -> Service:
        """Create a service.

        Args:
            type_: The service's name, e.g. "example_interfaces/srv/AddTwoInts".
            name: Absolute, relative or private.
            handler: Plain or async: given a request, returns a response.
        """
        return Service(self, self._core, type_, name=self._resolve(name), handler=handler)

    def create_client(self, type_: str, name: str) -> Client:
        """Create a client.

        Args:
            type_: The service's name, e.g. "example_interfaces/srv/AddTwoInts".
            name: Absolute, relative or private.
        """
        return Client(self, self._core, type_, name=self._resolve(name))

    def create_action_server(
        self,
        type_: str,
        name: str,
        execute_callback: ExecuteCallback,
        **options: Unpack[ActionServerOptions],
    ) -> ActionServer:
        """Create an action's server.

        Args:
            type_: The action's name, e.g. "sfglab_interfaces/action/FollowTrajectory".
            name: Absolute, relative or private.
            execute_callback: Plain or async: given a `ServerGoalHandle`, does what is asked and returns a
                result; see `ActionServer`.
            options: See `ActionServerOptions`; without a `cancel_callback` goals cannot be canceled.
        """
        name = self._resolve(name)
        return ActionServer(self, self._core, type_, name=name, execute=execute_callback, **options)

    def create_action_client(self, type_: str, name: str) -> ActionClient:
        """Create an action's client.

        Args:
            type_: The action's name, e.g. "sfglab_interfaces/action/FollowTrajectory".
            name: Absolute, relative or private.
        """
        return ActionClient(self, self._core, type_, name=self._resolve(name))

    def create_timer(self, period_s: float, callback: Callable[[], Awaitable[None] | None]) -> Timer:
        """Create a timer.

        Args:
            period_s: The period in seconds, above 0.
            callback: Plain or async, without arguments.
        """
        timer = Timer(period_s, callback, self._core.calls(f"timer of {period_s} s"))
        self._core.own(timer)
        return timer

    async def close(self) -> None:
        """End all endpoints, timers and callbacks and leave the domain; again is harmless."""
        if self._live is not None:
            self.destroy_node()
            await self._live.ended()

    def destroy_node(self) -> None:
        """Do what `close` does without waiting for cancelled callbacks; callable from anywhere."""
        if self._finalizer is not None:
            self._finalizer()

    @property
    def _core(self) -> Core:
        if self._live is None or self._live.closed:
            raise ClosedError(f"node {self._name!r}")
        return self._live

    def _start(self) -> None:
        if self._live is not None and not self._live.closed:
            return
        name = names.resolve(self._name, self._namespace, node_name=self._name)
        self._live = Core(name, self._config, self._on_error, presence=self._presence)
        self._finalizer = weakref.finalize(self, self._live.close)

    def _resolve(self, name: str) -> str:
        return names.resolve(name, self._namespace, node_name=self._name)

    def _target(self, type_: MessageType, topic: str, qos: QoSProfile | int) -> Target:
        profile = QoSProfile(depth=qos) if isinstance(qos, int) else qos
        return Target(topic=self._resolve(topic), type=type_name(type_), qos=profile)


def _raw(sample: Sample) -> Any:
    return sample[0]


def _decoding(type_: type[Any]) -> Callable[[Sample], Any]:
    decode = decoder(type_)
    return lambda sample: decode(sample[0])
