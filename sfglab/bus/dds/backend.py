"""Backend of a live node, for DDS and shared memory: a participant, its graph, endpoints and forwarders."""

from __future__ import annotations

import secrets
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import (
    FAST_DDS,
    HOST_KEY,
    NODE_KEY,
    SHM_KEY,
    SHM_PARTITION,
    RawEndpoint,
    host_id,
    user_data,
)
from sfglab.bus.backend import Backend
from sfglab.bus.dds.discovery import Discovery, DiscoveryInfo
from sfglab.bus.dds.domain import DdsParticipant, DomainConfig
from sfglab.bus.dds.endpoints import DdsReader, DdsWriter, ShmAnnouncement, idl_type
from sfglab.bus.graph import Graph
from sfglab.bus.loop import WatchThread
from sfglab.bus.ros.services import RosServices
from sfglab.qos import History

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.endpoints import Inbox, Reader, Sample, Writer


class DdsBackend(Backend):
    """Backend with a participant of a DDS domain.

    Raises:
        DomainError: The domain cannot be joined.
    """

    kind = "live"

    def __init__(self, config: DomainConfig, name: str) -> None:
        super().__init__()
        self.graph = Graph(self.loop, read_nodes=self._read_nodes)
        shown = user_data({"enclave": "/", NODE_KEY: name, HOST_KEY: host_id()})
        self._thread_name = f"sfglab {name}"
        self._watcher: WatchThread | None = None
        self.participant = DdsParticipant(
            config, shown, name=self._thread_name, after_round=self.bridge.flush
        )
        self.guid = self.participant.guid
        self._config = config
        self._discovery = Discovery(self.participant, partial(self._post, self.graph.apply))
        self.register(DiscoveryInfo(self.participant, self.graph, name, loop=self.loop).close)

    @cached_property
    def ros(self) -> RosServices:
        """Services of rmw_fastrtps in the node's domain."""
        return RosServices(self.calls, self._config.wire_id, self._config.interface)

    def open_writer(self, endpoint: RawEndpoint, notify: Callable[[], None]) -> Writer:
        """Return a new writer over DDS, shared memory or ROS 2's program."""
        if endpoint.transport == "shm":
            from sfglab.bus.shm.writer import ShmWriter

            address = f"sfglab/{self.participant.config.domain_id}/{secrets.token_hex(8)}"
            announce = partial(self._announce, endpoint, address, writer=True)
            return ShmWriter(
                self.bridge, endpoint, address=address, announce=announce, notify=notify
            )
        if endpoint.transport == "ros":
            return self.ros.open(endpoint, notify, None)
        handle = self._create(self.participant.create_writer, endpoint)
        writer = DdsWriter(
            handle,
            endpoint.name,
            type_=endpoint.type,
            waitset=self.participant.waitset,
            on_matched=partial(self._post, notify),
        )
        writer.may_block = endpoint.qos.history is History.KEEP_ALL
        return writer

    def open_reader(
        self, endpoint: RawEndpoint, notify: Callable[[], None], inbox: Inbox
    ) -> Reader:
        """Return a new reader over the endpoint's transport: DDS, shared memory or ROS 2's program."""
        if endpoint.transport == "shm":
            from sfglab.bus.shm.reader import ShmReader

            announce = partial(self._announce, endpoint, "", writer=False)
            watcher = self._receiver() if endpoint.threaded else self.bridge
            shared = ShmReader(watcher, endpoint, announce=announce, inbox=inbox, notify=notify)
            shared.follow(self.graph)
            return shared
        if endpoint.transport == "ros":
            return self.ros.open(endpoint, notify, inbox)
        handle = self._create(self.participant.create_reader, endpoint)
        options: dict[str, Any] = {"waitset": self.participant.waitset}
        if endpoint.threaded:
            # Samples are taken one at a time, so that Cyclone applies KEEP_LAST while a callback is slow.
            options = {"waitset": self.participant.callbacks, "batch": 1}
        reader = DdsReader(
            handle,
            **options,
            on_samples=partial(_push_framed, inbox)
            if endpoint.is_service
            else inbox.push_from_thread,
            on_matched=partial(self._post, notify),
        )
        if endpoint.forwards:
            reader.watch_life(partial(self._post, inbox.on_life))
        return reader

    def open_forwarder(self, target: DdsBackend) -> Any:
        """Return a forwarder that works inside Cyclone DDS."""
        from sfglab.bus.dds.forwarder import DdsForwarder

        forwarder = DdsForwarder(self.participant, target.participant, (self, target))
        self.register(forwarder.close)
        return forwarder

    def close(self) -> None:
        """Stop the reading threads, then close everything; callable from any thread and repeatedly."""
        if not self.closed:
            self.participant.stop()
        super().close()

    def leave(self) -> None:
        """Stop the thread of shared memory and leave the domain."""
        if self._watcher is not None:
            self._watcher.stop()
        self.participant.close()

    def _receiver(self) -> WatchThread:
        """Return the thread that receives from shared memory; the first call starts it."""
        self._watcher = self._watcher or WatchThread(self.bridge, f"{self._thread_name} receiver")
        return self._watcher

    def _create(self, create: Callable[..., int], endpoint: RawEndpoint) -> int:
        """Return the handle of a new reader or writer; a forwarding one accepts unknown types as well."""
        from sfglab.bus.dds.forwarder import wire_type

        type_ = (wire_type if endpoint.forwards else idl_type)(endpoint)
        options = {"user_data": endpoint.user_data, "ignore_local": endpoint.forwards}
        return create(endpoint.dds_topic, type_, endpoint.qos, **options)

    def _post(self, function: Callable[..., None], *values: Any) -> None:
        self.bridge.post(partial(function, *values))

    def _read_nodes(self) -> None:
        if not self.closed:
            self._discovery.read_nodes(partial(self._post, self.graph.learn_nodes))

    def _announce(self, endpoint: RawEndpoint, address: str, *, writer: bool) -> ShmAnnouncement:
        """Announce a shared-memory endpoint; the address is a publisher's, and empty for a subscription."""
        create = self.participant.create_writer if writer else self.participant.create_reader
        handle = create(
            endpoint.dds_topic,
            idl_type(endpoint),
            endpoint.qos,
            user_data=user_data({SHM_KEY: address}),
            partition=SHM_PARTITION,
        )
        return ShmAnnouncement(handle)


def _push_framed(inbox: Inbox, samples: list[Sample]) -> None:
    """Queue samples with a frame; samples of Fast DDS on a service's topic have none and are dropped."""
    inbox.push_from_thread([sample for sample in samples if not sample[3].startswith(FAST_DDS)])
