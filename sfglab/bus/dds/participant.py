"""One node's participant in a DDS domain, with the WaitSet thread that reads for it."""

from __future__ import annotations

import ctypes as ct
import logging
import threading
from itertools import count
from typing import TYPE_CHECKING, Any, Unpack

from sfglab.bus.dds.clib import ANY_STATE, INFINITY_NS, entity_guid, error_text, library
from sfglab.bus.dds.domain import DomainConfig, join, leave
from sfglab.bus.dds.qos import EndpointOptions, endpoint_qos, qos_object
from sfglab.bus.errors import BusError, DomainError

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.qos import QoSProfile

_log = logging.getLogger(__name__)
_MAX_TRIGGERED = 64
_JOIN_TIMEOUT_S = 5.0


class WaitSetThread:
    """Calls handlers, in its own thread, when DDS entities have something to take.

    A wait set in a thread, because a Python listener on the data path deadlocks with writers that wait for
    acknowledgements while they hold the interpreter lock. The thread holds no reference to its owner, so an
    abandoned owner can be collected and stop it.

    Args:
        participant: The C handle of the participant whose entities are waited for.
        after_round: Called after each round of handlers, in the same thread.
        name: The thread's name.
    """

    def __init__(self, participant: int, after_round: Callable[[], None], *, name: str) -> None:
        lib = library()
        self._set: int = lib.dds_create_waitset(participant)
        self._guard: int = lib.dds_create_guardcondition(participant)
        self._handlers: dict[int, Callable[[], None]] = {}
        self._keys = count(1)
        self._key_of: dict[int, int] = {}
        self._stop = threading.Event()
        lib.dds_waitset_attach(self._set, self._guard, 0)
        arguments = (self._set, self._guard, self._handlers, after_round, self._stop)
        self._thread = threading.Thread(target=_run, args=arguments, name=name, daemon=True)
        self._thread.start()

    def attach_reader(self, reader: int, handler: Callable[[], None]) -> int:
        """Call `handler` whenever `reader` holds samples; return the condition to detach later."""
        condition: int = library().dds_create_readcondition(reader, ANY_STATE)
        self.attach(condition, handler)
        return condition

    def attach(self, entity: int, handler: Callable[[], None]) -> None:
        """Call `handler` whenever an enabled status of `entity` is set."""
        key = self._key_of[entity] = next(self._keys)
        self._handlers[key] = handler
        library().dds_waitset_attach(self._set, entity, key)
        self._wake()

    def detach(self, entity: int) -> None:
        """Stop waiting for an entity; its handler may still be running."""
        library().dds_waitset_detach(self._set, entity)
        self._handlers.pop(self._key_of.pop(entity, 0), None)

    def stop(self) -> None:
        """End the thread and return when it has ended."""
        self._stop.set()
        self._wake()
        if self._thread is not threading.current_thread():
            self._thread.join(_JOIN_TIMEOUT_S)
        self._handlers.clear()

    def _wake(self) -> None:
        library().dds_set_guardcondition(self._guard, True)


def _run(
    waitset: int,
    guard: int,
    handlers: dict[int, Callable[[], None]],
    after_round: Callable[[], None],
    stop: threading.Event,
) -> None:
    lib = library()
    keys: Any = (ct.c_ssize_t * _MAX_TRIGGERED)()
    triggered = ct.c_bool()
    while not stop.is_set():
        ready = lib.dds_waitset_wait(waitset, keys, _MAX_TRIGGERED, INFINITY_NS)
        if ready < 0:
            return  # the participant was deleted under us: nothing is left to wait for
        for i in range(min(ready, _MAX_TRIGGERED)):
            if keys[i] == 0:
                lib.dds_take_guardcondition(guard, ct.byref(triggered))
            elif (handler := handlers.get(keys[i])) is not None:
                _call(handler)
        after_round()


def _call(handler: Callable[[], None]) -> None:
    try:
        handler()
    except Exception:  # noqa: BLE001 - logged; one reader's failure must not stop the thread of all of them
        _log.exception("reading from DDS failed")


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
        self.waitset = WaitSetThread(self.handle, after_round, name=name)
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
        self.waitset.stop()
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
