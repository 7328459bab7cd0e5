"""Process on one side of a boundary: ``python -m sfglab.lab.workers.crossing CONFIG``.

The processes are those of paper C, Fig. 5. On the software side, ``software`` is the topic in software
together with its publisher, and ``subscriber`` is its software subscriber. On the hardware side,
``publisher``, ``gateway`` and ``reader`` share memory and wake each other through pipes. Sockets connect
the two sides.

Orders are ``{"do": "transfer", ...}`` with the fields of a `Message`, ``{"do": "go"}`` to the publisher,
and ``{"do": "check"}`` for the checksum of what a subscriber has received.
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
"""Random data beyond the largest message: each message begins at another offset."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossingConfig:
    """Configuration of a process on either side: its role, its descriptors and the random data."""

    role: str  #: Role: ``software``, ``subscriber``, ``publisher``, ``gateway`` or ``reader``.
    #: File descriptors: sockets by the peer's name, ``wake`` to wait, and ``wake_NAME`` to wake.
    links: dict[str, int]
    shared: int  #: File descriptor of the hardware side's memory; -1 on the software side.
    largest_bytes: int  #: Size of the largest message, bytes.
    seed: int  #: Seed of the random data.


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """One message that crosses between software and hardware, and the processes on its path."""

    publisher: str  #: Side of the publisher: ``software`` or ``hardware``.
    gateway: bool  #: Whether the topic is a gateway; otherwise it is software-mapped.
    message_bytes: int  #: Size, bytes; a multiple of 8.
    offset: int  #: Offset of the message in the random data.
    order: tuple[str, ...]  #: Processes to which the topic in software delivers, in this order.
    woken: tuple[str, ...]  #: Processes that the hardware side wakes, in this order.


def random_bytes(largest_bytes: int, seed: int) -> bytes:
    """Return the random data of which every message is a part; the same for the same seed."""
    return np.random.default_rng(seed).bytes(largest_bytes + SPARE_BYTES)


def content_of(data: bytes, message: Message) -> memoryview:
    """Return the content of a message as a view of the random data."""
    return memoryview(data)[message.offset : message.offset + message.message_bytes]


class Process:
    """Process on either side, with its steps for a message."""

    def __init__(self, config: CrossingConfig) -> None:
        self._role = config.role
        self._report = claim_standard_output()
        self._pipes: dict[str, int] = {}
        self._sockets: dict[str, socket.socket] = {}
        for name, descriptor in config.links.items():
            if name.startswith("wake"):
                self._pipes[name] = descriptor
            else:
                self._sockets[name] = socket.socket(fileno=descriptor)
        self._local = memoryview(bytearray(config.largest_bytes))
        self._shared = memoryview(b"")
        if config.shared >= 0:
            self._shared = memoryview(mmap.mmap(config.shared, config.largest_bytes))
            _read_words(self._shared)
        publishes = config.role in {"software", "publisher"}
        self._data = random_bytes(config.largest_bytes, config.seed) if publishes else b""
        self._received = self._local[:0]

    def serve(self) -> None:
        """Execute orders until the parent ends, which closes standard input.

        Raises:
            SfglabError: An order is unknown.
        """
        transfer = getattr(self, f"_be_{self._role}")
        self.report("ready")
        while line := sys.stdin.buffer.readline():
            order: dict[str, Any] = json.loads(line)
            kind = order.pop("do")
            if kind == "transfer":
                self.report("armed")
                began_ns = transfer(Message(**order))
                self.report("done", began_ns=began_ns, done_ns=time.monotonic_ns())
            elif kind == "check":
                self.report("content", crc=zlib.crc32(self._received))
            else:
                raise SfglabError(f"{self._role}: unexpected order {kind!r}")

    def report(self, kind: str, **values: Any) -> None:
        """Write a report of a kind, with values by name, to standard output."""
        self._report({"is": kind, **values})

    # Each role has one method. A publisher returns the time of its publication, all other roles 0.

    def _be_software(self, message: Message) -> int:
        """Publish, or receive from the hardware side; then deliver to one process after the other."""
        began_ns = 0
        if message.publisher == "software":
            content = content_of(self._data, message)
            began_ns = self._wait_for_go()
        else:
            source = "gateway" if message.gateway else "publisher"
            content = self._receive(source, self._local, message)
        for name in message.order:
            self._sockets[name].sendall(content)
        return began_ns

    def _be_publisher(self, message: Message) -> int:
        """Publish from the hardware side, into its memory or across the boundary."""
        content = content_of(self._data, message)
        began_ns = self._wait_for_go()
        if message.gateway:
            self._shared[: message.message_bytes] = content
            self._wake(message)
        else:
            self._sockets["software"].sendall(content)
        return began_ns

    def _be_gateway(self, message: Message) -> int:
        """Transfer a message across the boundary once, in either direction."""
        if message.publisher == "software":
            self._receive("software", self._shared, message)
            self._wake(message)
        else:
            self._wait_for_wake()
            self._sockets["software"].sendall(self._shared[: message.message_bytes])
        return 0

    def _be_reader(self, message: Message) -> int:
        """Read a message on the hardware side: from shared memory, or from an own copy."""
        if not message.gateway:
            return self._be_subscriber(message)
        self._wait_for_wake()
        self._received = self._shared[: message.message_bytes]
        _read_words(self._received)
        return 0

    def _be_subscriber(self, message: Message) -> int:
        """Receive an own copy of a message and read it."""
        self._received = self._receive("software", self._local, message)
        _read_words(self._received)
        return 0

    def _wait_for_go(self) -> int:
        line = sys.stdin.buffer.readline() or b"{}"
        if json.loads(line).get("do") != "go":
            raise SfglabError(f"{self._role}: the parent ended before the publication")
        return time.monotonic_ns()

    def _receive(self, peer: str, into: memoryview, message: Message) -> memoryview:
        """Receive a message from a peer across the boundary."""
        view = into[: message.message_bytes]
        received = 0
        while received < len(view):
            count = self._sockets[peer].recv_into(view[received:])
            if not count:
                raise SfglabError(f"{self._role}: {peer} ended after {received} bytes")
            received += count
        return view

    def _wake(self, message: Message) -> None:
        for name in message.woken:
            os.write(self._pipes[f"wake_{name}"], b"!")

    def _wait_for_wake(self) -> None:
        if not os.read(self._pipes["wake"], 1):
            raise SfglabError(f"{self._role}: the process that wakes it ended")


def _read_words(view: memoryview) -> int:
    """Read every word of a message, as a real subscriber does."""
    return int(np.frombuffer(view, dtype=np.uint64).sum(dtype=np.uint64))


def main() -> None:
    """Run one process until its parent ends; on an error, report it and exit with status 1."""
    process = Process(config_from_argument(CrossingConfig, sys.argv[1]))
    try:
        process.serve()
    except (SfglabError, OSError) as error:
        process.report("failed", why=str(error))
        sys.exit(1)


if __name__ == "__main__":
    main()
