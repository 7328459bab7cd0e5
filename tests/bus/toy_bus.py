"""A third backend: queues in one process, no DDS, no simulation; components run on it without a change."""

import secrets
from collections import deque
from functools import partial

from sfglab import bus
from sfglab.bus.api import EndpointInfo, EndpointKind, ros_topic
from sfglab.bus.backend import Backend
from sfglab.bus.graph import Graph
from sfglab.messages import serialize
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
        qos = endpoint.qos
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
        data = bytes(cdr)
        stamp_ns = (
            self.backend.clock.now_ns() if source_timestamp_ns is None else source_timestamp_ns
        )
        self.kept.append((data, stamp_ns))
        for reader in self.peers:
            reader.backend.loop.call_soon(reader.take, data, stamp_ns, self.gid)

    def write_message(self, message):
        self.write(serialize(message))

    def loan(self, size_bytes):
        raise TypeError(f"no {size_bytes} bytes to lend")


class OtherToyBackend(ToyBackend):
    """A backend of another kind, so that forwarding between the two is between backends."""

    kind = "other toy"
