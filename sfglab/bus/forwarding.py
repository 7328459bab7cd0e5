"""Samples from one node to another as they are: what a router between two domains stands on.

Refuses to know policies: whoever opens a forward says which sources pass; what others send waits until then.
Live nodes forward inside the middleware (`sfglab.bus.dds.forwarder`), without the bytes ever being Python's;
every other node offers the methods of `ForwardingNode`, and the same router runs on both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, cast

from sfglab.bus.api import MessageInfo, Node
from sfglab.bus.switch import Switch

if TYPE_CHECKING:
    from sfglab.qos import QoSProfile


Transform = Callable[[bytes], bytes | None]
"""Changes a sample on its way: CDR in, CDR out, None drops it. The same object back means: as it was."""

Sink = Callable[[bytes, MessageInfo], None]
"""Takes one sample: its CDR, 4-byte header included, and what is known about it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RawEndpoint:
    """What an inlet or outlet is to be."""

    dds_topic: str  #: The topic on the wire: "rt/tf", "rq/global/go2/get_metadataRequest".
    #: As `EndpointInfo.type` names it: the ROS type, or the DDS type when it has no ROS name. On topics below
    #: "rq/" and "rr/" the CDR begins with the 16 bytes of `sfglab.messages.frame_service`.
    type: str
    qos: QoSProfile  #: What is requested or offered.
    user_data: bytes = b""  #: The endpoint's USER_DATA, which the others' graphs show.


class Outlet(Protocol):
    """A raw writer in the target's domain."""

    @property
    def gid(self) -> bytes:
        """Its 16-byte GUID, as the graph shows it."""

    def close(self) -> None:
        """End it; again is harmless."""


class RawOutlet(Outlet, Protocol):
    """A raw writer that takes its samples from Python."""

    def write(self, cdr: bytes, source_timestamp_ns: int) -> None:
        """Send one sample with the time stamp that its first publisher gave it."""


class Inlet(Protocol):
    """A raw reader in the source's domain."""

    @property
    def gid(self) -> bytes:
        """Its 16-byte GUID, as the graph shows it."""

    def close(self) -> None:
        """End it, after which its sink is not called any more; again is harmless."""


class ForwardingNode(Node, Protocol):
    """A node that a router can stand on: what `sfglab.bus.sim` offers, and a live node does not need."""

    @property
    def guid(self) -> bytes:
        """The 16-byte GUID of its participant: `EndpointInfo.participant` of its own endpoints."""

    def open_inlet(self, endpoint: RawEndpoint, sink: Sink) -> Inlet:
        """Open a raw reader, which the graph shows like any subscription.

        Args:
            endpoint: Topic, type and requested QoS. With TRANSIENT_LOCAL the sink hears the matching
                publishers' histories first.
            sink: Called on the loop for each sample, in each publisher's order, with the publisher's gid and
                its source time stamp. Never called for what outlets of this node wrote.
        """

    def open_outlet(self, endpoint: RawEndpoint) -> RawOutlet:
        """Open a raw writer, which the graph shows like any publisher.

        Args:
            endpoint: Topic, type and offered QoS. With TRANSIENT_LOCAL it keeps a history of its own.
        """


@dataclass(slots=True)
class ForwardCounts:
    """What a forward did so far."""

    forwarded: int = 0  #: Samples handed to an outlet.
    #: Samples that were not: of refused sources, by the transform, pushed out while they were held, or refused
    #: by the target's middleware.
    dropped: int = 0
    bytes: int = 0  #: Size of the CDR that was forwarded.


class Forward(Protocol):
    """One reader of one topic, whose samples go on by their source; made by `Forwarder.open`."""

    @property
    def gid(self) -> bytes:
        """The reader's 16-byte GUID."""

    @property
    def counts(self) -> ForwardCounts:
        """What it did so far."""

    def admit(self, source: bytes, outlet: Outlet, transform: Transform | None = None) -> None:
        """Send a source's samples to an outlet from now on, those held for it first.

        Args:
            source: The 16-byte GUID of a publisher in the source's domain.
            outlet: Made by the same forwarder.
            transform: Given each sample. On live nodes it runs in the thread that reads, so it must not
                touch what belongs to the loop.
        """

    def refuse(self, source: bytes) -> None:
        """Drop a source's samples from now on, and those held."""

    def forget(self, source: bytes) -> None:
        """Take a source for one that was never judged: its samples are held, within bounds, until it is."""

    def close(self) -> None:
        """End it at once: nothing is forwarded any more; outlets stay. Again is harmless."""


class Forwarder(Protocol):
    """Opens forwards from one node and outlets on another; made by `open_forwarder`."""

    def open(self, endpoint: RawEndpoint) -> Forward:
        """Read a topic in the source's domain; until its sources are judged their samples are held."""

    def open_outlet(self, endpoint: RawEndpoint) -> Outlet:
        """Write to a topic in the target's domain; to be closed when no source goes there any more."""


def open_forwarder(source: Node, target: Node) -> Forwarder:
    """Return what forwards from one node to another.

    Args:
        source: Where samples come from.
        target: Where they go to: in another domain than the source.

    Raises:
        TypeError: One of the two is live and the other is not.
    """
    from sfglab.bus.node import Node as LiveNode

    live = [isinstance(node, LiveNode) for node in (source, target)]
    if all(live):
        from sfglab.bus.dds.forwarder import DdsForwarder

        return DdsForwarder(source, target)  # type: ignore[arg-type]  # both are live
    if any(live):
        raise TypeError("forwarding: given a live and a simulated node, allowed are two of one kind")
    return _NodeForwarder(cast("ForwardingNode", source), cast("ForwardingNode", target))


_RawExit = tuple[RawOutlet, Transform | None]


class _NodeForward:
    """A forward over an inlet, all on the loop."""

    def __init__(self, node: ForwardingNode, endpoint: RawEndpoint) -> None:
        self.counts = ForwardCounts()
        self._switch: Switch[tuple[bytes, int], _RawExit] = Switch(self._send, self._drop)
        self._inlet = node.open_inlet(endpoint, self._take)
        self.gid = self._inlet.gid

    def admit(self, source: bytes, outlet: Outlet, transform: Transform | None = None) -> None:
        self._switch.judge(source, (cast("RawOutlet", outlet), transform))

    def refuse(self, source: bytes) -> None:
        self._switch.judge(source, None)

    def forget(self, source: bytes) -> None:
        self._switch.forget(source)

    def close(self) -> None:
        self._inlet.close()
        self._switch.clear()

    def _take(self, cdr: bytes, info: MessageInfo) -> None:
        self._switch.take(info.publisher_gid, (cdr, info.source_timestamp_ns))

    def _send(self, exit_: _RawExit, sample: tuple[bytes, int]) -> None:
        outlet, transform = exit_
        cdr = sample[0] if transform is None else transform(sample[0])
        if cdr is None:
            self._drop(sample)
            return
        outlet.write(cdr, sample[1])
        self.counts.forwarded += 1
        self.counts.bytes += len(cdr)

    def _drop(self, _: tuple[bytes, int]) -> None:
        self.counts.dropped += 1


class _NodeForwarder:
    """Forwards between two nodes that offer inlets and outlets."""

    def __init__(self, source: ForwardingNode, target: ForwardingNode) -> None:
        self._source = source
        self._target = target

    def open(self, endpoint: RawEndpoint) -> Forward:
        return _NodeForward(self._source, endpoint)

    def open_outlet(self, endpoint: RawEndpoint) -> Outlet:
        return self._target.open_outlet(endpoint)
