"""The module `transfer.live` has the setup of paper C, Fig. 5, with processes on both sides of a boundary.

Over a software-mapped topic each subscriber on the hardware side gets its own copy through a socket. Through a
gateway one copy crosses the boundary into memory that the hardware side shares. The boundary is not a memory
interface: a copy takes the time of a processor core, and the processes share the cores.
"""

from __future__ import annotations

import os
import signal
import socket
import zlib
from contextlib import ExitStack, aclosing
from dataclasses import asdict, dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from sfglab.lab.experiments.transfer.experiment import Config, CrossingRow, exp
from sfglab.lab.workers.crossing import (
    SPARE_BYTES,
    CrossingConfig,
    Message,
    content_of,
    random_bytes,
)
from sfglab.processes import Member, ProcessFailedError, ProcessGroup

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Sequence

    from sfglab.lab.bench import Bench

TIMEOUT_S = 20.0  #: Longest time that one message may take.
TRANSPORTS = ("smt", "gateway")
_STEP_BYTES = 8
_MODULE = "sfglab.lab.workers.crossing"
_NOT_MAPPED = ("software", "subscriber")  # These processes do not map the hardware side's memory.


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A `Cell` is one bar of Fig. 6 and 7, measured over both transports."""

    publisher: str  #: Side of the publisher: ``software`` or ``hardware``.
    message_bytes: int  #: Size of the message, bytes.
    subscribers: int  #: Number of subscribing processes on the hardware side.


def cells_of(config: Config) -> list[Cell]:
    """Return the cells of a configuration: each side, number of subscribers and message size."""
    bars = product(("hardware", "software"), config.live_subscribers, config.live_bytes)
    return [
        Cell(publisher=side, message_bytes=size, subscribers=count) for side, count, size in bars
    ]


class Crossing(ProcessGroup):
    """A `Crossing` runs the publishing, forwarding and subscribing processes of Fig. 5 in paper C.

    No socket, pipe or memory of a process has a name, so none remains.

    Args:
        readers: Largest number of subscribers on the hardware side.
        largest_bytes: Size of the largest message, bytes.
        seed: Seed of the contents.
    """

    def __init__(self, readers: int, largest_bytes: int, seed: int) -> None:
        super().__init__()
        self._readers = [f"reader{i}" for i in range(readers)]
        self._largest_bytes = largest_bytes
        self._seed = seed
        self._data = random_bytes(largest_bytes, seed)
        self._messages = 0

    async def settle(self) -> None:
        """Start the processes, each with its ends of the links."""
        # The parent closes its copies of the ends at once, so a link ends with the process at the link's other end.
        with ExitStack() as passed:
            links = self._links(passed)
            shared = os.memfd_create("sfglab-crossing")
            passed.callback(os.close, shared)
            os.ftruncate(shared, self._largest_bytes)
            members = [self._member(name, ends, shared) for name, ends in links.items()]
            await self.start(*members)

    def _links(self, passed: ExitStack) -> dict[str, dict[str, int]]:
        """Return the file descriptors of each process by link: sockets, and pipes that wake a process."""
        hardware = ["gateway", *self._readers]
        names = ["software", "subscriber", "publisher", *hardware]
        links: dict[str, dict[str, int]] = {name: {} for name in names}
        for name in names[1:]:
            ours, theirs = socket.socketpair()
            passed.enter_context(ours)
            passed.enter_context(theirs)
            links["software"][name] = ours.fileno()
            links[name]["software"] = theirs.fileno()
        for name in hardware:
            read, write = os.pipe()
            passed.callback(os.close, read)
            passed.callback(os.close, write)
            links[name]["wake"] = read
            for waker in {"publisher", "gateway"} - {name}:
                links[waker][f"wake_{name}"] = write
        return links

    def _member(self, name: str, ends: dict[str, int], shared: int) -> Member:
        memory = [] if name in _NOT_MAPPED else [shared]
        config = CrossingConfig(
            role="reader" if name in self._readers else name,
            links=ends,
            shared=shared if memory else -1,
            largest_bytes=self._largest_bytes,
            seed=self._seed,
        )
        return Member(name=name, module=_MODULE, config=config, pass_fds=(*ends.values(), *memory))

    async def close(self) -> None:
        """End all processes."""
        for name in self:
            # A process that waits for a link does not read its standard input.
            self[name].signal(signal.SIGTERM)
        await super().close()

    async def carry(self, message: Message) -> dict[str, int]:
        """Transfer one message and check the message's content at all subscribers.

        Returns:
            The time from the publication until a subscriber has read the message, ns, by the subscriber's name.

        Raises:
            ProcessFailedError: A process ended, a process was late, or the content at a subscriber is wrong.
        """
        addressed = {*message.order, *message.woken}
        subscribers = [name for name in ("subscriber", *self._readers) if name in addressed]
        source = "publisher" if message.publisher == "hardware" else "software"
        involved = {*addressed, "software", source}
        await self.ask("armed", involved, timeout_s=TIMEOUT_S, do="transfer", **asdict(message))
        self[source].order(do="go")
        done = await self.expect("done", involved, timeout_s=TIMEOUT_S)
        contents = await self.ask("content", subscribers, timeout_s=TIMEOUT_S, do="check")
        wanted = zlib.crc32(content_of(self._data, message))
        wrong = [name for name in subscribers if contents[name]["crc"] != wanted]
        if wrong:
            names = ", ".join(wrong)
            raise ProcessFailedError(f"crossing: wrong content at {names} after {message}")
        began_ns = done[source]["began_ns"]
        return {name: done[name]["done_ns"] - began_ns for name in subscribers}

    async def measure(
        self, cell: Cell, transport: str, repeat: int, rng: np.random.Generator
    ) -> CrossingRow:
        """Measure one message of a cell over a transport.

        The order of deliveries is random, because the paper states no order.
        """
        load = os.getloadavg()[0]
        took_ns = await self.carry(self._message(cell, transport, rng))
        software_ns = took_ns.pop("subscriber")
        return CrossingRow(
            repeat=repeat,
            transport=transport,
            hardware_ns=max(took_ns.values()),
            software_ns=software_ns,
            load=load,
            **asdict(cell),
        )

    def _message(self, cell: Cell, transport: str, rng: np.random.Generator) -> Message:
        readers = self._readers[: cell.subscribers]
        delivered = ["subscriber"]
        woken: list[str] = []
        if transport == "smt":
            delivered += readers
        elif cell.publisher == "software":
            delivered += ["gateway"]
            woken += readers
        else:
            woken += [*readers, "gateway"]
        self._messages += 1
        return Message(
            publisher=cell.publisher,
            gateway=transport == "gateway",
            message_bytes=cell.message_bytes,
            offset=self._messages * _STEP_BYTES % SPARE_BYTES,
            order=_shuffled(delivered, rng),
            woken=_shuffled(woken, rng),
        )


def _shuffled(names: Sequence[str], rng: np.random.Generator) -> tuple[str, ...]:
    return tuple(names[i] for i in rng.permutation(len(names)))


async def crossings(config: Config) -> AsyncGenerator[CrossingRow]:
    """Measure all cells in each repetition; the two transports of a cell follow each other directly.

    The order of cells and of transports is random.

    Raises:
        ProcessFailedError: A process failed, or a message arrived with wrong content.
    """
    rng = np.random.default_rng(config.seed)
    cells = cells_of(config)
    readers, largest_bytes = max(config.live_subscribers), max(config.live_bytes)
    async with Crossing(readers, largest_bytes, config.seed) as crossing:
        # The first message of a cell takes longer than later messages, so the experiment does not measure this message.
        for cell in cells:
            for transport in TRANSPORTS:
                await crossing.measure(cell, transport, -1, rng)
        for repeat in range(config.live_rounds):
            for place in rng.permutation(len(cells)):
                for transport in _shuffled(TRANSPORTS, rng):
                    yield await crossing.measure(cells[place], transport, repeat, rng)


def message_count(config: Config) -> int:
    """Return the number of measured messages."""
    return len(cells_of(config)) * len(TRANSPORTS) * config.live_rounds


@exp.part("live", total=message_count, timed=False)
async def measure_live(bench: Bench[Config]) -> None:
    """Measure the transfer times of messages between processes."""
    if not bench.config.live_rounds:
        return
    async with aclosing(crossings(bench.config)) as rows:
        async for row in rows:
            bench.write(row)
            bench.advance(f"{row.publisher}, {row.message_bytes} B")
