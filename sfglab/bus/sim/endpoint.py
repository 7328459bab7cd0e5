"""What simulated writers and readers have in common: whom they match, and how the others hear of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Self

from sfglab.bus.api import EndpointAdded, EndpointRemoved

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.api import EndpointInfo
    from sfglab.bus.sim.domain import Observer
    from sfglab.bus.sim.participant import Participant


Item = tuple[int, bytes, int]
"""A sample on its way: sequence number from 1, CDR, source time stamp (ns)."""


class Endpoint:
    """A writer or reader of one topic.

    Args:
        participant: Whose it is.
        info: What the others are shown.
        notify: Called when what matches has changed.
        ignores_own: Whether it matches nothing of its own participant.

    Attributes:
        peers: What matches now; of a reader, with the number of the latest sample from there.
        number: One that nothing else in the world has.
        shape: Stands for its type, transport and QoS; equal ones, equal number.
        born_ns: When it was announced.
        gone_ns: When it was retracted; None until then.
        backlog_ns: How long the others take until they have time for its announcement.
        suspicion: Hears of what does not match; None when nobody cares.
    """

    __slots__ = (
        "_added",
        "_ignores_own",
        "_loop",
        "_notify",
        "_world",
        "backlog_ns",
        "born_ns",
        "gid",
        "gone_ns",
        "info",
        "is_open",
        "number",
        "participant",
        "peers",
        "shape",
        "suspicion",
        "topic",
    )

    is_writer: ClassVar[bool]

    def __init__(
        self,
        participant: Participant,
        info: EndpointInfo,
        notify: Callable[[], None],
        *,
        ignores_own: bool = False,
    ) -> None:
        domain = participant.domain
        world = domain.world
        self.participant = participant
        self.info = info
        self.gid = info.gid
        self.topic = domain.topic(info.dds_topic)
        self.number = world.new_number()
        self.shape = world.shape(info.type, info.transport, info.qos)
        self.born_ns = 0
        self.gone_ns: int | None = None
        self.backlog_ns = 0
        self.suspicion: Observer | None = None
        self.peers: dict[Any, int] = {}
        self.is_open = True
        self._ignores_own = ignores_own
        self._notify = notify
        self._world = world
        self._loop = world.loop
        self._added: EndpointAdded | None = None

    @property
    def added(self) -> EndpointAdded:
        """The event of its appearance, one for all who hear of it."""
        if self._added is None:
            self._added = EndpointAdded(endpoint=self.info)
        return self._added

    @property
    def removed(self) -> EndpointRemoved:
        """The event of its end."""
        return EndpointRemoved(endpoint=self.info)

    @property
    def now_ns(self) -> int:
        """The time of its world."""
        return self._loop.now_ns

    @property
    def fades(self) -> bool:
        """Whether it is retracted, or its owner has fallen silent, so that others cease to know it."""
        return self.gone_ns is not None or self.participant.crashed_ns is not None

    @property
    def matched(self) -> int:
        """How many endpoints match now."""
        return len(self.peers)

    @property
    def matched_prefixes(self) -> frozenset[bytes]:
        """The GUID prefixes of the participants of what matches now."""
        return frozenset(peer.gid[:12] for peer in self.peers)

    def suits(self, other: Endpoint) -> bool:
        """Return whether this and an endpoint of the other kind on the same topic match."""
        if self.is_writer:
            fits = self._world.compatible(self.shape, other.shape)
        else:
            fits = self._world.compatible(other.shape, self.shape)
        if not fits:
            return False
        owner, their_owner = self.participant, other.participant
        if owner is their_owner:
            return not (self._ignores_own or other._ignores_own)
        return self.info.transport == "dds" or owner.host is their_owner.host

    def opened(self) -> Self:
        """Announce it and return it."""
        if self._world.trace is not None:
            self._world.trace("open", self.gid, self.info.dds_topic.encode())
        self.participant.domain.announce(self)
        return self

    def close(self) -> None:
        """Retract it; again is harmless."""
        if self.is_open:
            if self._world.trace is not None:
                self._world.trace("close", self.gid, b"")
            self.silence()
            self.participant.domain.retract(self)

    def silence(self) -> None:
        """Let it neither send nor take anything more, without a word to the others."""
        self.is_open = False
        self.peers.clear()

    def learn(self, endpoint: Endpoint) -> None:
        """Take note of an endpoint that matches; again is harmless."""
        raise NotImplementedError

    def forget(self, endpoint: Endpoint) -> None:
        """Take note that it has gone; harmless if it was never known."""
        if self.peers.pop(endpoint, None) is not None:
            self._notify()
