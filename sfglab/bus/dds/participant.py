"""One node's participant in a DDS domain, with the thread that reads for it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.bus.dds.clib import error_text, library
from sfglab.bus.dds.domain import join, leave
from sfglab.bus.dds.endpoints import entity_guid
from sfglab.bus.dds.qos import endpoint_qos, qos_object
from sfglab.bus.dds.waiter import Waiter
from sfglab.bus.errors import BusError, DomainError

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Unpack

    from sfglab.bus.dds.config import DomainConfig
    from sfglab.bus.dds.qos import EndpointOptions
    from sfglab.qos import QoSProfile


class DdsParticipant:
    """Joins a domain and creates raw readers and writers there.

    Args:
        config: The domain and how to join it.
        user_data: The participant's USER_DATA.
        name: The name of the reading thread.
        after_round: Called after each round of reading, in that thread.

    Raises:
        DomainError: The domain cannot be joined so.
    """

    def __init__(
        self, config: DomainConfig, user_data: bytes, *, name: str, after_round: Callable[[], None]
    ) -> None:
        self.config = config
        join(config)
        try:
            self.handle = self._create(user_data)
        except BaseException:
            leave(config.domain_id)
            raise
        self.guid = entity_guid(self.handle)
        self.waiter = Waiter(self.handle, after_round, name=name)
        self._topics: dict[tuple[str, type[Any]], int] = {}
        self._closed = False

    def create_writer(
        self, topic: str, idl_type: type[Any], qos: QoSProfile, **more: Unpack[EndpointOptions]
    ) -> int:
        """Return the C handle of a new writer of a DDS topic."""
        with endpoint_qos(qos, **more) as c_qos:
            handle = library().dds_create_writer(self.handle, self._topic(topic, idl_type), c_qos, None)
        return _checked(handle, f"a writer of {topic!r}")

    def create_reader(
        self, topic: str, idl_type: type[Any], qos: QoSProfile, **more: Unpack[EndpointOptions]
    ) -> int:
        """Return the C handle of a new reader of a DDS topic."""
        with endpoint_qos(qos, **more) as c_qos:
            handle = library().dds_create_reader(self.handle, self._topic(topic, idl_type), c_qos, None)
        return _checked(handle, f"a reader of {topic!r}")

    def close(self) -> None:
        """Stop the thread, delete all entities and leave the domain; again is harmless."""
        if self._closed:
            return
        self._closed = True
        self.waiter.stop()
        library().dds_delete(self.handle)
        leave(self.config.domain_id)

    def _create(self, user_data: bytes) -> int:
        with qos_object(user_data) as qos:
            handle: int = library().dds_create_participant(self.config.domain_id, qos, None)
        if handle < 0:
            raise DomainError(self.config.domain_id, f"no participant can be created: {error_text(handle)}")
        return handle

    def _topic(self, name: str, idl_type: type[Any]) -> int:
        key = (name, idl_type)
        if key not in self._topics:
            self._topics[key] = _checked(_create_topic(self.handle, name, idl_type), f"topic {name!r}")
        return self._topics[key]


def _create_topic(participant: int, name: str, idl_type: Any) -> int:
    from cyclonedds._clayer import ddspy_topic_create

    idl_type.__idl__.populate()
    idl_type.__idl__.fill_type_data()
    handle: int = ddspy_topic_create(participant, name, idl_type, None, None)
    return handle


def _checked(handle: int, what: str) -> int:
    if handle < 0:
        raise BusError(f"Cyclone DDS cannot create {what}: {error_text(handle)}")
    return handle
