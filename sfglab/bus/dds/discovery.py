"""Reads the domain's participants and endpoints from Cyclone's built-in topics.

Knows the built-in samples and what sfglab and ROS 2 write into USER_DATA. Refuses to know who listens.
"""

from __future__ import annotations

import ctypes as ct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab import names
from sfglab.bus.api import EndpointInfo, EndpointKind
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
from sfglab.bus.dds.qos import partitions, profile_from_dds, string_property, user_data
from sfglab.bus.userdata import HOST_KEY, NODE_KEY, SHM_PARTITION, entries
from sfglab.messages import TypeNameError, ros_type_name

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sfglab.bus.dds.waiter import Waiter

__all__ = ["Change", "Discovery"]

_BATCH = 128
_BUILTIN_TYPES = b"org::eclipse::cyclonedds::builtin::"
_KINDS = {BUILTIN_PUBLICATION: EndpointKind.PUBLISHER, BUILTIN_SUBSCRIPTION: EndpointKind.SUBSCRIPTION}

Change = tuple[bytes, EndpointInfo | None]
"""An endpoint's gid and what is known about it, None when it has gone."""


@dataclass(frozen=True, slots=True)
class _Origin:
    host: str
    node: str


class Discovery:
    """Reports every endpoint of the domain that appears, changes or goes.

    Args:
        participant: The C handle of the participant.
        waiter: Waits for the built-in topics.
        on_changes: Called with changes in their order, in the waiter's thread.
    """

    def __init__(self, participant: int, waiter: Waiter, on_changes: Callable[[list[Change]], None]) -> None:
        self._on_changes = on_changes
        self._origins: dict[bytes, _Origin] = {}
        lib = library()
        self._participants: int = lib.dds_create_reader(participant, BUILTIN_PARTICIPANT, None, None)
        waiter.attach_reader(self._participants, self._read_participants)
        for topic, kind in _KINDS.items():
            reader: int = lib.dds_create_reader(participant, topic, None, None)
            waiter.attach_reader(reader, self._endpoint_handler(reader, kind))

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
    """Whether this is one of the built-in readers that every participant has to find the others."""
    return (sample.type_name or b"").startswith(_BUILTIN_TYPES)


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
