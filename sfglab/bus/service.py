"""Services over DDS as rmw_cyclonedds frames them: a request topic, a reply topic, and a frame with the client.

rmw_fastrtps sends the bare request and reply and correlates them by the inline QoS `related_sample_identity`,
which Cyclone's API neither sets nor shows. Both announce the same type name; their GUIDs tell them apart.
Services of rmw_fastrtps have the transport "ros": a program in ROS 2's own interpreter handles the same frames
(`sfglab.bus.ros`).
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab import names
from sfglab.bus.api import FAST_DDS, Handler, RawEndpoint, Transport, user_data
from sfglab.bus.endpoints import Inbox, Sample
from sfglab.bus.errors import BusTimeoutError, ClosedError, discovery_timeout_error
from sfglab.bus.loop import Signal, awaited
from sfglab.bus.pubsub import checked_type
from sfglab.errors import InvalidValueError
from sfglab.messages import (
    ServiceFrame,
    deserialize,
    frame_service,
    serialize,
    service_type,
    type_name,
    unframe_service,
)
from sfglab.qos import SERVICES, History, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from sfglab.bus.backend import Backend

# ROS 2 uses the profile's depth of 10. KEEP_ALL is used here, so that no call of a burst is lost.
_QOS = QoSProfile(history=History.KEEP_ALL, reliability=SERVICES.reliability)
# With KEEP_ALL, replies would wait for the acknowledgements of all clients. One killed or malicious client
# would then stop the replies to all others.
_ANSWERS = QoSProfile(depth=100, reliability=SERVICES.reliability)
# Longest wait of a server, s, before it replies to a client whose reply reader it has not discovered yet.
_CLIENT_TIMEOUT_S = 1.0


class _ServiceEnd:
    """Server or client of a service: a writer, a reader, and the frames that arrive."""

    def __init__(
        self, backend: Backend, type_: str, *, name: str, transport: Transport, is_server: bool
    ) -> None:
        self.service_name = name  #: Fully resolved ROS service.
        self._backend = backend
        self._transport = transport
        self._changed = Signal(backend.loop)
        self._calls = backend.calls(f"{'service' if is_server else 'client'} {name!r}")
        key = "serviceid" if is_server else "clientid"
        identity = user_data({key: backend.random_bytes(16).hex(".")})
        endpoint = partial(RawEndpoint, user_data=identity, name=name, transport=transport)
        request_topic, reply_topic = names.dds_service(name)
        answers = _ANSWERS if is_server else _QOS
        request = endpoint(dds_topic=request_topic, type=f"{type_}_Request", qos=_QOS)
        reply = endpoint(dds_topic=reply_topic, type=f"{type_}_Response", qos=answers)
        read, written = (request, reply) if is_server else (reply, request)
        self._inbox = Inbox(
            backend.bridge, _QOS, decode=_framed, callback=self._on_sample, calls=self._calls
        )
        self._writer = backend.open_writer(written, self._changed.notify)
        self._reader = backend.open_reader(read, self._changed.notify, self._inbox)
        backend.register(self._end)

    def close(self) -> None:
        """Close the end and let its pending calls fail; repeated calls are harmless."""
        self._backend.end(self._end)

    def _end(self) -> None:
        self._reader.close()
        self._writer.close()
        self._inbox.close()

    def _on_sample(self, sample: tuple[ServiceFrame, bytes]) -> None:
        """Handle a frame and the GID of its publisher."""
        raise NotImplementedError

    def _send(self, frame: ServiceFrame) -> None:
        self._writer.write(frame_service(frame))


def _framed(sample: Sample) -> tuple[ServiceFrame, bytes]:
    return unframe_service(bytes(sample[0])), sample[3]


class Service(_ServiceEnd):
    """Server of a service; made by `Node.create_service`.

    Requests are handled concurrently, in the order of their arrival. An exception of the handler is reported,
    and no response is sent. `answered`, for actions, receives each request after its response is sent.
    """

    def __init__(  # noqa: PLR0913 - the parts of a service, and one argument that only actions need
        self,
        backend: Backend,
        type_: str,
        *,
        name: str,
        handler: Handler,
        transport: Transport = "dds",
        answered: Callable[[Any], None] | None = None,
    ) -> None:
        service = service_type(type_)
        self._request = service.request
        self._response = type_name(service.response)
        self._handler = handler
        self._answered = answered
        super().__init__(backend, type_, name=name, transport=transport, is_server=True)

    def _on_sample(self, sample: tuple[ServiceFrame, bytes]) -> None:
        self._calls.spawn(self._answer(*sample))

    async def _answer(self, frame: ServiceFrame, publisher_gid: bytes) -> None:
        request = deserialize(frame.cdr, self._request)
        response = await awaited(self._handler(request))
        checked_type(response, type_=self._response, where=self.service_name)
        prefix = self._backend.participant_of(publisher_gid)
        # A client may discover the server first. A response that is sent before the server discovers it is
        # lost.
        await self._changed.wait_until(
            lambda: prefix in self._writer.matched_prefixes, _CLIENT_TIMEOUT_S
        )
        self._send(frame._replace(cdr=serialize(response)))
        if self._answered is not None:
            self._answered(request)


class Client(_ServiceEnd):
    """Client of a service; made by `Node.create_client`. Calls may run concurrently."""

    def __init__(
        self, backend: Backend, type_: str, *, name: str, transport: Transport = "dds"
    ) -> None:
        service = service_type(type_)
        self._request_type = type_name(service.request)
        self._response = service.response
        self._guid = int.from_bytes(backend.random_bytes(8), "little")
        self._sequence = 0
        self._pending: dict[int, asyncio.Future[ServiceFrame]] = {}
        super().__init__(backend, type_, name=name, transport=transport, is_server=False)

    def service_is_ready(self) -> bool:
        """Return whether a server can be called now."""
        return any(self._frames_as_we_do(server) for server in self._servers())

    def _servers(self) -> frozenset[bytes]:
        """Return the GUID prefixes of the participants with both endpoints of a server."""
        return self._writer.matched_prefixes & self._reader.matched_prefixes

    def _frames_as_we_do(self, server: bytes) -> bool:
        return server.startswith(FAST_DDS) == (self._transport == "ros")

    async def wait_for_service(self, timeout_s: float = 5.0) -> None:
        """Return once a server can be called.

        Raises:
            BusTimeoutError: No server was found within `timeout_s`.
        """
        if not await self._changed.wait_until(self.service_is_ready, timeout_s):
            raise discovery_timeout_error(f"service {self.service_name!r}: a server", timeout_s)

    async def wait_until_gone(self) -> None:
        """Return once no server can be called; at once if there is none."""
        await self._changed.wait_until(lambda: not self.service_is_ready(), None)

    async def call(
        self, request: Any, timeout_s: float | None = 5.0, *, max_bytes: int | None = None
    ) -> Any:
        """Call the server, and return its response of at most `max_bytes`.

        The time-out, in seconds, covers finding a server and its response together; None waits indefinitely.

        Raises:
            InvalidValueError: The response is larger than `max_bytes`.
            BusTimeoutError: No server was found, or it did not respond in time: it left, is slow, or its
                handler failed.
            InvalidMessageError: The request has another type.
            ClosedError: The client is closed, or was closed during the call.
        """
        name = self.service_name
        said = f"service {name!r}: no answer within {timeout_s or 0.0} s"
        if self._inbox.closed or self._backend.closed:
            raise ClosedError(f"client {name!r}")
        checked_type(request, type_=self._request_type, where=name)
        start_s = self._backend.loop.time()
        if not await self._changed.wait_until(self.service_is_ready, timeout_s):
            reason = "no server was found; check its name, type and domain id"
            if self._servers():
                reason = "only a server of rmw_fastrtps was found; use transport='ros'"
            raise BusTimeoutError(f"{said} ({reason})")
        remaining_s = timeout_s and timeout_s - (self._backend.loop.time() - start_s)
        try:
            async with asyncio.timeout(remaining_s):
                frame = await self._exchange(serialize(request))
        except TimeoutError as error:
            reason = (
                "the server did not respond; wait longer or check its log"
                if self.service_is_ready()
                else "the server disappeared; call it again"
            )
            raise BusTimeoutError(f"{said} ({reason})") from error
        if max_bytes is not None and len(frame.cdr) > max_bytes:
            raise InvalidValueError(
                f"response of {name!r}", f"{len(frame.cdr)} bytes", f"up to {max_bytes} bytes"
            )
        return deserialize(frame.cdr, self._response)

    def _end(self) -> None:
        super()._end()
        if self._backend.loop.is_closed():
            return
        for future in list(self._pending.values()):
            if not future.done():
                future.set_exception(ClosedError(f"client {self.service_name!r}"))

    def _on_sample(self, sample: tuple[ServiceFrame, bytes]) -> None:
        """Give a reply to its waiting call; replies to other clients share the topic and are ignored."""
        frame, _ = sample
        future = self._pending.get(frame.sequence) if frame.client_guid == self._guid else None
        if future is not None and not future.done():
            future.set_result(frame)

    def _exchange(self, cdr: bytes) -> Awaitable[ServiceFrame]:
        self._sequence += 1
        sequence = self._sequence
        future: asyncio.Future[ServiceFrame] = self._backend.loop.create_future()
        self._pending[sequence] = future
        future.add_done_callback(lambda _: self._pending.pop(sequence, None))
        self._send(ServiceFrame(self._guid, sequence, cdr))
        return future
