"""Session, graph, keys and tokens of a node over Zenoh, which its endpoints use."""

from __future__ import annotations

from collections import OrderedDict
from itertools import count
from typing import TYPE_CHECKING, Any
from weakref import WeakValueDictionary

from sfglab.bus.backend import Backend
from sfglab.bus.errors import BusError
from sfglab.bus.zenoh.graph import ZenohGraph
from sfglab.bus.zenoh.layout import (
    NODE,
    data_key,
    mangled,
    participant_guid,
    qos_text,
    token_kind,
    token_text,
)
from sfglab.bus.zenoh.session import Session
from sfglab.errors import InvalidValueError
from sfglab.names import ros_name_from_dds
from sfglab.qos import SERVICES

if TYPE_CHECKING:
    from sfglab.bus.api import EndpointKind, RawEndpoint
    from sfglab.bus.zenoh.session import ZenohConfig


class ZenohParticipant(Backend):
    """Part of a backend that its endpoints use; `ZenohBackend` opens them.

    Raises:
        MissingExtraError: Zenoh is not installed.
        BusError: Zenoh refuses the configuration, or the process was forked from one with sessions.
    """

    kind = "zenoh"

    def __init__(self, config: ZenohConfig, name: str) -> None:
        super().__init__()
        self.session = Session(config, name)
        self.guid = participant_guid(self.session.id)
        self.graph: ZenohGraph = ZenohGraph(self.bridge, self.session, config.domain_id)
        #: Requests without a reply, with their clients' GIDs, by client and number; the oldest come first.
        self.requests: OrderedDict[tuple[int, int], tuple[Any, bytes]] = OrderedDict()
        #: Readers of replies (`ReplyReader`), by client.
        self.clients: WeakValueDictionary[object, Any] = WeakValueDictionary()
        self._domain_id = config.domain_id
        self._name = name
        self._numbers = count(1)
        self._token: Any = None
        self.session.order(self._declare)

    def participant_of(self, gid: bytes) -> bytes:
        """Return a prefix for the GIDs of one token, which are hashes; it is no prefix of rmw_fastrtps."""
        return b"z" + gid[:-1]

    def key(self, endpoint: RawEndpoint) -> str:
        """Return the key of an endpoint's samples or calls.

        Raises:
            BusError: The topic has no ROS name.
            InvalidValueError: The transport is shared memory.
        """
        if endpoint.transport == "shm":
            place = f"topic {endpoint.name!r}, transport over Zenoh"
            raise InvalidValueError(place, endpoint.transport, "dds")
        type_ = self.graph.wire_type(endpoint.type)
        return data_key(self._domain_id, _ros_name(endpoint), type_)

    def token(self, endpoint: RawEndpoint, kind: EndpointKind) -> str:
        """Return a new token for an endpoint, or for the server or client that it belongs to."""
        own = token_kind(endpoint.dds_topic, kind)
        identity = (self._domain_id, self.session.id, next(self._numbers), own, self._name)
        qos = qos_text(SERVICES if endpoint.is_service else endpoint.qos)
        rest = (mangled(_ros_name(endpoint)), *self.graph.wire_type(endpoint.type), qos)
        return "/".join((token_text(*identity, data=endpoint.user_data), *rest))

    def leave(self) -> None:
        """Close the session."""
        self.session.close()

    def _declare(self, session: Any) -> None:
        token = token_text(self._domain_id, self.session.id, 0, NODE, self._name)
        self._token = session.liveliness().declare_token(token)
        self.graph.receive(token, alive=True)


def _ros_name(endpoint: RawEndpoint) -> str:
    wire = ros_name_from_dds(endpoint.dds_topic)
    if wire is None:
        raise BusError(f"DDS topic {endpoint.dds_topic!r} has no ROS name, which Zenoh's keys need")
    return wire.name
