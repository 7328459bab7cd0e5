"""Values of the bus: endpoints and nodes of the graph, its events, messages' stamps, and what USER_DATA says.

Knows only names, values and shapes. Refuses to know any middleware.
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

#: A 4K image has 25 MB; a cloud of two million points 64 MB.
DEFAULT_MAX_MESSAGE_BYTES = 64 * 2**20

# Keys of USER_DATA, which has the `key=value;` form that ROS 2 uses there: `enclave=/;` on participants,
# `typehash=..;` and `serviceid=..;` on endpoints. Readers ignore keys that they do not know.
NODE_KEY = "sfglab.node"
HOST_KEY = "sfglab.host"
SHM_KEY = "sfglab.shm"
#: Of a writer that advertises a topic and sends nothing before a subscription exists.
OFFER_KEY = "sfglab.offer"
#: Partition in which shared-memory endpoints are announced, so that no DDS endpoint matches them.
SHM_PARTITION = "sfglab.shm"

#: Fast DDS's vendor id, with which its GUIDs begin (RTPS 2.5, clause 9.3.1.5).
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
    #: Time at which it was taken from the transport, by this host's clock, Unix time, ns.
    received_timestamp_ns: int
    publisher_gid: bytes  #: The 16-byte DDS GUID of the publisher; zeros when it was already gone.


@dataclass(frozen=True, slots=True, kw_only=True)
class RawEndpoint:
    """A writer or reader of serialized messages, as a backend is asked to open it."""

    dds_topic: str  #: The topic on the wire: "rt/tf", "rq/global/go2/get_metadataRequest".
    #: As `EndpointInfo.type` names it: the ROS type, or the DDS type when it has no ROS name. On topics below
    #: "rq/" and "rr/" the CDR begins with the 16 bytes of `sfglab.messages.frame_service`.
    type: str
    qos: QoSProfile  #: QoS that a reader requests or a writer offers.
    user_data: bytes = b""  #: The endpoint's USER_DATA, which the others' graphs show.
    name: str = ""  #: The ROS name of the topic or service, for error messages.
    #: Endpoints of different transports do not meet. "ros" is for services (`sfglab.bus.ros`), "any" for a
    #: raw writer of them.
    transport: Transport = "dds"
    #: The limit of one message's CDR with "shm".
    max_message_bytes: int = DEFAULT_MAX_MESSAGE_BYTES
    #: Whether the endpoint belongs to a router. Samples then keep their form, and endpoints of the same
    #: participant do not match it.
    forwards: bool = False
    #: Whether samples are handed over in the thread that takes them, if there is one.
    threaded: bool = False

    def __post_init__(self) -> None:
        if self.transport not in get_args(Transport):
            raise InvalidValueError("transport", self.transport, ", ".join(get_args(Transport)))
        if self.transport in ("ros", "any") and not self.is_service:
            raise InvalidValueError(f"topic {self.name!r}, transport", self.transport, "dds, shm")

    @property
    def is_service(self) -> bool:
        """Whether it is one half of a service, so that its CDR begins with a frame."""
        return self.dds_topic.startswith(("rq/", "rr/"))


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointInfo:
    """One publisher or subscription in the computation graph."""

    kind: EndpointKind  #: Publisher or subscription.
    topic: str  #: The ROS topic ("/chatter"), or the DDS topic as it is when it has no ROS name.
    #: The ROS type ("std_msgs/msg/String"), or the DDS type as it is when it has no ROS name.
    type: str
    gid: bytes  #: The endpoint's 16-byte DDS GUID.
    qos: QoSProfile  #: QoS that the endpoint offers or requests.
    #: "dds", "shm" for what announces a shared-memory endpoint, or "ros" for a service's half in rmw_fastrtps.
    transport: Transport = "dds"
    participant: bytes = b""  #: The 16-byte GUID of its participant.
    host: str = (
        ""  #: Host of the endpoint: a host id of sfglab, otherwise a host name, otherwise empty.
    )
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
    #: GUIDs (16 bytes) of its subscriptions, services' included, in its order.
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
"""A change of the graph: an endpoint appeared or disappeared."""

Listener = Callable[[EndpointEvent], None]


@cache
def ros_topic(dds_topic: str) -> str:
    """Return the ROS name of a topic on the wire, or the topic as it is when it has none."""
    wire = names.ros_name_from_dds(dds_topic)
    return wire.name if wire is not None and wire.role is names.DdsRole.TOPIC else dds_topic


def entries(data: bytes) -> dict[str, str]:
    """Return the entries of USER_DATA; what has another form is left out."""
    pairs = (part.partition("=") for part in data.decode(errors="replace").split(";"))
    return {key: value for key, separator, value in pairs if separator}


def user_data(values: dict[str, str]) -> bytes:
    """Return USER_DATA with these entries, in their order."""
    return "".join(f"{key}={value};" for key, value in values.items()).encode()


def host_id() -> str:
    """Return 16 hexadecimal digits of a boot and network namespace: who shares them shares Unix sockets."""
    boot_id = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    return _host_id(boot_id, str(Path("/proc/self/ns/net").readlink()))


@cache
def _host_id(boot_id: str, namespace: str) -> str:
    return hashlib.blake2b(f"{boot_id} {namespace}".encode(), digest_size=8).hexdigest()
