"""Values of the bus: endpoints, nodes and events of the graph, metadata of messages, and entries of USER_DATA.

The module depends on no middleware.
"""

from __future__ import annotations

import hashlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from sfglab import names
from sfglab.errors import InvalidValueError

if TYPE_CHECKING:
    from sfglab.qos import QoSProfile

Transport = Literal["dds", "shm", "ros", "any"]
#: Parameter services over DDS, for rmw_cyclonedds, or with the rclpy helper (`sfglab.bus.ros`).
ParameterTransport = Literal["dds", "ros"]
MessageType = str | type[Any]
Callback = Callable[[Any], Awaitable[None] | None]
Handler = Callable[[Any], Any]

#: Default limit of a message's CDR, bytes: a 4K image has 25 MB, a cloud of two million points 64 MB.
DEFAULT_MAX_MESSAGE_BYTES = 64 * 2**20

# Keys of USER_DATA. ROS 2 writes `key=value;` there: `enclave=/;` on participants, `typehash=..;` and
# `serviceid=..;` on endpoints. Readers ignore unknown keys.
NODE_KEY = "sfglab.node"
HOST_KEY = "sfglab.host"
SHM_KEY = "sfglab.shm"
#: Key of a writer that advertises a topic and sends nothing before a subscription exists.
OFFER_KEY = "sfglab.offer"
#: Partition in which shared-memory endpoints are announced, so that no DDS endpoint matches them.
SHM_PARTITION = "sfglab.shm"

#: Vendor id of Fast DDS: the first bytes of its GUIDs (RTPS 2.5, clause 9.3.1.5).
FAST_DDS = b"\x01\x0f"


class EndpointKind(Enum):
    """Direction in which an endpoint's messages flow."""

    PUBLISHER = "publisher"
    SUBSCRIPTION = "subscription"


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageInfo:
    """Metadata of a received message."""

    #: Time of publication by the publisher's clock, Unix time, ns.
    source_timestamp_ns: int
    #: Time at which the message was taken from the transport, by this host's clock, Unix time, ns.
    received_timestamp_ns: int
    publisher_gid: bytes  #: 16-byte DDS GUID of the publisher; zeros if the publisher had left.


@dataclass(frozen=True, slots=True, kw_only=True)
class RawEndpoint:
    """Description of a writer or reader of serialized messages, from which a backend opens it.

    Raises:
        InvalidValueError: The transport does not exist, or is not for this kind of endpoint.
    """

    dds_topic: str  #: DDS topic, such as "rt/tf" or "rq/global/go2/get_metadataRequest".
    #: ROS type, or the DDS type if it has no ROS name. On topics below "rq/" and "rr/" the CDR begins with the
    #: 16 bytes of `sfglab.messages.frame_service`.
    type: str
    qos: QoSProfile  #: QoS that a reader requests or a writer offers.
    user_data: bytes = b""  #: USER_DATA of the endpoint; the graphs of other nodes show it.
    name: str = ""  #: ROS name of the topic or service, for error messages.
    #: Transport; endpoints of different transports do not match. "ros" is for services (`sfglab.bus.ros`),
    #: "any" for a raw writer of services.
    transport: Transport = "dds"
    #: Limit of one message's CDR with "shm", bytes.
    max_message_bytes: int = DEFAULT_MAX_MESSAGE_BYTES
    #: Whether the endpoint belongs to a router. Samples then pass unchanged, and endpoints of the same
    #: participant do not match it.
    forwards: bool = False
    #: Whether the callback runs in the thread that takes samples, if there is one, instead of on the loop.
    threaded: bool = False

    def __post_init__(self) -> None:
        if self.transport not in get_args(Transport):
            raise InvalidValueError("transport", self.transport, ", ".join(get_args(Transport)))
        if self.transport in ("ros", "any") and not self.is_service:
            raise InvalidValueError(f"topic {self.name!r}, transport", self.transport, "dds, shm")

    @property
    def is_service(self) -> bool:
        """Whether the endpoint is a request or reply endpoint, whose CDR begins with a frame."""
        return self.dds_topic.startswith(("rq/", "rr/"))


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointInfo:
    """One publisher or subscription in the computation graph."""

    kind: EndpointKind  #: Publisher or subscription.
    topic: str  #: ROS topic ("/chatter"), or the DDS topic if it has no ROS name.
    #: ROS type ("std_msgs/msg/String"), or the DDS type if it has no ROS name.
    type: str
    gid: bytes  #: 16-byte DDS GUID of the endpoint.
    qos: QoSProfile  #: QoS that the endpoint offers or requests.
    #: "dds", "shm" for the announcement of a shared-memory endpoint, or "ros" for a request or reply endpoint
    #: of rmw_fastrtps.
    transport: Transport = "dds"
    participant: bytes = b""  #: 16-byte GUID of its participant.
    host: str = ""  #: Host id of a participant of sfglab, see `host_id`; empty for others.
    #: Full name of the owning node; empty if unknown. Owners outside sfglab are known only after a call of
    #: `Graph.nodes`.
    node: str = ""
    dds_topic: str = ""  #: DDS topic ("rt/chatter").
    user_data: bytes = b""  #: USER_DATA of the endpoint.


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeInfo:
    """A node of the computation graph, as its participant announces it."""

    namespace: str  #: Namespace of the node, "/" for the root.
    name: str  #: Name of the node, without its namespace.
    participant: bytes  #: 16-byte GUID of its participant.
    #: GUIDs (16 bytes) of the node's subscriptions, including those of services, in the announced order.
    readers: tuple[bytes, ...] = ()
    writers: tuple[bytes, ...] = ()  #: GUIDs of the node's publishers, likewise.

    @property
    def full_name(self) -> str:
        """Name of the node with its namespace."""
        return f"{self.namespace.rstrip('/')}/{self.name}"


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointAdded:
    """Event: an endpoint appeared, or a known endpoint changed its announcement."""

    endpoint: EndpointInfo  #: The endpoint.


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointRemoved:
    """Event: an endpoint was closed, or the lease of its participant expired."""

    endpoint: EndpointInfo  #: Last known description of the endpoint.


EndpointEvent = EndpointAdded | EndpointRemoved
"""A change of the graph: an endpoint appeared or disappeared."""

Listener = Callable[[EndpointEvent], None]


@cache
def ros_topic(dds_topic: str) -> str:
    """Return the ROS name of a DDS topic, or the DDS topic itself if it has none."""
    wire = names.ros_name_from_dds(dds_topic)
    return wire.name if wire is not None and wire.role is names.DdsRole.TOPIC else dds_topic


def entries(data: bytes) -> dict[str, str]:
    """Return the entries of USER_DATA; parts without the form `key=value` are left out."""
    pairs = (part.partition("=") for part in data.decode(errors="replace").split(";"))
    return {key: value for key, separator, value in pairs if separator}


def user_data(values: dict[str, str]) -> bytes:
    """Return USER_DATA with these entries in this order."""
    return "".join(f"{key}={value};" for key, value in values.items()).encode()


def host_id() -> str:
    """Return the host id: a hash of boot id and network namespace, 16 hexadecimal digits.

    Processes with the same host id can connect over abstract Unix sockets.
    """
    boot_id = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    return _host_id(boot_id, str(Path("/proc/self/ns/net").readlink()))


@cache
def _host_id(boot_id: str, namespace: str) -> str:
    return hashlib.blake2b(f"{boot_id} {namespace}".encode(), digest_size=8).hexdigest()
