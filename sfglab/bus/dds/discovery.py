"""Discovery in a DDS domain: reads participants, endpoints and ROS 2 nodes, and announces this node.

Sources are Cyclone's built-in topics, USER_DATA of sfglab and ROS 2, and the DDS topic `ros_discovery_info`.
From that topic ROS 2's tools learn of nodes and their endpoints. They show endpoints that are not listed
there under `_CREATED_BY_BARE_DDS_APP_` (rmw_dds_common; rmw_cyclonedds_cpp and rmw_fastrtps_cpp). GIDs on the
topic have 24 bytes up to Humble, a GUID and eight zeros, and 16 bytes from Iron on, under one type name. A
reader of the other layout reads wrong values, so all participants of a domain must use the same layout.
ROS_DISTRO selects it; without ROS_DISTRO, or with an unknown name, the layout is Humble's.
"""

from __future__ import annotations

import ctypes as ct
import os
import struct
from contextlib import suppress
from functools import cache
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import (
    FAST_DDS,
    HOST_KEY,
    NODE_KEY,
    SHM_KEY,
    EndpointEvent,
    EndpointInfo,
    EndpointKind,
    NodeInfo,
    entries,
    ros_topic,
)
from sfglab.bus.dds import clib
from sfglab.bus.dds.clib import (
    ALIVE,
    BUILTIN_PARTICIPANT,
    BUILTIN_PUBLICATION,
    BUILTIN_SUBSCRIPTION,
    library,
)
from sfglab.bus.dds.endpoints import DdsReader, DdsWriter
from sfglab.bus.errors import InvalidMessageError
from sfglab.messages import TypeNameError, ros_type_name
from sfglab.qos import Durability, History, QoSProfile

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Iterable, Iterator

    from sfglab.bus.api import Transport
    from sfglab.bus.dds.domain import DdsParticipant
    from sfglab.bus.endpoints import Sample
    from sfglab.bus.graph import Graph

INFO_TOPIC = "ros_discovery_info"
_TYPE = "rmw_dds_common::msg::dds_::{}_"
_WRITER_QOS = QoSProfile(depth=1, durability=Durability.TRANSIENT_LOCAL)
# The topic has no key: messages of all participants are one instance, of which KEEP_LAST would keep one
# message.
READER_QOS = QoSProfile(history=History.KEEP_ALL, durability=Durability.TRANSIENT_LOCAL)
# rmw/types.h: RMW_GID_STORAGE_SIZE fell from 24 to 16 in Iron.
_LONG_GID_BYTES, _SHORT_GID_BYTES, _GUID_BYTES = 24, 16, 16
_SHORT_GID_DISTROS = frozenset({"iron", "jazzy", "kilted", "lyrical", "rolling"})
_ENCAPSULATION = b"\0\1\0\0"  # CDR, little endian (RTPS 2.5, clause 10.2.1.2)
# Delay of an announcement, s: endpoints appear in groups, such as the two of a service, and share one message.
_DELAY_S = 0.01
_BATCH = 128
_BUILTIN_TYPES = b"org::eclipse::cyclonedds::builtin::"
_KINDS = {
    BUILTIN_PUBLICATION: EndpointKind.PUBLISHER,
    BUILTIN_SUBSCRIPTION: EndpointKind.SUBSCRIPTION,
}
#: Change of the graph: a GID, and its endpoint; None if the endpoint or participant has left.
Change = tuple[bytes, EndpointInfo | None]


def gid_bytes(distro: str | None = None) -> int:
    """Return the size of a GID in `ros_discovery_info` of a ROS 2 distribution, bytes; None for ROS_DISTRO."""
    name = os.environ.get("ROS_DISTRO", "") if distro is None else distro
    return _SHORT_GID_BYTES if name in _SHORT_GID_DISTROS else _LONG_GID_BYTES


@cache
def info_type(size: int) -> type[Any]:
    """Return the Cyclone DDS type of the message whose GIDs have `size` bytes."""
    from cyclonedds.idl import make_idl_struct, types

    # The library's annotations do not know that these can be subscripted.
    array, sequence, text = (getattr(types, name) for name in ("array", "sequence", "bounded_str"))
    gid = make_idl_struct("Gid", _TYPE.format("Gid"), {"data": array[types.uint8, size]})
    node = make_idl_struct(
        "NodeEntitiesInfo",
        _TYPE.format("NodeEntitiesInfo"),
        {
            "node_namespace": text[256],
            "node_name": text[256],
            "reader_gid_seq": sequence[gid],
            "writer_gid_seq": sequence[gid],
        },
    )
    return make_idl_struct(
        "ParticipantEntitiesInfo",
        _TYPE.format("ParticipantEntitiesInfo"),
        {"gid": gid, "node_entities_info_seq": sequence[node]},
    )


def pack_nodes(participant: bytes, nodes: Iterable[NodeInfo], size: int) -> bytes:
    """Return the CDR of the message that lists the nodes of a participant, given by its 16-byte GUID."""
    listed = list(nodes)
    parts = [_ENCAPSULATION, participant.ljust(size, b"\0"), struct.pack("<I", len(listed))]
    for node in listed:
        parts += [_packed_text(node.namespace), _packed_text(node.name)]
        for gids in (node.readers, node.writers):
            parts += [struct.pack("<I", len(gids)), *(gid.ljust(size, b"\0") for gid in gids)]
    return b"".join(parts)


def unpack_nodes(cdr: bytes, size: int) -> tuple[bytes, tuple[NodeInfo, ...]]:
    """Return the participant's GUID and its nodes from a message in little-endian CDR.

    Raises:
        InvalidMessageError: The message is shorter than its counts require.
    """
    cursor = _Cursor(cdr, size)
    participant = cursor.gid()
    nodes = tuple(
        NodeInfo(
            namespace=cursor.text(),
            name=cursor.text(),
            participant=participant,
            readers=cursor.gids(),
            writers=cursor.gids(),
        )
        for _ in range(cursor.number())
    )
    return participant, nodes


def _packed_text(text: str) -> bytes:
    """Return a string with its length, its terminating zero, and the padding before the next number."""
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data + bytes(-len(data) % 4)


class _Cursor:
    """Reader of a message from front to back; GIDs and padded strings keep every number aligned."""

    def __init__(self, cdr: bytes, size: int) -> None:
        self._cdr = cdr
        self._size = size
        self._at = len(_ENCAPSULATION)

    def number(self) -> int:
        return int.from_bytes(self._take(4), "little")

    def text(self) -> str:
        length = self.number()
        return self._take(length + -length % 4)[: max(0, length - 1)].decode(errors="replace")

    def gid(self) -> bytes:
        return self._take(self._size)[:_GUID_BYTES]

    def gids(self) -> tuple[bytes, ...]:
        return tuple(self.gid() for _ in range(self.number()))

    def _take(self, size: int) -> bytes:
        start, self._at = self._at, self._at + size
        if self._at > len(self._cdr):
            raise InvalidMessageError(
                f"graph: given {len(self._cdr)} bytes, allowed: at least {self._at}, by the lengths in them"
            )
        return self._cdr[start : self._at]


class DiscoveryInfo:
    """Announcement of a node and its endpoints in ROS 2's graph, until the participant closes.

    All endpoints that the graph reports are listed, except those for shared memory, on which nothing is
    written.
    """

    def __init__(
        self,
        participant: DdsParticipant,
        graph: Graph,
        name: str,
        *,
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self._guid = participant.guid
        self._namespace, _, self._name = name.rpartition("/")
        self._graph = graph
        self._loop = loop
        self._due: asyncio.TimerHandle | None = None
        self._size = gid_bytes()
        handle = participant.create_writer(INFO_TOPIC, info_type(self._size), _WRITER_QOS)
        self._writer = DdsWriter(
            handle,
            INFO_TOPIC,
            type_="ParticipantEntitiesInfo",
            waitset=participant.waitset,
            on_matched=lambda: None,
        )
        # Matching readers are not needed, and in a large domain every new participant would cause a query for
        # them.
        participant.waitset.detach(handle)
        self._publish()
        self._unlisten = graph.listen(self._heard)

    def close(self) -> None:
        """Stop the announcements; the participant's end removes the node from the graph."""
        self._unlisten()
        if self._due is not None and not self._loop.is_closed():
            self._due.cancel()

    def _heard(self, event: EndpointEvent) -> None:
        if self._lists(event.endpoint) and self._due is None:
            self._due = self._loop.call_later(_DELAY_S, self._publish)

    def _lists(self, endpoint: EndpointInfo) -> bool:
        return endpoint.participant == self._guid and endpoint.transport == "dds"

    def _publish(self) -> None:
        self._due = None
        gids: dict[EndpointKind, list[bytes]] = {kind: [] for kind in EndpointKind}
        for endpoint in self._graph.endpoints():
            if self._lists(endpoint):
                gids[endpoint.kind].append(endpoint.gid)
        node = NodeInfo(
            namespace=self._namespace or "/",
            name=self._name,
            participant=self._guid,
            readers=tuple(gids[EndpointKind.SUBSCRIPTION]),
            writers=tuple(gids[EndpointKind.PUBLISHER]),
        )
        self._writer.write(pack_nodes(self._guid, [node], self._size))


class Discovery:
    """Discovery of endpoints: reports those that appear, change or leave, in order, in the WaitSet thread."""

    def __init__(
        self, participant: DdsParticipant, on_changes: Callable[[list[Change]], None]
    ) -> None:
        self._participant = participant
        self._on_changes = on_changes
        self._origins: dict[bytes, tuple[str, str]] = {}  # host and node of each participant
        lib, waitset = library(), participant.waitset
        self._participants: int = lib.dds_create_reader(
            participant.handle, BUILTIN_PARTICIPANT, None, None
        )
        waitset.attach_reader(self._participants, self._read_participants)
        for topic, kind in _KINDS.items():
            reader: int = lib.dds_create_reader(participant.handle, topic, None, None)
            waitset.attach_reader(reader, self._endpoint_handler(reader, kind))

    def read_nodes(self, on_nodes: Callable[[bytes, tuple[NodeInfo, ...]], None]) -> None:
        """Report each participant's complete list of nodes at every change, in the WaitSet thread."""
        size = gid_bytes()

        def handle(samples: list[Sample]) -> None:
            # A list may be read after the end of its participant, and its nodes would then stay indefinitely.
            self._read_participants()
            for cdr, *_ in samples:
                with suppress(InvalidMessageError):  # not a message of ROS 2
                    participant, nodes = unpack_nodes(bytes(cdr), size)
                    if participant in self._origins:
                        on_nodes(participant, nodes)

        reader = self._participant.create_reader(INFO_TOPIC, info_type(size), READER_QOS)
        DdsReader(
            reader, waitset=self._participant.waitset, on_samples=handle, on_matched=lambda: None
        )  # the WaitSet keeps the reader until the participant ends

    def _endpoint_handler(self, reader: int, kind: EndpointKind) -> Callable[[], None]:
        def handle() -> None:
            # Cyclone knows a participant before its endpoints, but does not always report it before them.
            self._read_participants()
            changes: list[Change] = []
            for sample, alive in take_builtin(reader, clib.Endpoint):
                if not _builtin(sample):
                    gid = bytes(sample.key)
                    changes.append((gid, self._info(sample, gid, kind) if alive else None))
            if changes:
                self._on_changes(changes)

        return handle

    def _read_participants(self) -> None:
        for sample, alive in take_builtin(self._participants, clib.Participant):
            key = bytes(sample.key)
            if not alive:
                self._origins.pop(key, None)
                self._on_changes([(key, None)])
                continue
            known = entries(clib.user_data(sample.qos))
            self._origins[key] = known.get(HOST_KEY, ""), known.get(NODE_KEY, "")

    def _info(self, sample: Any, gid: bytes, kind: EndpointKind) -> EndpointInfo:
        participant = bytes(sample.participant_key)
        host, node = self._origins.get(participant, ("", ""))
        dds_topic = sample.topic_name.decode(errors="replace")
        user_data = clib.user_data(sample.qos)
        return EndpointInfo(
            kind=kind,
            topic=ros_topic(dds_topic),
            type=_ros_type(sample.type_name.decode(errors="replace")),
            gid=gid,
            qos=clib.profile_from_dds(sample.qos),
            transport=_transport(user_data, dds_topic, gid),
            participant=participant,
            host=host,
            node=node,
            dds_topic=dds_topic,
            user_data=user_data,
        )


def _transport(user_data: bytes, dds_topic: str, gid: bytes) -> Transport:
    if SHM_KEY in entries(user_data):
        return "shm"
    # rmw_fastrtps frames services differently; topics are the same in all middlewares.
    return "ros" if gid.startswith(FAST_DDS) and dds_topic.startswith(("rq/", "rr/")) else "dds"


def _builtin(sample: Any) -> bool:
    """Return whether an endpoint belongs to the discovery of participants or of nodes."""
    return (sample.type_name or b"").startswith(
        _BUILTIN_TYPES
    ) or sample.topic_name == INFO_TOPIC.encode()


def _ros_type(dds_type: str) -> str:
    try:
        return ros_type_name(dds_type)
    except TypeNameError:
        return dds_type


def take_builtin(reader: int, struct: type[ct.Structure]) -> Iterator[tuple[Any, bool]]:
    """Yield samples of a built-in reader: the C struct, valid until the next one, and whether it is alive."""
    lib = library()
    pointers: Any = (ct.c_void_p * _BATCH)()
    infos: Any = (clib.SampleInfo * _BATCH)()
    while True:
        pointers[0] = None
        count = lib.dds_take(reader, pointers, infos, _BATCH, _BATCH)
        if count <= 0:
            return
        try:
            for i in range(count):
                alive = infos[i].valid_data and infos[i].instance_state == ALIVE
                yield struct.from_address(pointers[i]), alive
        finally:
            lib.dds_return_loan(reader, pointers, count)
