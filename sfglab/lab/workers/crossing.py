"""One end of a boundary between processes: ``python -m sfglab.lab.workers.crossing CONFIG``.

The setup of paper C, Fig. 5. ``software`` holds the topic in software and its publisher, ``subscriber`` is the
software subscriber; ``publisher``, ``gateway`` and ``reader`` are the hardware's side, which shares one memory
and bytes that wake. Across the boundary a socket carries. Orders: ``{"do": "round", ...}``, ``{"do": "go"}`` to
the publisher, ``{"do": "check"}`` for the checksum of what a receiver has.
"""

from __future__ import annotations

import json
import mmap
import os
import socket
import sys
import time
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from sfglab.component import claim_standard_output, config_from_argument
from sfglab.errors import SfglabError

SPARE_BYTES = 1 << 16
"""How much more random data there is than the largest message: each round's message begins elsewhere in it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossingConfig:
    """What a process of the crossing is told."""

    role: str  #: ``software``, ``subscriber``, ``publisher``, ``gateway`` or ``reader``.
    #: File descriptors of its sockets and pipes, by the peer's name; ``wake`` is where it is woken.
    links: dict[str, int]
    #: File descriptor of the hardware side's memory; -1: it stands on the software's side.
    shared: int
    largest_bytes: int  #: Size of the largest message.
    seed: int  #: Of the random data.


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """One message."""

    publisher: str  #: ``software`` or ``hardware``.
    gateway: bool  #: Whether the topic is a gateway; else it is software-mapped.
    message_bytes: int  #: A multiple of 8.
    offset: int  #: Where in the random data the message begins.
    order: tuple[str, ...]  #: Whom the topic in software delivers to, in this order.
    woken: tuple[str, ...]  #: Whom the hardware's side wakes, in this order.


def random_bytes(largest_bytes: int, seed: int) -> bytes:
    """Return the random data that all messages are taken from."""
    return np.random.default_rng(seed).bytes(largest_bytes + SPARE_BYTES)


def message_of(data: bytes, item: Round) -> memoryview:
    """Return a round's message."""
    return memoryview(data)[item.offset : item.offset + item.message_bytes]


class End:
    """A process of the crossing: what it does in a round."""

    def __init__(self, config: CrossingConfig) -> None:
        self._config = config
        self._report = claim_standard_output()
        wakes = {name for name in config.links if name.startswith("wake")}
        self._pipes = {name: config.links[name] for name in wakes}
        self._sockets = {
            n: socket.socket(fileno=fd) for n, fd in config.links.items() if n not in wakes
        }
        self._local = memoryview(bytearray(config.largest_bytes))
        self._shared = memoryview(b"")
        if config.shared >= 0:
            self._shared = memoryview(mmap.mmap(config.shared, config.largest_bytes))
            _touch(self._shared)
        publishes = config.role in {"software", "publisher"}
        self._data = random_bytes(config.largest_bytes, config.seed) if publishes else b""
        self._had = self._local[:0]

    def obey(self) -> None:
        """Take orders until there are no more; standard input ends with the parent."""
        self.say("ready")
        while order := sys.stdin.buffer.readline():
            values: dict[str, Any] = json.loads(order)
            what = values.pop("do")
            if what == "round":
                self.say("armed")
                began_ns = getattr(self, f"_as_{self._config.role}")(Round(**values))
                self.say("done", began_ns=began_ns or 0, done_ns=time.monotonic_ns())
            elif what == "check":
                self.say("content", crc=zlib.crc32(self._had))
            else:
                raise SfglabError(f"{self._config.role}: order {what!r} was not expected")

    def say(self, kind: str, **values: Any) -> None:
        """Report."""
        self._report({"is": kind, **values})

    def _as_software(self, item: Round) -> int:
        """Publish, or take from the hardware's side what it published; then deliver, one after the other."""
        began_ns = 0
        if item.publisher == "software":
            message = message_of(self._data, item)
            began_ns = self._begin()
        else:
            message = self._receive("gateway" if item.gateway else "publisher", self._local, item)
        for name in item.order:
            self._sockets[name].sendall(message)
        return began_ns

    def _as_publisher(self, item: Round) -> int:
        """Publish from the hardware's side: into its memory, or across."""
        message = message_of(self._data, item)
        began_ns = self._begin()
        if item.gateway:
            self._shared[: item.message_bytes] = message
            self._wake(item)
        else:
            self._sockets["software"].sendall(message)
        return began_ns

    def _as_gateway(self, item: Round) -> None:
        """Carry a message across once, in or out."""
        if item.publisher == "software":
            self._receive("software", self._shared, item)
            self._wake(item)
        else:
            self._be_woken()
            self._sockets["software"].sendall(self._shared[: item.message_bytes])

    def _as_reader(self, item: Round) -> None:
        if item.gateway:
            self._be_woken()
            self._had = self._shared[: item.message_bytes]
            _touch(self._had)
        else:
            self._as_subscriber(item)

    def _as_subscriber(self, item: Round) -> None:
        self._had = self._receive("software", self._local, item)
        _touch(self._had)

    def _begin(self) -> int:
        if json.loads(sys.stdin.buffer.readline() or "{}").get("do") != "go":
            raise SfglabError(
                f"{self._config.role}: the parent left before the message was published"
            )
        return time.monotonic_ns()

    def _receive(self, peer: str, into: memoryview, item: Round) -> memoryview:
        """Copy a message from across the boundary."""
        view, link = into[: item.message_bytes], self._sockets[peer]
        got = 0
        while got < len(view):
            if not (count := link.recv_into(view[got:])):
                raise SfglabError(
                    f"{self._config.role}: the link from {peer} ended after {got} bytes"
                )
            got += count
        return view

    def _wake(self, item: Round) -> None:
        for name in item.woken:
            os.write(self._pipes[f"wake_{name}"], b"!")

    def _be_woken(self) -> None:
        if not os.read(self._pipes["wake"], 1):
            raise SfglabError(f"{self._config.role}: whoever wakes it is gone")


def _touch(view: memoryview) -> int:
    """Read every word of a message, as whoever uses it does."""
    return int(np.frombuffer(view, dtype=np.uint64).sum(dtype=np.uint64))


def main() -> None:
    """Be one end."""
    end = End(config_from_argument(CrossingConfig, sys.argv[1]))
    try:
        end.obey()
    except (SfglabError, OSError) as error:
        end.say("failed", why=str(error))
        sys.exit(1)


if __name__ == "__main__":
    main()
