"""The bus as components see it: a small interface in rclpy's vocabulary, to be awaited.

Knows only names, values and shapes. Refuses to know any middleware, so that one component runs live (DDS,
shared memory) and simulated: annotate with these protocols, receive the node as an argument and take the
time only from `Node.get_clock`.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any, Literal, Protocol

from sfglab.qos import DEFAULT, QoSProfile

if TYPE_CHECKING:
    from typing import Unpack

    from sfglab.bus.actions import ActionClient, ActionServer, ActionServerOptions
    from sfglab.bus.actions.engine import ExecuteCallback


Transport = Literal["dds", "shm"]
MessageType = str | type[Any]
Callback = Callable[[Any], Awaitable[None] | None]
Handler = Callable[[Any], Any]


class EndpointKind(Enum):
    """Which way an endpoint's messages flow."""

    PUBLISHER = "publisher"
    SUBSCRIPTION = "subscription"


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageInfo:
    """What is known about a received message beside its content."""

    source_timestamp_ns: int  #: When it was published, by the publisher's clock (Unix time, nanoseconds).
    received_timestamp_ns: int  #: When it was taken from the transport, by this host's clock (Unix time, ns).
    publisher_gid: bytes  #: The 16-byte DDS GUID of the publisher; zeros when it was already gone.


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointInfo:
    """One publisher or subscription in the computation graph."""

    kind: EndpointKind  #: Publisher or subscription.
    topic: str  #: The ROS topic ("/chatter"), or the DDS topic as it is when it has no ROS name.
    type: str  #: The ROS type ("std_msgs/msg/String"), or the DDS type as it is when it has no ROS name.
    gid: bytes  #: The endpoint's 16-byte DDS GUID.
    qos: QoSProfile  #: What the endpoint offers or requests.
    transport: Transport = "dds"  #: "dds", or "shm" for the presence of a shared-memory endpoint.
    participant: bytes = b""  #: The 16-byte GUID of its participant.
    host: str = ""  #: Which host it lives on: a host id of sfglab, else a host name, else empty.
    #: The full name of the node that owns it, else empty. Of nodes that are not sfglab's it is known only once
    #: the graph was asked for nodes.
    node: str = ""
    dds_topic: str = ""  #: The topic on the wire ("rt/chatter").
    user_data: bytes = b""  #: The endpoint's DDS USER_DATA.


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeInfo:
    """A node of the computation graph, as its participant announces it."""

    namespace: str  #: The node's namespace, "/" for the root.
    name: str  #: Its name.
    participant: bytes  #: The 16-byte GUID of its participant.
    #: The 16-byte GUIDs of its subscriptions, services' and clients' included, in its own order.
    readers: tuple[bytes, ...] = ()
    writers: tuple[bytes, ...] = ()  #: The same of its publishers.

    @property
    def full_name(self) -> str:
        """The node's name with its namespace."""
        return f"{self.namespace.rstrip('/')}/{self.name}"


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointAdded:
    """An endpoint appeared, or one that was known changed what it says about itself."""

    endpoint: EndpointInfo  #: The endpoint.


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointRemoved:
    """An endpoint was closed, or its participant's lease ran out."""

    endpoint: EndpointInfo  #: The endpoint as it was last known.


EndpointEvent = EndpointAdded | EndpointRemoved


class Clock(Protocol):
    """The time of a node's world."""

    def now_ns(self) -> int:
        """Return the current time, in nanoseconds since the Unix epoch."""

    async def sleep_for(self, duration_s: float) -> None:
        """Return after `duration_s` seconds of this clock."""


class Graph(Protocol):
    """What a node knows about all endpoints of its domain."""

    def publishers(self, topic: str) -> tuple[EndpointInfo, ...]:
        """Return the publishers of a ROS topic, ordered by gid."""

    def subscriptions(self, topic: str) -> tuple[EndpointInfo, ...]:
        """Return the subscriptions of a ROS topic, ordered by gid."""

    def endpoints(self) -> tuple[EndpointInfo, ...]:
        """Return all known endpoints, ordered by gid."""

    def events(self) -> AsyncIterator[EndpointEvent]:
        """Yield an `EndpointAdded` for every endpoint known now, then every change."""

    def listen(self, listener: Callable[[EndpointEvent], None]) -> Callable[[], None]:
        """Call `listener` for every endpoint known now and every change; return what ends that."""

    def watch(
        self, dds_topic: str, kind: EndpointKind, listener: Callable[[EndpointEvent], None]
    ) -> Callable[[], None]:
        """Call `listener` as `listen` does, but only for endpoints of one kind on one topic of the wire.

        In a domain of thousands of endpoints, whoever needs few topics watches those.
        """


class Publisher(Protocol):
    """One topic's outgoing messages."""

    @property
    def topic_name(self) -> str:
        """The fully resolved ROS topic."""

    def publish(self, message: Any) -> None:
        """Serialize and send one message."""

    def publish_raw(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Send one message that is already CDR, header included."""

    def get_subscription_count(self) -> int:
        """Return how many subscriptions match now."""

    async def wait_for_subscriptions(self, count: int = 1, timeout_s: float = 5.0) -> None:
        """Return once at least `count` subscriptions match."""

    def close(self) -> None:
        """End the publisher; again is harmless."""


class Subscription(Protocol):
    """One topic's incoming messages, in a queue of its own that its QoS bounds."""

    @property
    def topic_name(self) -> str:
        """The fully resolved ROS topic."""

    @property
    def dropped(self) -> int:
        """How many messages the queue's bound pushed out before they were read."""

    @property
    def lost(self) -> int:
        """How many messages the transport knows to have lost on the way here."""

    async def take(self, timeout_s: float | None = None) -> Any:
        """Return the oldest queued message, waiting for one if there is none."""

    async def take_with_info(self, timeout_s: float | None = None) -> tuple[Any, MessageInfo]:
        """Return the oldest queued message and what is known about it."""

    def __aiter__(self) -> AsyncIterator[Any]: ...

    def get_publisher_count(self) -> int:
        """Return how many publishers match now."""

    async def wait_for_publishers(self, count: int = 1, timeout_s: float = 5.0) -> None:
        """Return once at least `count` publishers match."""

    def close(self) -> None:
        """End the subscription; again is harmless."""


class Service(Protocol):
    """A service's server side."""

    @property
    def service_name(self) -> str:
        """The fully resolved ROS service."""

    def close(self) -> None:
        """End the service; again is harmless."""


class Client(Protocol):
    """A service's client side."""

    @property
    def service_name(self) -> str:
        """The fully resolved ROS service."""

    async def wait_for_service(self, timeout_s: float = 5.0) -> None:
        """Return once a server can be called."""

    async def call(self, request: Any, timeout_s: float = 5.0) -> Any:
        """Return the server's response."""

    def close(self) -> None:
        """End the client; again is harmless."""


class Timer(Protocol):
    """A callback that runs periodically."""

    def cancel(self) -> None:
        """Stop the timer; again is harmless."""


class Node(Protocol):
    """A participant in the computation graph: makes endpoints and knows the time."""

    @property
    def name(self) -> str:
        """The node's name, without its namespace."""

    @property
    def graph(self) -> Graph:
        """What the node knows about the domain's endpoints."""

    def get_clock(self) -> Clock:
        """Return the clock of the node's world."""

    def create_publisher(
        self, type_: MessageType, topic: str, qos: QoSProfile | int = DEFAULT, *, transport: Transport = "dds"
    ) -> Publisher:
        """Create a publisher."""

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
        """Create a subscription."""

    def create_service(self, type_: str, name: str, handler: Handler) -> Service:
        """Create a service."""

    def create_client(self, type_: str, name: str) -> Client:
        """Create a client."""

    def create_action_server(
        self,
        type_: str,
        name: str,
        execute_callback: ExecuteCallback,
        **options: Unpack[ActionServerOptions],
    ) -> ActionServer:
        """Create an action's server."""

    def create_action_client(self, type_: str, name: str) -> ActionClient:
        """Create an action's client."""

    def create_timer(self, period_s: float, callback: Callable[[], Awaitable[None] | None]) -> Timer:
        """Create a timer."""
