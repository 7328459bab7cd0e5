"""The medium of a radio as a pure machine: frames at times in, frames at later times out.

The rules are those of `sfglab.rtps.Medium`, frame for frame: queues with drop-tail at the hosts, one frame on
air at a time, turns among hosts that have something to send, airtime stretched by contention, then latency. All
times are nanoseconds of one clock that the caller reads. A frame's end follows from the end of the one before,
not from when somebody looked, so a late look delays a frame and lowers no rate. Refuses to know sockets and
losses.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

if TYPE_CHECKING:
    from collections.abc import Mapping


F = TypeVar("F")
_S = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class AirTerms:
    """What a `sfglab.rtps.Medium` says, in the machine's units."""

    rate_bps: float  #: Bits a second.
    loss: float  #: Share of frames that a receiver does not get.
    shared: bool  #: One half-duplex medium for all hosts; else each host sends independently.
    overhead_ns: int  #: Airtime of a frame beside its bits.
    contention: float  #: By which share each further host that wants to send stretches a frame.
    latency_ns: int  #: From the end of sending to arrival.
    queue_frames: int  #: Frames that a host's queue holds.

    @classmethod
    def of(cls, medium: Mapping[str, Any]) -> AirTerms:
        """Return the terms of a medium, given as its fields; the medium's own module compiles for seconds."""
        values = dict(medium)
        overhead_ns, latency_ns = (round(values.pop(name) * _S) for name in ("overhead_s", "latency_s"))
        return cls(overhead_ns=overhead_ns, latency_ns=latency_ns, **values)

    def airtime_ns(self, size_bytes: int, contenders: int) -> int:
        """Return how long a frame is on air while so many hosts want to send."""
        stretch = 1.0 + self.contention * (contenders - 1)
        return int((self.overhead_ns + size_bytes * 8e9 / self.rate_bps) * stretch)


class Sent(NamedTuple, Generic[F]):
    """A frame that arrives.

    Attributes:
        due_ns: When it arrives.
        host: Who sent it.
        frame: The frame.
    """

    due_ns: int
    host: int
    frame: F


@dataclass(slots=True, kw_only=True)
class HostUse:
    """What a host has done with the medium."""

    frames: int = 0  #: Frames that it sent.
    bytes_: int = 0  #: Their bytes.
    airtime_ns: int = 0  #: How long they were on air.
    queue_full: int = 0  #: Frames that found its queue full.


@dataclass(slots=True)
class _Transmitter(Generic[F]):
    """What sends one frame at a time; its hosts take turns."""

    hosts: tuple[int, ...]
    next_: int = 0
    free_ns: int = 0
    on_air: Sent[F] | None = None


class _Waiting(NamedTuple, Generic[F]):
    since_ns: int
    size_bytes: int
    frame: F


@dataclass(slots=True)
class _State(Generic[F]):
    queues: list[deque[_Waiting[F]]]
    transmitters: list[_Transmitter[F]] = field(default_factory=list)
    flight: deque[Sent[F]] = field(default_factory=deque)


class Air(Generic[F]):
    """The medium.

    Args:
        hosts: How many there are.
        terms: What it is like.

    Attributes:
        use: What each host has done with it.
    """

    def __init__(self, hosts: int, terms: AirTerms) -> None:
        self.use = [HostUse() for _ in range(hosts)]
        self._state: _State[F] = _State([deque() for _ in range(hosts)])
        self.change(terms)

    def change(self, terms: AirTerms) -> None:
        """Go on with other terms and new counters; what is on air keeps its time, what waits, waits on."""
        state = self._state
        state.flight.extend(t.on_air for t in state.transmitters if t.on_air is not None)
        free_ns = max((t.free_ns for t in state.transmitters), default=0)
        everybody = tuple(range(len(self.use)))
        groups = [everybody] if terms.shared else [(host,) for host in everybody]
        state.transmitters = [_Transmitter(group, free_ns=free_ns) for group in groups]
        self._terms = terms
        self.use = [HostUse() for _ in everybody]
        for transmitter in state.transmitters:
            self._start(transmitter)

    def offer(self, host: int, frame: F, *, size_bytes: int, now_ns: int) -> bool:
        """Put a frame into a host's queue; False when it is full. Time must have been advanced to now.

        Args:
            host: Who sends.
            frame: What.
            size_bytes: Bytes on the medium.
            now_ns: When it came.
        """
        queue = self._state.queues[host]
        if len(queue) >= self._terms.queue_frames:
            self.use[host].queue_full += 1
            return False
        queue.append(_Waiting(now_ns, size_bytes, frame))
        for transmitter in self._state.transmitters:
            # A frame that finds the medium free is on air at once and takes no place in the queue.
            if host in transmitter.hosts and transmitter.on_air is None:
                self._start(transmitter)
        return True

    def advance(self, until_ns: int) -> list[Sent[F]]:
        """Return the frames that have arrived until a time, this time included, in order."""
        state, terms = self._state, self._terms
        for transmitter in state.transmitters:
            while transmitter.on_air is not None and transmitter.free_ns <= until_ns:
                state.flight.append(transmitter.on_air)
                transmitter.on_air = None
                self._start(transmitter)
        arrived = [sent for sent in state.flight if sent.due_ns <= until_ns]
        if arrived:
            state.flight = deque(sent for sent in state.flight if sent.due_ns > until_ns)
        return arrived if terms.shared else sorted(arrived, key=lambda sent: sent.due_ns)

    def next_ns(self) -> int | None:
        """Return when something happens next; None: not before a frame is offered."""
        times = [t.free_ns for t in self._state.transmitters if t.on_air is not None]
        times += [sent.due_ns for sent in self._state.flight]
        return min(times, default=None)

    def _start(self, transmitter: _Transmitter[F]) -> None:
        """Put the next frame on air: of the host whose turn it is among those that wait by then."""
        queues = self._state.queues
        waiting = [host for host in transmitter.hosts if queues[host]]
        if not waiting:
            return
        start_ns = max(transmitter.free_ns, min(queues[host][0].since_ns for host in waiting))
        ready = [host for host in waiting if queues[host][0].since_ns <= start_ns]
        count = len(self.use)
        host = min(ready, key=lambda h: (h - transmitter.next_) % count)
        entry = queues[host].popleft()
        airtime_ns = self._terms.airtime_ns(entry.size_bytes, len(ready))
        transmitter.next_ = (host + 1) % count
        transmitter.free_ns = start_ns + airtime_ns
        transmitter.on_air = Sent(transmitter.free_ns + self._terms.latency_ns, host, entry.frame)
        use = self.use[host]
        use.frames += 1
        use.bytes_ += entry.size_bytes
        use.airtime_ns += airtime_ns
