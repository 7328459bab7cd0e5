"""Reads the domain's participants and endpoints from Cyclone's built-in topics, and ROS 2's nodes from theirs.

Knows the built-in samples, what sfglab and ROS 2 write into USER_DATA, and that endpoints of ROS 2's own
discovery are none of the computation graph. Refuses to know who listens.
"""

from __future__ import annotations

import ctypes as ct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab import names
from sfglab.bus.api import EndpointInfo, EndpointKind, NodeInfo
from sfglab.bus.dds.clib import (
    ALIVE,
    BUILTIN_PARTICIPANT,
    BUILTIN_PUBLICATION,
    BUILTIN_SUBSCRIPTION,
    Endpoint,
    Participant,
    SampleInfo,
    library,
)
from sfglab.bus.dds.endpoints import RawReader
from sfglab.bus.dds.presence import INFO_TOPIC, READER_QOS, gid_bytes, info_type, unpack_nodes
from sfglab.bus.dds.qos import partitions, profile_from_dds, string_property, user_data
from sfglab.bus.userdata import HOST_KEY, NODE_KEY, SHM_PARTITION, entries
from sfglab.messages import TypeNameError, ros_type_name

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sfglab.bus.dds.participant import DdsParticipant
    from sfglab.bus.queue import Sample


_BATCH = 128
_BUILTIN_TYPES = b"org::eclipse::cyclonedds::builtin::"
_KINDS = {BUILTIN_PUBLICATION: EndpointKind.PUBLISHER, BUILTIN_SUBSCRIPTION: EndpointKind.SUBSCRIPTION}

Change = tuple[bytes, EndpointInfo | None]
"""An endpoint's gid and what is known about it, None when it, or the participant of that gid, has gone."""


@dataclass(frozen=True, slots=True)
class _Origin:
    host: str
    node: str


class Discovery:
    """Reports every endpoint of the domain that appears, changes or goes.

    Args:
        participant: Who looks; its end is the reports' end.
        on_changes: Called with changes in their order, in the thread of the participant's waiter.
    """

    def __init__(self, participant: DdsParticipant, on_changes: Callable[[list[Change]], None]) -> None:
        self._participant = participant
        self._on_changes = on_changes
        self._origins: dict[bytes, _Origin] = {}
        lib, waiter = library(), participant.waiter
        self._participants: int = lib.dds_create_reader(participant.handle, BUILTIN_PARTICIPANT, None, None)
        waiter.attach_reader(self._participants, self._read_participants)
        for topic, kind in _KINDS.items():
            reader: int = lib.dds_create_reader(participant.handle, topic, None, None)
            waiter.attach_reader(reader, self._endpoint_handler(reader, kind))

    def read_nodes(self, on_nodes: Callable[[bytes, tuple[NodeInfo, ...]], None]) -> None:
        """Report from now on which nodes every participant has, its complete list at every change.

        Args:
            on_nodes: Called with a participant's GUID and its nodes, in the waiter's thread.
        """
        size = gid_bytes()

        def handle(samples: list[Sample]) -> None:
            # What a participant said may be read after its end, and would then stay for ever.
            self._read_participants()
            for cdr, *_ in samples:
                participant, nodes = unpack_nodes(bytes(cdr), size)
                if participant in self._origins:
                    on_nodes(participant, nodes)

        reader = self._participant.create_reader(INFO_TOPIC, info_type(size), READER_QOS)
        RawReader(
            reader, waiter=self._participant.waiter, on_samples=handle, on_matched=lambda: None
        )  # lives as long as the participant, kept by its waiter

    def _endpoint_handler(self, reader: int, kind: EndpointKind) -> Callable[[], None]:
        def handle() -> None:
            # A participant is always known before its endpoints, but not always read before them.
            self._read_participants()
            found = _take(reader, Endpoint)
            changes = [
                self._change(sample, kind, alive=alive) for sample, alive in found if not _builtin(sample)
            ]
            if changes:
                self._on_changes(changes)

        return handle

    def _read_participants(self) -> None:
        for sample, alive in _take(self._participants, Participant):
            key = bytes(sample.key)
            if not alive:
                self._origins.pop(key, None)
                self._on_changes([(key, None)])
                continue
            known = entries(user_data(sample.qos))
            host = known.get(HOST_KEY) or string_property(sample.qos, "__Hostname")
            self._origins[key] = _Origin(host, known.get(NODE_KEY, ""))

    def _change(self, sample: Any, kind: EndpointKind, *, alive: bool) -> Change:
        gid = bytes(sample.key)
        return gid, self._info(sample, gid, kind) if alive else None

    def _info(self, sample: Any, gid: bytes, kind: EndpointKind) -> EndpointInfo:
        participant = bytes(sample.participant_key)
        origin = self._origins.get(participant, _Origin("", ""))
        dds_topic = sample.topic_name.decode(errors="replace")
        return EndpointInfo(
            kind=kind,
            topic=_ros_topic(dds_topic),
            type=_ros_type(sample.type_name.decode(errors="replace")),
            gid=gid,
            qos=profile_from_dds(sample.qos),
            transport="shm" if SHM_PARTITION in partitions(sample.qos) else "dds",
            participant=participant,
            host=origin.host,
            node=origin.node,
            dds_topic=dds_topic,
            user_data=user_data(sample.qos),
        )


def _builtin(sample: Any) -> bool:
    """Whether this is one of the endpoints by which participants find each other and each other's nodes."""
    return (sample.type_name or b"").startswith(_BUILTIN_TYPES) or sample.topic_name == INFO_TOPIC.encode()


def _ros_topic(dds_topic: str) -> str:
    wire = names.ros_name_from_dds(dds_topic)
    return wire.name if wire is not None and wire.role is names.DdsRole.TOPIC else dds_topic


def _ros_type(dds_type: str) -> str:
    try:
        return ros_type_name(dds_type)
    except TypeNameError:
        return dds_type


def _take(reader: int, struct: type[ct.Structure]) -> Iterator[tuple[Any, bool]]:
    """Yield what a built-in reader holds: the C sample, valid until the next one, and whether it is alive."""
    lib = library()
    pointers: Any = (ct.c_void_p * _BATCH)()
    infos: Any = (SampleInfo * _BATCH)()
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
