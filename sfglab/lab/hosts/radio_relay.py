"""The relay of a radio, a process between the hosts' cables: ``python -m sfglab.lab.hosts.radio_relay FD``.

Takes every frame that a host sends (packet(7)), lets `air` say when it arrives, and hands it to its receivers
then. A frame to a group reaches every other host and is on air once; a loss is drawn for each receiver. The
kernel's time of arrival counts, and frames end on `air`'s schedule, so the relay's own slowness adds delay,
which it counts, and lowers no rate. It ends when its control socket does.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import random
import select
import socket
import struct
import sys
import time
from dataclasses import dataclass
from typing import Any, NamedTuple

from sfglab.lab.hosts.air import Air, Sent
from sfglab.rtps import Medium

# linux/if_ether.h, linux/if_packet.h, asm-generic/socket.h, linux/prctl.h
_ETH_P_ALL = 0x0003
_SOL_PACKET, _PACKET_STATISTICS, _PACKET_IGNORE_OUTGOING = 263, 6, 23
_SO_RCVBUFFORCE, _SO_TIMESTAMPNS = 33, 35
_PR_SET_TIMERSLACK = 29
_BUFFER_BYTES = 4 << 20
_FRAME_BYTES = 2048
_ANCILLARY_BYTES = 64
_START_BYTES = 65536
# Frames that are taken from one host before the others are looked at.
_BATCH = 64
_GROUP_BIT = 1
_S = 1_000_000_000
_LATE_AFTER_NS = 2_000_000


class _Arrival(NamedTuple):
    t_ns: int
    host: int
    frame: bytes


@dataclass(slots=True)
class _Kept:
    """How well the relay kept to the schedule."""

    since_ns: int
    delivered: int = 0
    late: int = 0
    late_sum_ns: int = 0
    late_most_ns: int = 0
    overrun: int = 0

    def note(self, due_ns: int, now_ns: int) -> None:
        delay_ns = max(0, now_ns - due_ns)
        self.delivered += 1
        self.late += delay_ns > _LATE_AFTER_NS
        self.late_sum_ns += delay_ns
        self.late_most_ns = max(self.late_most_ns, delay_ns)

    def report(self) -> dict[str, Any]:
        return {
            "delivered": self.delivered,
            "late": self.late,
            "late_after_s": _LATE_AFTER_NS / _S,
            "late_mean_s": self.late_sum_ns / max(1, self.delivered) / _S,
            "late_most_s": self.late_most_ns / _S,
            "overrun": self.overrun,
            "elapsed_s": (time.time_ns() - self.since_ns) / _S,
        }


def _open(interface: str) -> socket.socket:
    """Open one cable's end: everything that comes from the host, nothing that we send there."""
    sock = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
    sock.setsockopt(_SOL_PACKET, _PACKET_IGNORE_OUTGOING, 1)
    sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER_BYTES)
    except PermissionError:  # without root outside: what the system allows
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
    sock.setblocking(False)
    sock.bind((interface, _ETH_P_ALL))
    return sock


def _take(sock: socket.socket, host: int) -> list[_Arrival]:
    """Take what a host has sent, with the kernel's times."""
    arrivals = []
    for _ in range(_BATCH):
        try:
            frame, ancillary, _flags, _address = sock.recvmsg(_FRAME_BYTES, _ANCILLARY_BYTES)
        except BlockingIOError:
            break
        seconds, nanoseconds = struct.unpack_from("@ll", ancillary[0][2])
        arrivals.append(_Arrival(seconds * _S + nanoseconds, host, frame))
    return arrivals


class _Relay:
    def __init__(self, ports: list[list[str]]) -> None:
        self._names = [name for name, _, _ in ports]
        self._sockets = [_open(interface) for _, interface, _ in ports]
        self._host_of = {bytes.fromhex(mac.replace(":", "")): i for i, (_, _, mac) in enumerate(ports)}
        self._others = [tuple(j for j in range(len(ports)) if j != i) for i in range(len(ports))]
        self._air: Air[bytes] | None = None
        self._medium: Medium
        self._random = random.Random()
        self._lost = [0] * len(ports)
        self._kept = _Kept(time.time_ns())

    def set(self, *, medium: dict[str, Any], seed: int) -> dict[str, Any]:
        self._medium = Medium(**medium)
        if self._air is None:
            self._air = Air(len(self._names), self._medium)
        else:
            self._air.change(self._medium)
        self._random.seed(seed)
        self._lost = [0] * len(self._names)
        self._overrun()  # forgets, as reading resets it
        self._kept = _Kept(time.time_ns())
        return {}

    def counters(self) -> dict[str, Any]:
        assert self._air is not None
        self._kept.overrun += self._overrun()
        hosts = {
            name: {
                "frames": use.frames,
                "bytes_": use.bytes_,
                "airtime_s": use.airtime_ns / _S,
                "queue_full": use.queue_full,
                "lost": lost,
            }
            for name, use, lost in zip(self._names, self._air.use, self._lost, strict=True)
        }
        return {"hosts": hosts, **self._kept.report()}

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        return self.set(**request) if request.pop("op") == "set" else self.counters()

    def relay(self, control: socket.socket) -> None:
        """Relay until the control socket ends."""
        watched: list[socket.socket] = [control, *self._sockets]
        while True:
            ready, _, _ = select.select(watched, (), (), self._pause_s())
            if control in ready:
                data = control.recv(_FRAME_BYTES)
                if not data:
                    return
                control.send(json.dumps(self.answer(json.loads(data))).encode())
            arrivals = [a for i, sock in enumerate(self._sockets) if sock in ready for a in _take(sock, i)]
            self._go_on(sorted(arrivals))

    def _pause_s(self) -> float | None:
        next_ns = self._air.next_ns() if self._air is not None else None
        return None if next_ns is None else max(0, next_ns - time.time_ns()) / _S

    def _go_on(self, arrivals: list[_Arrival]) -> None:
        air = self._air
        if air is None:
            return  # the medium is not set yet: there is none
        for arrival in arrivals:
            self._deliver(air.advance(arrival.t_ns))
            air.offer(arrival.host, arrival.frame, size_bytes=len(arrival.frame), now_ns=arrival.t_ns)
        self._deliver(air.advance(time.time_ns()))

    def _deliver(self, sent: list[Sent[bytes]]) -> None:
        for due_ns, host, frame in sent:
            for receiver in self._receivers(host, frame):
                if self._random.random() < self._medium.loss:
                    self._lost[host] += 1
                    continue
                try:
                    self._sockets[receiver].send(frame)
                except OSError:  # the host's queue is full, or the host is going away
                    self._kept.overrun += 1
                self._kept.note(due_ns, time.time_ns())

    def _receivers(self, host: int, frame: bytes) -> tuple[int, ...]:
        if frame[0] & _GROUP_BIT:
            return self._others[host]
        receiver = self._host_of.get(frame[:6], host)
        return () if receiver == host else (receiver,)

    def _overrun(self) -> int:
        """Return how many frames the kernel has dropped since the last look (packet(7), PACKET_STATISTICS)."""
        dropped = 0
        for sock in self._sockets:
            _packets, drops = struct.unpack("@II", sock.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8))
            dropped += drops
        return dropped


def main(control_fd: str) -> None:
    """Be the relay.

    Args:
        control_fd: Number of its end of a SOCK_SEQPACKET pair.
    """
    # The kernel may wake a sleeper up to 50 us late by default (prctl(2)); frames take less than that.
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    with (
        contextlib.suppress(BrokenPipeError, ConnectionResetError),
        socket.socket(fileno=int(control_fd)) as control,
    ):
        start = control.recv(_START_BYTES)
        if not start:
            return  # the hub ended meanwhile
        try:
            relay = _Relay(json.loads(start)["ports"])
        except PermissionError as error:
            control.send(json.dumps({"refused": str(error)}).encode())
            return
        control.send(b"{}")
        relay.relay(control)


if __name__ == "__main__":
    main(*sys.argv[1:])
