"""Node with endpoints, timers and a clock, over DDS and shared memory or any other backend."""

from __future__ import annotations

import asyncio
import inspect
import warnings
import weakref
from functools import partial
from typing import TYPE_CHECKING, Any, Self, Unpack

from sfglab import names
from sfglab.bus.actions.client import ActionClient
from sfglab.bus.actions.server import ActionServer, ExecuteCallback
from sfglab.bus.api import DEFAULT_MAX_MESSAGE_BYTES, Callback, Handler, MessageType, Transport
from sfglab.bus.backend import Backend, Clock, Join, RawForwarder
from sfglab.bus.dds.backend import DdsBackend
from sfglab.bus.dds.domain import DomainConfig, DomainOptions
from sfglab.bus.errors import ClosedError
from sfglab.bus.pubsub import Publisher, Subscription, topic_endpoint
from sfglab.bus.service import Client, Service
from sfglab.domains import usual_domain_id
from sfglab.errors import InvalidValueError
from sfglab.qos import DEFAULT, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from sfglab.bus.forwarding import Forwarder
    from sfglab.bus.graph import Graph
    from sfglab.bus.loop import CallbackRunner


class Timer:
    """Timer with a plain or async callback every `period_s` seconds, without drift; missed turns are skipped.

    Raises:
        InvalidValueError: The period is not positive.
    """

    def __init__(
        self, period_s: float, callback: Callable[[], Awaitable[None] | None], calls: CallbackRunner
    ) -> None:
        if not period_s > 0:
            raise InvalidValueError("timer period", period_s, "a positive number of seconds")
        self._loop = asyncio.get_running_loop()
        self._period_s = period_s
        self._callback = callback
        self._calls = calls
        self._next_s = self._loop.time() + period_s
        self._running: asyncio.Task[Any] | None = None
        self._handle = self._loop.call_at(self._next_s, self._tick)

    def cancel(self) -> None:
        """Stop the timer and cancel a running callback; repeated calls are harmless."""
        if self._loop.is_closed():
            return
        self._handle.cancel()
        if self._running is not None:
            self._running.cancel()

    def _tick(self) -> None:
        missed = max(0, int((self._loop.time() - self._next_s) / self._period_s))
        self._next_s += (1 + missed) * self._period_s
        self._handle = self._loop.call_at(self._next_s, self._tick)
        if self._running is None or self._running.done():
            self._running = self._calls.run(self._callback)


class Node:
    """Participant in the computation graph, on the running asyncio loop.

    ```python
    async with Node("talker", domain_id=7, interface="lo") as node:
        publisher = node.create_publisher("std_msgs/msg/String", "/chatter")
    ```

    The alternative is `node.start()` with `await node.close()`. A node that is neither
    closed nor referenced any more closes with a ResourceWarning, at the latest when the interpreter ends. Its
    publishers, subscriptions, services and clients do not keep it alive.

    Args:
        name: Name of the node.
        namespace: Namespace of the node, in which relative names are resolved.
        join: Function that joins the middleware; None joins DDS, with shared memory, with the other arguments.
        domain_id: DDS domain, 0 to 232; None for that of ROS_DOMAIN_ID, otherwise 0.
        domain: `interface`, `multicast`, `lease_s`, `external_domain_id` and `max_sample_bytes` of
            `DomainConfig`; nodes of one process and domain share them.
    """

    def __init__(
        self,
        name: str,
        *,
        namespace: str = "/",
        join: Join | None = None,
        domain_id: int | None = None,
        **domain: Unpack[DomainOptions],
    ) -> None:
        self.name = name  #: Name of the node, without its namespace.
        self.namespace = namespace  #: Namespace of the node.
        domain_id = usual_domain_id() if domain_id is None else domain_id
        config = DomainConfig(domain_id=domain_id, **domain)
        self._join = join or partial(DdsBackend, config)
        self._live: Backend | None = None
        self._finalizer: weakref.finalize[..., Node] | None = None

    async def __aenter__(self) -> Self:
        self.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    def start(self) -> None:
        """Join the domain on the running loop; harmless for a started node.

        Raises:
            DomainError: The domain cannot be joined.
        """
        if self._live is not None and not self._live.closed:
            return
        self._live = self._join(self._resolve(self.name))
        self._finalizer = weakref.finalize(self, _close_forgotten, self._live, self.name)

    @property
    def backend(self) -> Backend:
        """Backend of the node.

        Raises:
            ClosedError: The node was not started, or is closed.
        """
        if self._live is None or self._live.closed:
            raise ClosedError(f"node {self.name!r}")
        return self._live

    @property
    def graph(self) -> Graph:
        """Graph of the domain's endpoints that the node has discovered."""
        return self.backend.graph

    @property
    def guid(self) -> bytes:
        """16-byte GUID of the node's participant."""
        return self.backend.guid

    def get_clock(self) -> Clock:
        """Return the clock of the node: the system time, or the virtual time of a simulated world."""
        return Clock() if self._live is None else self._live.clock

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
            type_: Message type or its name.
            topic: Name: absolute, relative to the namespace, or private ("~/x").
            qos: Offered QoS; a number is the depth of an otherwise default profile.
            transport: Transport: "dds", or "shm" for subscriptions with "shm" on the same host.
            max_message_bytes: Limit of one message's CDR with "shm", bytes. The memory file is at most about 64
                times as large. Memory is taken only for messages that are kept: the history for late joiners,
                the newest `depth` messages, and at most depth + 4 (never more than 64) for each subscriber.

        Raises:
            FqnError: The name is not valid.
            UnknownTypeError: There is no such message type.
            InvalidValueError: There is no such transport.
            ClosedError: The node was not started, or is closed.
        """
        options = {"transport": transport, "max_message_bytes": max_message_bytes}
        endpoint = topic_endpoint(type_, self._resolve(topic), qos, **options)
        return Publisher(self.backend, endpoint)

    def create_subscription(  # noqa: PLR0913 - rclpy's signature
        self,
        type_: MessageType,
        topic: str,
        callback: Callback | None = None,
        qos: QoSProfile | int = DEFAULT,
        *,
        raw: bool = False,
        transport: Transport = "dds",
        threaded: bool = False,
    ) -> Subscription:
        """Create a subscription; see `create_publisher`.

        Args:
            type_: Message type or its name.
            topic: Name: absolute, relative or private.
            callback: Plain or async function that receives each message; None for `take` or `async for`.
            qos: Requested QoS; a number is the depth of an otherwise default profile.
            raw: Whether CDR is handed out instead of messages.
            transport: Transport: "dds", or "shm" for publishers with "shm" on the same host.
            threaded: Whether a plain callback runs in the thread that takes messages, which costs less CPU
                than on the loop. The callback must use the node only through `loop.call_soon_threadsafe`.
                Closing waits for a running call, 5 s at most.

        Raises:
            InvalidValueError: There is no such transport, or `threaded` is set without a plain callback.
            FqnError: The name is not valid.
            UnknownTypeError: There is no such message type.
            ClosedError: The node was not started, or is closed.
        """
        if threaded and (callback is None or inspect.iscoroutinefunction(callback)):
            place = f"threaded subscription of {topic!r}, callback"
            raise InvalidValueError(place, callback, "a plain function")
        options = {"transport": transport, "threaded": threaded}
        endpoint = topic_endpoint(type_, self._resolve(topic), qos, **options)
        return Subscription(self.backend, endpoint, callback, raw=raw)

    def create_service(
        self, type_: str, name: str, handler: Handler, *, transport: Transport = "dds"
    ) -> Service:
        """Create a server of a service.

        Args:
            type_: Name of the service type, such as "example_interfaces/srv/AddTwoInts".
            name: Name: absolute, relative or private.
            handler: Plain or async function that returns the response to a request.
            transport: "dds" for clients of sfglab and rmw_cyclonedds; "ros" for clients of rmw_fastrtps, which
                needs an installed ROS 2.

        Raises:
            FqnError: The name is not valid.
            UnknownTypeError: There is no such service type.
            ClosedError: The node was not started, or is closed.
        """
        name = self._resolve(name)
        return Service(self.backend, type_, name=name, handler=handler, transport=transport)

    def create_client(self, type_: str, name: str, *, transport: Transport = "dds") -> Client:
        """Create a client of a service; arguments and errors are those of `create_service`."""
        return Client(self.backend, type_, name=self._resolve(name), transport=transport)

    def create_action_server(
        self, type_: str, name: str, execute_callback: ExecuteCallback
    ) -> ActionServer:
        """Create a server of an action such as "sfglab_interfaces/action/FollowTrajectory"; see `ActionServer`."""
        name = self._resolve(name)
        return ActionServer(self.backend, type_, name=name, execute=execute_callback)

    def create_action_client(self, type_: str, name: str) -> ActionClient:
        """Create a client of an action type such as "sfglab_interfaces/action/FollowTrajectory"; see `ActionClient`."""
        return ActionClient(self.backend, type_, name=self._resolve(name))

    def create_timer(
        self, period_s: float, callback: Callable[[], Awaitable[None] | None]
    ) -> Timer:
        """Create a timer with a period in seconds, above 0; its callback is plain or async."""
        timer = Timer(period_s, callback, self.backend.calls(f"timer of {period_s} s"))
        self.backend.register(timer.cancel)
        return timer

    def open_forwarder(self, target: Node) -> Forwarder:
        """Return a forwarder that sends samples from this node's domain unchanged to the domain of another node.

        The two nodes may have different backends.
        """
        here, there = self.backend, target.backend
        if type(here) is not type(there):
            return RawForwarder(here, there)
        return here.open_forwarder(there)

    async def close(self) -> None:
        """Close all endpoints, timers and callbacks and leave the domain; repeated calls are harmless."""
        if self._live is not None:
            self.destroy_node()
            await self._live.ended()

    def destroy_node(self) -> None:
        """Close the node without waiting for cancelled callbacks; callable from any thread."""
        if self._live is not None and self._finalizer is not None:
            self._finalizer.detach()
            self._live.close()

    def _resolve(self, name: str) -> str:
        return names.resolve(name, self.namespace, node_name=self.name)


def _close_forgotten(backend: Backend, name: str) -> None:
    """Close the backend of an unclosed node that has no references any more."""
    if backend.closed:
        return
    try:
        said = f"node {name!r} was not closed; use `async with` or `await node.close()`"
        warnings.warn(said, ResourceWarning, stacklevel=2)
    finally:  # also where warnings are errors
        backend.close()
