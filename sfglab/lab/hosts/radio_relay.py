"""Relay of a radio between the hosts' cables, which the hub runs.

The relay receives every frame that a host sends (packet(7)). The medium determines its time of arrival, at
which the relay hands it to its receivers. A frame to a group reaches all other hosts and is sent once; a
loss is drawn for each receiver.

The medium is a state machine of frames at times, in nanoseconds of the caller's clock, without I/O. Its rules are
the functions of `sfglab.rtps.channel`, which the model of RTPS uses as well. The delay of the relay itself
is added and counted. It lowers no rate, because a frame's end follows from the end of the previous frame.
"""

from __future__ import annotations

import ctypes
import gc
import random
import socket
import struct
import time
from collections import deque
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple

from sfglab.lab.hosts.radio import RadioCounters
from sfglab.rtps.channel import (
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
    from collections.abc import Callable, Iterable, Mapping

    from sfglab.lab.hosts.wiring import Port
    from sfglab.rtps import Medium


class Sent(NamedTuple):
    """A frame that the medium delivers, with its time of arrival."""

    due_ns: int  #: Time of arrival, ns.
    host: int  #: Index of the host that sent the frame.
    frame: Any  #: The frame.


class _Waiting(NamedTuple):
    since_ns: int
    size_bytes: int
    frame: Any
    sender: int


class Air:
    """State of the medium; `lose` decides on losses before the access point, `chance` on the next sender."""

    def __init__(
        self,
        hosts: int,
        medium: Medium,
        *,
        lose: Callable[[int], bool] = lambda _: False,
        chance: random.Random | None = None,
    ) -> None:
        self._lose = lose
        self._chance = chance or random.Random()
        # the last place, which is unused if the medium has no access point
        self._access_point = hosts
        self._queues: list[deque[_Waiting]] = [deque() for _ in range(hosts + 1)]
        self._turn = 0  # host that may send next
        self._free_ns = 0  # time at which the medium is free
        self._on_air: Sent | None = None
        self._relayed: _Waiting | None = None  # the frame on air, if it is sent again
        self._flight: list[Sent] = []
        self.change(medium)

    def change(self, medium: Medium) -> None:
        """Change the medium and reset the counters; frames that are sent or queued keep their places."""
        self.medium = medium  #: Present medium.
        #: Counters; the caller counts deliveries, and losses of receivers.
        self.counters = RadioCounters()

    def offer(self, host: int, frame: Any, *, size_bytes: int, now_ns: int) -> None:
        """Put a frame into a host's queue at a time, ns; a full queue drops a frame.

        Args:
            host: Index of the host.
            frame: The frame, in any form.
            size_bytes: Size of the frame with its Ethernet header, bytes.
            now_ns: Present time, ns.
        """
        self._queue(host, _Waiting(now_ns, size_bytes, frame, host))
        # A frame that finds the medium free is sent at once and takes no place in the queue.
        if self._on_air is None:
            self._start()

    def _queue(self, host: int, waiting: _Waiting) -> None:
        queue = self._queues[host]
        result = admission(self.medium.rule, len(queue), self.medium.queue_frames)
        if result != JOINS:
            self.counters.queue_full += 1
        if result == DISPLACES:
            queue.popleft()
        if result != REFUSED:
            queue.append(waiting)

    def advance(self, until_ns: int) -> list[Sent]:
        """Return the frames that have arrived until a time, inclusive, in order."""
        while self._on_air is not None and self._free_ns <= until_ns:
            if self._relayed is None:
                self._flight.append(self._on_air)
            elif self._lose(self._on_air.host):
                self.counters.lost += 1
            else:
                self._queue(self._access_point, self._relayed)
            self._on_air = None
            self._start()
        arrived = [sent for sent in self._flight if sent.due_ns <= until_ns]
        if arrived:
            self._flight = [sent for sent in self._flight if sent.due_ns > until_ns]
        # After a change to a lower latency, later frames arrive before earlier ones.
        return sorted(arrived, key=attrgetter("due_ns"))

    def next_ns(self) -> int | None:
        """Return the time of the next event, ns; None if there is none before the next frame is offered."""
        times = [] if self._on_air is None else [self._free_ns]
        times += [sent.due_ns for sent in self._flight]
        return min(times, default=None)

    def _start(self) -> None:
        """Send the next frame: the first of the host whose turn it is among the hosts that wait by then."""
        queues = self._queues
        medium = self.medium
        firsts_ns = [queue[0].since_ns for queue in queues if queue]
        if not firsts_ns:
            return
        start_ns = max(self._free_ns, min(firsts_ns))
        contends = [bool(queue) and queue[0].since_ns <= start_ns for queue in queues]
        host, contenders = next_sender(contends, self._turn, 0)
        if contenders > 1 and medium.random_turns:
            passed = int(self._chance.random() * contenders)
            host, _ = next_sender(contends, self._turn, passed)
        self._turn = host + 1
        entry = queues[host].popleft()
        on_air_ns = airtime_ns(
            entry.size_bytes, contenders, medium.overhead_ns, medium.rate_bps, medium.contention
        )
        began_ns = after_stall_ns(start_ns, medium.stall_every_ns, medium.stall_ns)
        self._free_ns = began_ns + on_air_ns
        self._on_air = Sent(self._free_ns + medium.latency_ns, entry.sender, entry.frame)
        is_first_hop = medium.access_point and host != self._access_point
        self._relayed = entry._replace(since_ns=self._free_ns) if is_first_hop else None
        self.counters.frames += 1
        self.counters.airtime_ns += on_air_ns


# linux/if_ether.h, linux/if_packet.h, asm-generic/socket.h, linux/prctl.h
_ETH_P_ALL = 0x0003
_SOL_PACKET = 263
_PACKET_STATISTICS = 6
_PACKET_IGNORE_OUTGOING = 23
_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35
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


class Relay:
    """Relay between the cables of hosts, which are given by name."""

    def __init__(self, ports: Mapping[str, Port], medium: Medium) -> None:
        self._host_of: dict[bytes, int] = {}
        #: Sockets with the frames of the hosts.
        self.sockets: list[socket.socket] = []
        for host, port in enumerate(ports.values()):
            self.sockets.append(_open(port.outer))
            self._host_of[bytes.fromhex(port.mac.replace(":", ""))] = host
        self._random = random.Random()
        # whether the last frame from a host to a receiver was lost
        self._bad: dict[tuple[int, int | None], bool] = {}
        self._air = Air(len(ports), medium, lose=self._lost, chance=self._random)
        # By default, the kernel may wake a process up to 50 us late (prctl(2)), which is longer than a frame
        # takes. A garbage collection would take longer as well, if it visited the objects of the hub.
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
        gc.freeze()

    def set(self, medium: Medium, *, seed: int) -> None:
        """Replace the medium, reset the counters, and begin the random numbers of the losses with a seed."""
        self._air.change(medium)
        self._random.seed(seed)
        self._bad.clear()
        self._overrun()  # reading resets the kernel's counters

    def counters(self) -> RadioCounters:
        """Return the counters since the medium was set."""
        self._air.counters.overrun += self._overrun()
        return self._air.counters

    def pause_s(self) -> float | None:
        """Return the time until the next frame arrives, s; None: no frame is sent."""
        next_ns = self._air.next_ns()
        return None if next_ns is None else max(0, next_ns - time.time_ns()) / NS_PER_S

    def relay(self, ready: Iterable[Any]) -> None:
        """Take frames from the sockets that are ready, and deliver those that have arrived."""
        arrivals = []
        for host, sock in enumerate(self.sockets):
            if sock in ready:
                arrivals += _take(sock, host)
        for arrival in sorted(arrivals):
            self._deliver(self._air.advance(arrival.t_ns))
            size_bytes = len(arrival.frame)
            self._air.offer(arrival.host, arrival.frame, size_bytes=size_bytes, now_ns=arrival.t_ns)
        self._deliver(self._air.advance(time.time_ns()))

    def _deliver(self, sent: list[Sent]) -> None:
        counters = self._air.counters
        for due_ns, host, frame in sent:
            for receiver in self._receivers(host, frame):
                if self._lost(host, receiver):
                    counters.lost += 1
                    continue
                try:
                    self.sockets[receiver].send(frame)
                except OSError:  # the host's queue is full, or the host is being removed
                    counters.overrun += 1
                else:
                    counters.note(due_ns, time.time_ns())

    def _lost(self, host: int, receiver: int | None = None) -> bool:
        """Return whether a frame is lost on its way to a receiver or, for None, to the access point."""
        way = (host, receiver)
        medium = self._air.medium
        draw = self._random.random()
        self._bad[way] = is_lost(self._bad.get(way, False), draw, medium.loss, medium.burst_frames)
        return self._bad[way]

    def _receivers(self, host: int, frame: bytes) -> list[int]:
        if frame[0] & _GROUP_BIT:
            return [other for other in range(len(self.sockets)) if other != host]
        receiver = self._host_of.get(frame[:6], host)
        return [] if receiver == host else [receiver]

    def _overrun(self) -> int:
        """Return the number of frames that the kernel dropped since the last call (packet(7), PACKET_STATISTICS)."""
        dropped = 0
        for sock in self.sockets:
            counts = sock.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8)
            dropped += struct.unpack("@II", counts)[1]
        return dropped
