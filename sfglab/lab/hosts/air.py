"""The medium of a radio as a pure machine: frames at times in, frames at later times out.

The rules are those of the model of RTPS, frame for frame, and airtime and turns its very functions: queues with
drop-tail at the hosts, one frame on air at a time, turns among hosts that have something to send, airtime
stretched by contention, then latency. All times are nanoseconds of one clock that the caller reads. A frame's
end follows from the end of the one before, not from when somebody looked, so a late look delays a frame and
lowers no rate. Refuses to know sockets and losses.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from sfglab.rtps.model import next_sender

if TYPE_CHECKING:
    from sfglab.rtps import Medium


F = TypeVar("F")


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
        medium: What it is like.

    Attributes:
        use: What each host has done with it.
    """

    def __init__(self, hosts: int, medium: Medium) -> None:
        self.use = [HostUse() for _ in range(hosts)]
        self._state: _State[F] = _State([deque() for _ in range(hosts)])
        self.change(medium)

    def change(self, medium: Medium) -> None:
        """Go on with another medium and new counters; what is on air keeps its time, what waits, waits on."""
        state = self._state
        state.flight.extend(t.on_air for t in state.transmitters if t.on_air is not None)
        free_ns = max((t.free_ns for t in state.transmitters), default=0)
        everybody = tuple(range(len(self.use)))
        groups = [everybody] if medium.shared else [(host,) for host in everybody]
        state.transmitters = [_Transmitter(group, free_ns=free_ns) for group in groups]
        self._medium = medium
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
        if len(queue) >= self._medium.queue_frames:
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
        state = self._state
        for transmitter in state.transmitters:
            while transmitter.on_air is not None and transmitter.free_ns <= until_ns:
                state.flight.append(transmitter.on_air)
                transmitter.on_air = None
                self._start(transmitter)
        arrived = [sent for sent in state.flight if sent.due_ns <= until_ns]
        if arrived:
            state.flight = deque(sent for sent in state.flight if sent.due_ns > until_ns)
        return arrived if self._medium.shared else sorted(arrived, key=lambda sent: sent.due_ns)

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
        ready = {host for host in waiting if queues[host][0].since_ns <= start_ns}
        host, contenders = next_sender([host in ready for host in range(len(queues))], transmitter.next_)
        entry = queues[host].popleft()
        airtime_ns = self._medium.airtime_ns(entry.size_bytes, contenders)
        transmitter.next_ = host + 1
        transmitter.free_ns = start_ns + airtime_ns
        transmitter.on_air = Sent(transmitter.free_ns + self._medium.latency_ns, host, entry.frame)
        use = self.use[host]
        use.frames += 1
        use.bytes_ += entry.size_bytes
        use.airtime_ns += airtime_ns
