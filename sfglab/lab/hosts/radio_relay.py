"""Relay of a radio, a process between the hosts' cables: ``python -m sfglab.lab.hosts.radio_relay FD``.

The relay receives every frame that a host sends (packet(7)). The medium determines its time of arrival, at
which the relay hands it to its receivers. A frame to a group reaches all other hosts and is sent once; a
loss is drawn for each receiver. The process ends with its control socket.

The medium is a pure state machine of frames at times, in nanoseconds of the caller's clock. Its rules are
the functions of `sfglab.rtps.channel`, which the model of RTPS uses as well. A blocking queue is in the
kernel (`wiring`). The delay of the relay itself is added and counted. It lowers no rate, because a frame's
end follows from the end of the previous frame.
"""

from __future__ import annotations

import contextlib
import ctypes
import random
import select
import socket
import struct
import sys
import time
from collections import deque
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from sfglab.lab.hosts.channel import answer
from sfglab.lab.hosts.radio import RadioCounters, RadioHost
from sfglab.rtps import Medium
from sfglab.rtps.channel import (
    BLOCK,
    DISPLACES,
    JOINS,
    REFUSED,
    admission,
    after_stall_ns,
    airtime_ns,
    is_lost,
    next_sender,
)
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

F = TypeVar("F")


class Sent(NamedTuple, Generic[F]):
    """A frame with its time of arrival."""

    due_ns: int  #: Time of arrival.
    host: int  #: Host that sent it.
    frame: F  #: The frame.


@dataclass(slots=True)
class _Transmitter(Generic[F]):
    """Transmitter of one frame at a time; its hosts take turns."""

    hosts: tuple[int, ...]
    next_: int = 0
    free_ns: int = 0
    on_air: Sent[F] | None = None
    relayed: _Waiting[F] | None = None  #: Frame that the access point sends next.


class _Waiting(NamedTuple, Generic[F]):
    since_ns: int
    size_bytes: int
    frame: F
    sender: int


class Air(Generic[F]):
    """State of the medium; `lose` decides on losses before the access point, `chance` on the next sender."""

    def __init__(
        self,
        hosts: Sequence[str],
        medium: Medium,
        *,
        lose: Callable[[int], bool] = lambda _: False,
        chance: random.Random | None = None,
    ) -> None:
        self._hosts, self._lose, self._chance = tuple(hosts), lose, chance or random.Random()
        #: Use of the medium per host; the caller counts losses.
        self.use = [RadioHost() for _ in hosts]
        # the last place, which is unused if the medium has no access point
        self._access_point = len(self.use)
        self._queues: list[deque[_Waiting[F]]] = [deque() for _ in range(len(hosts) + 1)]
        self._transmitters: list[_Transmitter[F]] = []
        self._flight: deque[Sent[F]] = deque()
        self.change(medium)

    def change(self, medium: Medium) -> None:
        """Change the medium and reset the counters; sent frames keep their times, and queued frames stay queued."""
        self._flight.extend(t.on_air for t in self._transmitters if t.on_air is not None)
        free_ns = max((t.free_ns for t in self._transmitters), default=0)
        everybody = tuple(range(len(self._hosts) + 1))
        groups = [everybody] if medium.shared else [(host,) for host in everybody]
        self._transmitters = [_Transmitter(group, free_ns=free_ns) for group in groups]
        self._medium = medium
        self.use = [RadioHost() for _ in everybody]
        for transmitter in self._transmitters:
            self._start(transmitter)

    def offer(self, host: int, frame: F, *, size_bytes: int, now_ns: int) -> bool:
        """Put a frame into a host's queue now; return False if a frame is dropped."""
        took = self._queue(host, _Waiting(now_ns, size_bytes, frame, host))
        for transmitter in self._transmitters:
            # A frame that finds the medium free is sent at once and takes no place in the queue.
            if host in transmitter.hosts and transmitter.on_air is None:
                self._start(transmitter)
        return took

    def _queue(self, host: int, waiting: _Waiting[F]) -> bool:
        queue, medium = self._queues[host], self._medium
        result = admission(medium.rule, len(queue), medium.queue_frames)
        if result != JOINS:
            self.use[host].queue_full += 1
        if result == DISPLACES:
            queue.popleft()
        # The kernel makes senders wait for a blocking queue, so no frame that reaches the relay is dropped.
        if result != REFUSED or medium.rule == BLOCK:
            queue.append(waiting)
        return result == JOINS

    def advance(self, until_ns: int) -> list[Sent[F]]:
        """Return the frames that have arrived until a time, inclusive, in order."""
        for transmitter in self._transmitters:
            while transmitter.on_air is not None and transmitter.free_ns <= until_ns:
                if transmitter.relayed is None:
                    self._flight.append(transmitter.on_air)
                elif self._lose(transmitter.on_air.host):
                    self.use[transmitter.on_air.host].lost += 1
                else:
                    self._queue(self._access_point, transmitter.relayed)
                transmitter.on_air = None
                self._start(transmitter)
        arrived = [sent for sent in self._flight if sent.due_ns <= until_ns]
        if arrived:
            self._flight = deque(sent for sent in self._flight if sent.due_ns > until_ns)
        return arrived if self._medium.shared else sorted(arrived, key=lambda sent: sent.due_ns)

    def next_ns(self) -> int | None:
        """Return the time of the next event; None: none before the next frame is offered."""
        times = [t.free_ns for t in self._transmitters if t.on_air is not None]
        times += [sent.due_ns for sent in self._flight]
        return min(times, default=None)

    def _start(self, transmitter: _Transmitter[F]) -> None:
        """Send the next frame: the first of the host whose turn it is among the hosts that wait by then."""
        queues, medium = self._queues, self._medium
        waiting = [host for host in transmitter.hosts if queues[host]]
        if not waiting:
            return
        start_ns = max(transmitter.free_ns, min(queues[host][0].since_ns for host in waiting))
        ready = {host for host in waiting if queues[host][0].since_ns <= start_ns}
        contends = [host in ready for host in range(len(queues))]
        host, contenders = next_sender(contends, transmitter.next_, 0)
        if contenders > 1 and medium.random_turns:
            passed = int(self._chance.random() * contenders)
            host, _ = next_sender(contends, transmitter.next_, passed)
        entry = queues[host].popleft()
        on_air_ns = airtime_ns(
            entry.size_bytes, contenders, medium.overhead_ns, medium.rate_bps, medium.contention
        )
        transmitter.next_ = host + 1
        began_ns = after_stall_ns(start_ns, medium.stall_every_ns, medium.stall_ns)
        transmitter.free_ns = began_ns + on_air_ns
        due_ns = transmitter.free_ns + medium.latency_ns
        transmitter.on_air = Sent(due_ns, entry.sender, entry.frame)
        is_first_hop = medium.access_point and host != self._access_point
        transmitter.relayed = entry._replace(since_ns=transmitter.free_ns) if is_first_hop else None
        use = self.use[host]
        use.frames += 1
        use.bytes_ += entry.size_bytes
        use.airtime_ns += on_air_ns


# linux/if_ether.h, linux/if_packet.h, asm-generic/socket.h, linux/prctl.h
_ETH_P_ALL = 0x0003
_SOL_PACKET, _PACKET_STATISTICS, _PACKET_IGNORE_OUTGOING = 263, 6, 23
_SO_RCVBUFFORCE, _SO_TIMESTAMPNS = 33, 35
_PR_SET_TIMERSLACK = 29
_BUFFER_BYTES = 4 << 20
_FRAME_BYTES = 2048
_ANCILLARY_BYTES = 64
# Maximum number of frames that are taken from one host before the other hosts.
_BATCH = 64
_GROUP_BIT = 1


class _Arrival(NamedTuple):
    t_ns: int
    host: int
    frame: bytes


def _open(interface: str) -> socket.socket:
    """Open one cable's end, to receive all frames of the host, without those that we send there."""
    sock = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
    sock.setsockopt(_SOL_PACKET, _PACKET_IGNORE_OUTGOING, 1)
    sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER_BYTES)
    except PermissionError:  # without root in the initial namespace: as much as the system allows
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
    sock.setblocking(False)
    sock.bind((interface, _ETH_P_ALL))
    return sock


def _take(sock: socket.socket, host: int) -> list[_Arrival]:
    """Receive the frames that a host has sent, with the kernel's time stamps."""
    arrivals = []
    for _ in range(_BATCH):
        try:
            frame, ancillary, _flags, _address = sock.recvmsg(_FRAME_BYTES, _ANCILLARY_BYTES)
        except BlockingIOError:
            break
        seconds, nanoseconds = struct.unpack_from("@ll", ancillary[0][2])
        arrivals.append(_Arrival(seconds * NS_PER_S + nanoseconds, host, frame))
    return arrivals


class _Relay:
    def __init__(self) -> None:
        self._names: list[str] = []
        self._sockets: list[socket.socket] = []
        self._host_of: dict[bytes, int] = {}
        self._others: list[tuple[int, ...]] = []
        self._air: Air[bytes] | None = None
        self._medium: Medium
        self._random = random.Random()
        self._bad: dict[
            tuple[int, int | None], bool
        ] = {}  # whether the last frame from a host to a receiver was lost
        self._counters = RadioCounters()

    def start(self, *, ports: list[list[str]]) -> None:
        for host, (name, interface, mac) in enumerate(ports):
            self._names.append(name)
            self._sockets.append(_open(interface))
            self._host_of[bytes.fromhex(mac.replace(":", ""))] = host
            others = [other for other in range(len(ports)) if other != host]
            self._others.append(tuple(others))

    def set(self, *, medium: dict[str, Any], seed: int) -> None:
        self._medium = Medium(**medium)
        if self._air is None:
            self._air = Air(self._names, self._medium, lose=self._lost, chance=self._random)
        else:
            self._air.change(self._medium)
        self._random.seed(seed)
        self._bad.clear()
        self._overrun()  # reading resets the kernel's counters
        self._counters = RadioCounters()

    def counters(self) -> dict[str, Any]:
        assert self._air is not None
        self._counters.overrun += self._overrun()
        names = [*self._names, "access point"] if self._medium.access_point else self._names
        self._counters.hosts = dict(zip(names, self._air.use, strict=False))
        return asdict(self._counters)

    def relay(self, control: socket.socket) -> None:
        """Relay frames until the control socket closes."""
        while True:
            watched = [control, *self._sockets]
            ready, _, _ = select.select(watched, (), (), self._pause_s())
            if control in ready and not answer(control, self.start, self.set, self.counters):
                return
            arrivals = [
                a for i, sock in enumerate(self._sockets) if sock in ready for a in _take(sock, i)
            ]
            self._go_on(sorted(arrivals))

    def _pause_s(self) -> float | None:
        next_ns = self._air.next_ns() if self._air is not None else None
        return None if next_ns is None else max(0, next_ns - time.time_ns()) / NS_PER_S

    def _go_on(self, arrivals: list[_Arrival]) -> None:
        air = self._air
        if air is None:
            return  # no medium is set yet
        for arrival in arrivals:
            self._deliver(air, air.advance(arrival.t_ns))
            size_bytes = len(arrival.frame)
            air.offer(arrival.host, arrival.frame, size_bytes=size_bytes, now_ns=arrival.t_ns)
        self._deliver(air, air.advance(time.time_ns()))

    def _deliver(self, air: Air[bytes], sent: list[Sent[bytes]]) -> None:
        for due_ns, host, frame in sent:
            for receiver in self._receivers(host, frame):
                if self._lost(host, receiver):
                    air.use[host].lost += 1
                    continue
                try:
                    self._sockets[receiver].send(frame)
                except OSError:  # the host's queue is full, or the host is being removed
                    self._counters.overrun += 1
                self._counters.note(due_ns, time.time_ns())

    def _lost(self, host: int, receiver: int | None = None) -> bool:
        """Return whether a frame is lost on its way to a receiver or, for None, to the access point."""
        way, medium = (host, receiver), self._medium
        draw = self._random.random()
        self._bad[way] = is_lost(self._bad.get(way, False), draw, medium.loss, medium.burst_frames)
        return self._bad[way]

    def _receivers(self, host: int, frame: bytes) -> tuple[int, ...]:
        if frame[0] & _GROUP_BIT:
            return self._others[host]
        receiver = self._host_of.get(frame[:6], host)
        return () if receiver == host else (receiver,)

    def _overrun(self) -> int:
        """Return the number of frames that the kernel dropped since the last call (packet(7), PACKET_STATISTICS)."""
        told = (sock.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8) for sock in self._sockets)
        return sum(drops for _packets, drops in (struct.unpack("@II", counts) for counts in told))


def main(control_fd: str) -> None:
    """Run the relay."""
    # By default, the kernel may wake a process up to 50 us late (prctl(2)), which is longer than a frame
    # takes.
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    hub_is_gone = contextlib.suppress(BrokenPipeError, ConnectionResetError)
    with hub_is_gone, socket.socket(fileno=int(control_fd)) as control:
        _Relay().relay(control)


if __name__ == "__main__":
    main(*sys.argv[1:])
