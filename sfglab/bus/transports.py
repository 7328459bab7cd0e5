"""Opens the transport's side of a publisher or subscription: the one place that knows both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, get_args

from sfglab import names
from sfglab.bus.api import Transport
from sfglab.bus.dds.endpoints import RawReader, RawWriter
from sfglab.bus.errors import BusError
from sfglab.messages import serialize

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.core import Core
    from sfglab.bus.inbox import Inbox
    from sfglab.bus.publisher import Writer
    from sfglab.bus.shm.presence import Presence
    from sfglab.bus.subscription import Reader
    from sfglab.qos import QoSProfile


DEFAULT_MAX_MESSAGE_BYTES = 64 * 2**20
"""An uncompressed 4K image has 25 MB; a cloud of two million points 64 MB."""


class TransportError(BusError, ValueError):
    """A transport that does not exist.

    Attributes:
        transport: What was given.
    """

    def __init__(self, transport: str) -> None:
        self.transport = transport
        super().__init__(f"transport: given {transport!r}, allowed are {', '.join(get_args(Transport))}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """What an endpoint is for: a resolved topic, its type, and the quality of service."""

    topic: str
    type: str
    qos: QoSProfile


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceSide:
    """The server's or a client's side of a service: a writer of one of its topics, a reader of the other."""

    name: str
    type: str
    server: bool
    qos: QoSProfile
    user_data: bytes


class ServiceWriter(Protocol):
    """What one side of a service sends by."""

    @property
    def matched_prefixes(self) -> frozenset[bytes]:
        """The GUID prefixes of the participants whose readers match now."""

    def write(self, cdr: bytes) -> None:
        """Send a frame."""

    def close(self) -> None:
        """Release everything."""


class ServiceReader(Protocol):
    """What one side of a service receives by."""

    @property
    def matched_prefixes(self) -> frozenset[bytes]:
        """The GUID prefixes of the participants whose writers match now."""

    def close(self) -> None:
        """Release everything."""


class _DdsWriter(RawWriter):
    def write_message(self, message: Any) -> None:
        self.write(serialize(message))


def open_writer(
    core: Core, target: Target, transport: Transport, *, notify: Callable[[], None], max_message_bytes: int
) -> Writer:
    """Return the sending side of a new publisher; `notify` is called when its subscriptions change."""
    check_transport(transport)
    if transport == "shm":
        from sfglab.bus.shm.writer import ShmWriter

        presence = _presence(core, target, writer=True)
        return ShmWriter(
            core.bridge,
            presence,
            target.qos,
            max_message_bytes=max_message_bytes,
            notify=_flushed(core, notify),
        )
    from sfglab.messages.dds import idl_struct

    handle = core.participant.create_writer(names.dds_topic(target.topic), idl_struct(target.type), target.qos)
    waiter = core.participant.waiter
    return _DdsWriter(handle, target.topic, type_=target.type, waiter=waiter, on_matched=notify)


def open_reader(
    core: Core, target: Target, transport: Transport, *, notify: Callable[[], None], inbox: Inbox
) -> Reader:
    """Return the receiving side of a new subscription, which pushes into `inbox`."""
    check_transport(transport)
    if transport == "shm":
        from sfglab.bus.shm.reader import ShmReader

        presence = _presence(core, target, writer=False)
        return ShmReader(core.bridge, presence, target.qos, inbox=inbox, notify=_flushed(core, notify))
    from sfglab.messages.dds import idl_struct

    handle = core.participant.create_reader(names.dds_topic(target.topic), idl_struct(target.type), target.qos)
    waiter = core.participant.waiter
    return RawReader(handle, waiter=waiter, on_samples=inbox.push_from_thread, on_matched=notify)


def open_service_side(
    core: Core, side: ServiceSide, *, inbox: Inbox, notify: Callable[[], None]
) -> tuple[ServiceWriter, ServiceReader]:
    """Return the DDS writer and reader of one side of a service; `notify` is called when its peers change."""
    from sfglab.messages.dds import service_idl_struct

    idl = dict(zip(names.dds_service(side.name), service_idl_struct(side.type), strict=True))
    request, reply = idl
    out, in_ = (reply, request) if side.server else (request, reply)
    participant = core.participant
    writer = RawWriter(
        participant.create_writer(out, idl[out], side.qos, user_data=side.user_data),
        side.name,
        type_=side.type,
        waiter=participant.waiter,
        on_matched=notify,
    )
    reader = RawReader(
        participant.create_reader(in_, idl[in_], side.qos, user_data=side.user_data),
        waiter=participant.waiter,
        on_samples=inbox.push_from_thread,
        on_matched=notify,
    )
    return writer, reader


def check_transport(transport: str) -> None:
    """Refuse a transport that does not exist.

    Raises:
        TransportError: It does not.
    """
    if transport not in get_args(Transport):
        raise TransportError(transport)


def _presence(core: Core, target: Target, *, writer: bool) -> Presence:
    from sfglab.bus.shm.presence import Presence

    return Presence(
        core.participant, core.graph, topic=(target.topic, target.type), qos=target.qos, writer=writer
    )


def _flushed(core: Core, notify: Callable[[], None]) -> Callable[[], None]:
    """Let a notice of the loop itself through at once; only the waiter's thread flushes by itself."""

    def both() -> None:
        notify()
        core.bridge.flush()

    return both
