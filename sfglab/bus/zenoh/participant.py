"""Participant of a domain over Zenoh: the session of one node, its graph and its tokens."""

from __future__ import annotations

from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import FAST_DDS, host_id
from sfglab.bus.errors import BusError
from sfglab.bus.loop import nothing
from sfglab.bus.zenoh.graph import ZenohGraph
from sfglab.bus.zenoh.layout import (
    NODE,
    data_key,
    enclave_text,
    gid_of,
    mangled,
    participant_guid,
    qos_text,
    token_text,
)
from sfglab.bus.zenoh.session import Session
from sfglab.names import ros_name_from_dds
from sfglab.qos import SERVICES

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.api import RawEndpoint
    from sfglab.bus.loop import LoopBridge
    from sfglab.bus.zenoh.session import ZenohConfig


class ZenohParticipant:
    """Participant with one node, given by its full name, on the loop of a bridge."""

    def __init__(self, config: ZenohConfig, name: str, bridge: LoopBridge) -> None:
        self.session = Session(config, name)
        self.guid = participant_guid(self.session.id)  #: 16-byte GUID.
        self.graph = ZenohGraph(bridge, self.session, config.domain_id)
        self.bridge = bridge
        self._domain_id = config.domain_id
        self._name = name
        self._host = host_id()
        self._numbers = count(1)
        self._token = token_text(config.domain_id, self.session.id, 0, NODE, name)
        self._declared: Any = None
        self.session.order(self._declare)

    def key(self, endpoint: RawEndpoint) -> str:
        """Return the key of an endpoint's samples or calls."""
        type_ = self.graph.wire_type(endpoint.type)
        return data_key(self._domain_id, _ros_name(endpoint), type_)

    def token(self, endpoint: RawEndpoint, kind: str) -> str:
        """Return a new token of a kind for an endpoint, or for the server or client that it belongs to."""
        qos = qos_text(SERVICES if endpoint.is_service else endpoint.qos)
        rest = (mangled(_ros_name(endpoint)), *self.graph.wire_type(endpoint.type), qos)
        enclave = enclave_text(self._host, endpoint.user_data)
        identity = (self._domain_id, self.session.id, next(self._numbers), kind, self._name)
        token = "/".join((token_text(*identity, enclave=enclave), *rest))
        # Clients tell servers of rmw_fastrtps by the beginning of their GID.
        is_misleading = gid_of(token).startswith(FAST_DDS)
        return self.token(endpoint, kind) if is_misleading else token

    def _declare(self, session: Any) -> None:
        self._declared = session.liveliness().declare_token(self._token)
        self.graph.receive(self._token, alive=True)


class Announcement:
    """Entity of Zenoh, such as a publisher, and the token of a kind that announces it.

    `declare` is called with the open Zenoh session and returns the entity, or None if there is none.
    """

    def __init__(
        self,
        participant: ZenohParticipant,
        endpoint: RawEndpoint,
        kind: str,
        declare: Callable[[Any], Any],
    ) -> None:
        self.key = participant.key(endpoint)  #: Key of the samples or calls.
        self._token = participant.token(endpoint, kind)
        self.gid = gid_of(self._token)  #: 16-byte GID of the token.
        self._session = participant.session
        self._graph = participant.graph
        self._declare = declare
        self._declared: list[Any] = []

    def open(self) -> None:
        """Declare the entity."""
        self._session.order(self._open)

    def show(self, then: Callable[[], None] = nothing) -> None:
        """Declare the token, and call `then`; the entity comes first because peers may send to it at once."""
        self._session.order(partial(self._show, then))

    def close(self) -> None:
        """Undeclare the token and the entity."""
        self._session.order(self._close)

    def _open(self, session: Any) -> None:
        self._declared.append(self._declare(session))

    def _show(self, then: Callable[[], None], session: Any) -> None:
        if self._declared:
            self._declared.append(session.liveliness().declare_token(self._token))
            self._graph.receive(self._token, alive=True)
            then()

    def _close(self, _: Any) -> None:
        while self._declared:
            if (entity := self._declared.pop()) is not None:
                entity.undeclare()
        self._graph.receive(self._token, alive=False)


def _ros_name(endpoint: RawEndpoint) -> str:
    wire = ros_name_from_dds(endpoint.dds_topic)
    if wire is None:
        raise BusError(f"DDS topic {endpoint.dds_topic!r} has no ROS name, which Zenoh's keys need")
    return wire.name
