"""The same question on this machine: processes on both sides of a boundary that a message is copied across.

Over a software-mapped topic every reader on the hardware's side gets a copy by a socket of its own; through a
gateway one copy crosses into memory that they share. This is no memory interface: processes share the cores.
"""

from __future__ import annotations

import os
import signal
import socket
import zlib
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.workers.crossing import SPARE_BYTES, CrossingConfig, Round, message_of, random_bytes
from sfglab.processes import Member, ProcessFailedError, ProcessGroup

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator

    from sfglab.lab.experiments.transfer.experiment import Config

TIMEOUT_S = 20.0
_STEP_BYTES = 8
_MODULE = "sfglab.lab.workers.crossing"


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """What is asked of both kinds of topic."""

    publisher: str  #: ``software`` or ``hardware``.
    message_bytes: int  #: Size of the message.
    subscribers: int  #: Subscribing processes on the hardware's side.


def cells_of(config: Config) -> list[Cell]:
    """Return every cell once."""
    cells = product(("hardware", "software"), config.live_subscribers, config.live_bytes)
    return [
        Cell(publisher=side, message_bytes=size, subscribers=count) for side, count, size in cells
    ]


class Crossing(ProcessGroup):
    """The processes of Fig. 5, with so many readers on the hardware's side at most.

    Their sockets and shared memory have no names, so nothing outlives them. The seed is that of the contents.
    """

    def __init__(self, readers: int, largest_bytes: int, seed: int) -> None:
        self._readers = [f"reader{i}" for i in range(readers)]
        self._largest_bytes, self._seed = largest_bytes, seed
        self._data = random_bytes(largest_bytes, seed)
        self._rounds = 0
        super().__init__()

    async def settle(self) -> None:
        """Start the processes, each with its ends of the links."""
        # What is passed on is closed here at once: a link ends when the process at its other end does.
        with ExitStack() as passed:
            shared, links = self._links(passed)
            await self.start(*(self._member(name, ends, shared) for name, ends in links.items()))

    async def close(self) -> None:
        """End all processes."""
        for name in self:
            # A process that waits for a link does not look at its standard input.
            self[name].signal(signal.SIGTERM)
        await super().close()

    async def carry(self, item: Round) -> dict[str, Any]:
        """Carry one message, check what arrived, and return by name how long each receiver took to have it, ns.

        Raises:
            ProcessFailedError: A process ended or stayed silent, or a content is not what was published.
        """
        readers = sum(name.startswith("reader") for name in (*item.order, *item.woken))
        receivers = [*self._readers[:readers], "subscriber"]
        source = "publisher" if item.publisher == "hardware" else "software"
        involved = {*receivers, "software", source, *(["gateway"] if item.gateway else [])}
        wanted = zlib.crc32(message_of(self._data, item))
        limit = {"timeout_s": TIMEOUT_S}
        await self.ask("armed", involved, **limit, do="round", **asdict(item))
        self[source].order(do="go")
        done = await self.expect("done", involved, **limit)
        contents = await self.ask("content", receivers, **limit, do="check")
        wrong = [name for name in receivers if contents[name]["crc"] != wanted]
        if wrong:
            raise ProcessFailedError(
                f"crossing: {', '.join(wrong)} did not get what was published, in {item}"
            )
        return {name: done[name]["done_ns"] - done[source]["began_ns"] for name in receivers}

    async def measure(
        self, cell: Cell, rng: np.random.Generator, *, gateway: bool
    ) -> dict[str, Any]:
        """Carry one message of a cell, through a gateway or over a software-mapped topic; return its row.

        The repetition is left out. The order of deliveries is drawn: the paper does not state one.
        """
        readers, load = self._readers[: cell.subscribers], os.getloadavg()[0]
        item = _round(cell, readers, rng, gateway=gateway, number=self._rounds)
        self._rounds += 1
        took_ns = await self.carry(item)
        return {
            **asdict(cell),
            "transport": "gateway" if gateway else "smt",
            "place": item.order.index("subscriber"),
            "hardware_ns": max(took_ns[name] for name in readers),
            "software_ns": took_ns["subscriber"],
            "load": load,
        }

    def _links(self, passed: ExitStack) -> tuple[int, dict[str, dict[str, int]]]:
        """Return the shared memory and everybody's ends of all links."""
        names = ["software", "subscriber", "publisher", "gateway", *self._readers]
        links: dict[str, dict[str, int]] = {name: {} for name in names}
        for name in names[1:]:
            ours, theirs = socket.socketpair()
            passed.enter_context(ours)
            passed.enter_context(theirs)
            links["software"][name], links[name]["software"] = ours.fileno(), theirs.fileno()
        for name in ("gateway", *self._readers):
            read, write = os.pipe()
            passed.callback(os.close, read)
            passed.callback(os.close, write)
            links[name]["wake"] = read
            for waker in ("publisher", "gateway"):
                if waker != name:
                    links[waker][f"wake_{name}"] = write
        shared = os.memfd_create("sfglab-crossing")
        passed.callback(os.close, shared)
        os.ftruncate(shared, self._largest_bytes)
        return shared, links

    def _member(self, name: str, ends: dict[str, int], shared: int) -> Member:
        memory = () if name in {"software", "subscriber"} else (shared,)
        config = CrossingConfig(
            role="reader" if name in self._readers else name,
            links=ends,
            shared=memory[0] if memory else -1,
            largest_bytes=self._largest_bytes,
            seed=self._seed,
        )
        return Member(name=name, module=_MODULE, config=config, pass_fds=(*ends.values(), *memory))


def _round(
    cell: Cell, readers: list[str], rng: np.random.Generator, *, gateway: bool, number: int
) -> Round:
    """Return a cell's message: who gets it from whom, in drawn orders."""
    delivered, woken = [*readers, "subscriber"], []
    if gateway:
        delivered = ["subscriber", *(["gateway"] if cell.publisher == "software" else [])]
        woken = [*readers, *(["gateway"] if cell.publisher == "hardware" else [])]
    return Round(
        publisher=cell.publisher,
        gateway=gateway,
        message_bytes=cell.message_bytes,
        offset=number * _STEP_BYTES % SPARE_BYTES,
        order=tuple(str(name) for name in rng.permutation(delivered)),
        woken=tuple(str(name) for name in rng.permutation(woken)) if woken else (),
    )


async def crossings(config: Config) -> AsyncGenerator[dict[str, Any]]:
    """Measure every cell in every repetition, both kinds of topic in drawn order right after each other.

    Raises:
        ProcessFailedError: A process failed, or a message arrived wrong.
    """
    rng = np.random.default_rng(config.seed)
    cells = cells_of(config)
    async with Crossing(
        max(config.live_subscribers), max(config.live_bytes), config.seed
    ) as crossing:
        for cell in cells:
            # Unmeasured: what only the first message of a cell costs is not asked here.
            for gateway in (False, True):
                await crossing.measure(cell, rng, gateway=gateway)
        for repeat in range(config.live_rounds):
            for place in rng.permutation(len(cells)):
                for gateway in rng.permutation([False, True]):
                    yield {
                        **await crossing.measure(cells[place], rng, gateway=bool(gateway)),
                        "repeat": repeat,
                    }
