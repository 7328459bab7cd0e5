"""How a shared-memory endpoint shows itself in the DDS graph.

A real writer or reader of the topic, with its real type and QoS but in a partition of its own, where nothing
is ever written: discovery, leases and the graph work as for every other endpoint.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab import names
from sfglab.bus.dds.clib import library
from sfglab.bus.dds.endpoints import entity_guid
from sfglab.bus.shm import sockets
from sfglab.bus.userdata import SHM_KEY, SHM_PARTITION, user_data

if TYPE_CHECKING:
    from sfglab.bus.dds.participant import DdsParticipant
    from sfglab.bus.graph import Graph
    from sfglab.qos import QoSProfile


class Presence:
    """The DDS side of one shared-memory endpoint.

    Args:
        participant: Whose endpoint it is.
        graph: What others show.
        topic: The ROS topic.
        type_: The ROS type.
        qos: What is offered or requested.
        writer: Whether this is a publisher, which has an address to connect to.
    """

    def __init__(
        self,
        participant: DdsParticipant,
        graph: Graph,
        *,
        topic: tuple[str, str],
        qos: QoSProfile,
        writer: bool,
    ) -> None:
        self.graph = graph
        self.topic, self.type = topic
        self.address = sockets.address(participant.config.domain_id) if writer else ""
        self._participant = participant
        self._qos = qos
        self._writer = writer
        self._handle: int | None = None

    def announce(self) -> bytes:
        """Become visible; return the endpoint's GUID."""
        from sfglab.messages.dds import idl_struct

        create = self._participant.create_writer if self._writer else self._participant.create_reader
        self._handle = create(
            names.dds_topic(self.topic),
            idl_struct(self.type),
            self._qos,
            user_data=user_data({SHM_KEY: self.address}),
            partition=SHM_PARTITION,
        )
        return entity_guid(self._handle)

    def close(self) -> None:
        """Vanish from the graph; again is harmless."""
        if self._handle is not None:
            library().dds_delete(self._handle)
            self._handle = None
