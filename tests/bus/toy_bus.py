"""A third backend: queues in one process, no DDS, no simulation; components run on it without a change."""

import secrets
from collections import deque
from contextlib import contextmanager
from functools import partial

from sfglab import bus
from sfglab.bus.api import EndpointInfo, EndpointKind, ros_topic
from sfglab.bus.backend import Backend
from sfglab.bus.errors import check_size, not_cdr_error
from sfglab.bus.graph import Graph
from sfglab.messages import CdrError, decoder, serialize
from sfglab.qos import Durability, History, incompatibilities


class ToyDomain:
    """Who takes part, and all endpoints."""

    def __init__(self):
        self.backends, self.endpoints = [], []

    def node(self, name, *, kind=None, **options):
        return bus.Node(name, join=partial(kind or ToyBackend, self), **options)

    def tell(self, endpoint, info):
        for backend in self.backends:
            backend.bridge.post(partial(backend.graph.apply, [(endpoint.gid, info)]))
            backend.bridge.flush()


class ToyBackend(Backend):
    kind = "toy"

    def __init__(self, domain, name, on_error):
        super().__init__(on_error)
        self.domain, self.name = domain, name
        self.graph = Graph(self.loop)
        self.guid = secrets.token_bytes(16)
        self.graph.apply([(e.gid, e.info) for e in domain.endpoints])
        domain.backends.append(self)

    def open_writer(self, endpoint, notify):
        return ToyWriter(self, endpoint, notify).opened()

    def open_reader(self, endpoint, notify, inbox):
        return ToyReader(self, endpoint, notify, inbox).opened()

    def leave(self):
        self.domain.backends.remove(self)


class ToyEndpoint:
    """What matches is told at once; the others' graphs by their loops."""

    kind: EndpointKind

    def __init__(self, backend, endpoint, notify):
        self.backend, self.asked, self.notify = backend, endpoint, notify
        self.gid = backend.guid[:12] + secrets.token_bytes(4)
        self.peers = []
        self.info = EndpointInfo(
            kind=self.kind,
            topic=ros_topic(endpoint.dds_topic),
            type=endpoint.type,
            gid=self.gid,
            qos=endpoint.qos,
            transport=endpoint.transport,
            participant=backend.guid,
            host="here",
            node=backend.name,
            dds_topic=endpoint.dds_topic,
            user_data=endpoint.user_data,
        )

    @property
    def matched(self):
        return len(self.peers)

    @property
    def matched_prefixes(self):
        return frozenset(peer.gid[:12] for peer in self.peers)

    def opened(self):
        others = list(self.backend.domain.endpoints)
        self.backend.domain.endpoints.append(self)
        self.backend.domain.tell(self, self.info)
        for other in others:
            writer, reader = (self, other) if self.kind is EndpointKind.PUBLISHER else (other, self)
            if self.kind is not other.kind and writer.suits(reader):
                for one, peer in ((reader, writer), (writer, reader)):
                    one.peers.append(peer)
                    one.backend.loop.call_soon(one.notify)
                reader.inbox.on_life(writer.gid, True)
                writer.greet(reader)
        return self

    def close(self):
        if self in self.backend.domain.endpoints:
            self.backend.domain.endpoints.remove(self)
            self.backend.domain.tell(self, None)
            for peer in self.peers:
                peer.peers.remove(self)
                if self.kind is EndpointKind.PUBLISHER:
                    peer.inbox.on_life(self.gid, False)
                peer.backend.loop.call_soon(peer.notify)
            self.peers.clear()


class ToyReader(ToyEndpoint):
    kind = EndpointKind.SUBSCRIPTION
    lost = 0

    def __init__(self, backend, endpoint, notify, inbox):
        super().__init__(backend, endpoint, notify)
        self.inbox = inbox

    def take(self, cdr, stamp_ns, gid):
        """Queue a sample as a thread of a middleware would."""
        self.inbox.push_from_thread([(cdr, stamp_ns, self.backend.clock.now_ns(), gid)])
        self.backend.bridge.flush()


class ToyWriter(ToyEndpoint):
    kind = EndpointKind.PUBLISHER

    def __init__(self, backend, endpoint, notify):
        super().__init__(backend, endpoint, notify)
        qos, plain = endpoint.qos, not (endpoint.is_service or endpoint.forwards)
        self.check = decoder(endpoint.type) if plain and endpoint.transport == "dds" else None
        depth = qos.depth if qos.history is History.KEEP_LAST else None
        self.kept = deque(maxlen=depth if qos.durability is Durability.TRANSIENT_LOCAL else 0)

    def suits(self, reader):
        wanted, offered = reader.asked, self.asked
        return (
            (wanted.dds_topic, wanted.type, wanted.transport)
            == (offered.dds_topic, offered.type, offered.transport)
            and not incompatibilities(offered=offered.qos, requested=wanted.qos)
            and not (self.backend is reader.backend and (wanted.forwards or offered.forwards))
        )

    def greet(self, reader):
        if reader.asked.qos.durability is Durability.TRANSIENT_LOCAL:
            for cdr, stamp_ns in self.kept:
                reader.backend.loop.call_soon(reader.take, cdr, stamp_ns, self.gid)

    def write(self, cdr, source_timestamp_ns=None):
        data, limit = bytes(cdr), self.asked.max_message_bytes
        if self.asked.transport == "shm":
            check_size(self.asked.name, len(data), limit)
        try:
            if self.check is not None:
                self.check(data)
        except CdrError as error:
            name, type_ = self.asked.name, self.asked.type
            raise not_cdr_error(name, type_, size_bytes=len(data), reason=error.reason) from error
        stamp_ns = (
            self.backend.clock.now_ns() if source_timestamp_ns is None else source_timestamp_ns
        )
        self.kept.append((data, stamp_ns))
        for reader in self.peers:
            reader.backend.loop.call_soon(reader.take, data, stamp_ns, self.gid)

    def write_message(self, message):
        self.write(serialize(message))

    @contextmanager
    def loan(self, size_bytes):
        if self.asked.transport != "shm":
            raise TypeError("nothing to lend")
        memory = bytearray(size_bytes)
        yield memoryview(memory)
        self.write(memory)


class OtherToyBackend(ToyBackend):
    """A backend of another kind, so that forwarding between the two is between backends."""

    kind = "other toy"
