"""A host's parts of scenarios as a process: ``python -m sfglab.lab.workers.robotparts CONFIG``.

The sensing nodes of a robot, or the station's localisation and planning, as `flowplay` plays them. Orders, one
scenario after the other: ``{"do": "open", "flows", "seed"}`` is answered by ``matched`` when every endpoint has
its other end, ``{"do": "play", "start_ns", "duration_s", "drain_s", "result"}`` by ``done`` with how well it
kept its schedule, after its arrays are in the file ``result`` (NumPy's npz), ``{"do": "close"}`` by ``closed``.
"""

from __future__ import annotations

import asyncio
import ctypes
import resource
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.address import BusAddress
from sfglab.component import run_component
from sfglab.lab.workers.flowplay import PartFlow, Player

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.component import Report


_LOOK_S = 0.02
_PR_SET_TIMERSLACK = 29  # linux/prctl.h


@dataclass(frozen=True, slots=True, kw_only=True)
class PartsConfig:
    """What the process is told."""

    host: str  #: Its name, for messages.
    address: BusAddress  #: Where it stands, to the others.


class Parts:
    """The process's side of its orders.

    Args:
        config: What it was told.
        report: Takes what is reported.
    """

    def __init__(self, config: PartsConfig, report: Callable[[Report], None]) -> None:
        self._config = config
        self._report = report

    async def run(self, orders: asyncio.Queue[Report]) -> None:
        """Obey until cancelled."""
        from sfglab.bus.dds.domain import DomainConfig
        from sfglab.bus.dds.participant import DdsParticipant

        config = self._config
        domain = DomainConfig(**config.address.options())
        self._report({"is": "ready"})
        while True:
            order = await orders.get()
            participant = DdsParticipant(domain, b"", name=f"{config.host}.dds", after_round=lambda: None)
            try:
                flows = [PartFlow(**flow) for flow in order["flows"]]
                await self._serve(Player(participant, flows, seed=order["seed"]), orders)
            finally:
                await asyncio.to_thread(participant.close)
            self._report({"is": "closed"})

    async def _serve(self, player: Player, orders: asyncio.Queue[Report]) -> None:
        """Play one scenario."""
        while not player.matched():  # noqa: ASYNC110 - nobody tells: the status is Cyclone's
            await asyncio.sleep(_LOOK_S)
        self._report({"is": "matched"})
        order = await orders.get()
        busy_s = await asyncio.to_thread(_play, player, order)
        np.savez(order["result"], **_arrays(player))
        self._report({"is": "done", "busy_s": busy_s, "take_s": player.take_s, **_kept(player)})
        await orders.get()  # to close: it stays matched until everybody is done


def _play(player: Player, order: Report) -> float:
    """Play, and return the processor time that it took, seconds."""
    ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    before_s = _cpu_s()
    player.play(start_ns=order["start_ns"], duration_s=order["duration_s"], drain_s=order["drain_s"])
    return _cpu_s() - before_s


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _arrays(player: Player) -> dict[str, Any]:
    arrays = {}
    for name, written in player.written.items():
        for column in ("due_ns", "sent_ns", "value"):
            arrays[f"{name} written {column}"] = np.array(getattr(written, column), np.int64)
    for name, received in player.received.items():
        for column in ("sent_ns", "taken_ns", "done_ns"):
            arrays[f"{name} received {column}"] = np.array(getattr(received, column), np.int64)
    return arrays


def _kept(player: Player) -> dict[str, Any]:
    """Return how well publishing kept its schedule, and what caches did."""
    delays = [s - d for w in player.written.values() for s, d in zip(w.sent_ns, w.due_ns, strict=True)]
    return {
        "late_p95_s": float(np.percentile(delays, 95)) / 1e9 if delays else 0.0,
        "held": sum(w.held for w in player.written.values()),
        "refused": sum(w.refused for w in player.written.values()),
        "compared": sum(r.compared for r in player.received.values()),
    }


async def serve(config: PartsConfig, report: Callable[[Report], None], orders: asyncio.Queue[Report]) -> None:
    """Be the process."""
    await Parts(config, report).run(orders)


if __name__ == "__main__":
    run_component(PartsConfig, serve)
