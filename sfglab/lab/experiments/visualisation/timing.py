"""What the bridge adds to a picture on its way to a viewer, and what waits when the viewer stands still.

A picture of 640 x 360 (691 kB) comes 30 times a second from another process over DDS; the sink is a server in a
third process. The baseline is Rerun's own call with the same array, to the same sink, in the same run. A
picture has been taken when a flush after it returns.
"""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import time
from contextlib import asynccontextmanager, closing
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus import Node
from sfglab.lab.experiments.visualisation.rows import VisualisationMemoryRow, VisualisationTimeRow
from sfglab.lab.experiments.visualisation.showing import process
from sfglab.lab.workers.sights import CAMERA_HZ, CAMERA_TOPIC, picture
from sfglab.view import Bridge, Session, open_canvas
from sfglab.view.rerunning import rerun

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterator

    from sfglab.view import Display, RerunCanvas


PICTURE_BYTES = 640 * 360 * 3
_SAMPLE_S = 0.05
_RUNS_S = 0.8
_READY_S = 15.0


class _Timed:
    """A canvas that waits for the sink after each picture, and notes how long it took since its arrival."""

    def __init__(self, canvas: RerunCanvas) -> None:
        self._canvas = canvas
        self._received_ns = 0
        self.taken_ms: list[float] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._canvas, name)

    def at(self, *, stamp_ns: int, received_ns: int) -> None:
        self._received_ns = received_ns
        self._canvas.at(stamp_ns=stamp_ns, received_ns=received_ns)

    def settle(self, size_bytes: int) -> None:
        if size_bytes:
            self._canvas.flush()
            self.taken_ms.append((time.time_ns() - self._received_ns) / 1e6)

    def close(self) -> None:
        """Leave the canvas open for the next round."""


def free_port() -> int:
    """Return a TCP port of this host that nobody listens at."""
    with closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@asynccontextmanager
async def sink_process() -> AsyncIterator[tuple[RerunCanvas, int]]:
    """Have a sink in another process: yields a canvas that goes there, and the id of that process."""
    port = free_port()
    async with process("sink", str(port)) as sink:
        await sink.expect("ready", timeout_s=_READY_S)
        with closing(open_canvas([f"rerun+http://127.0.0.1:{port}/proxy"])) as canvas:
            yield canvas, sink.pid


async def time_pictures(
    canvas: RerunCanvas, domain_id: int, *, rounds: int, pictures: int
) -> list[VisualisationTimeRow]:
    """Time both arms in turn, so that other load on the machine falls on both.

    Args:
        canvas: Goes to the sink.
        domain_id: The camera's DDS domain.
        rounds: How often.
        pictures: Of an arm, in a round.
    """
    rows = list[VisualisationTimeRow]()
    for number in range(rounds):
        bare = await asyncio.to_thread(_bare, canvas, pictures)
        bridge = await _through_bridge(canvas, domain_id, pictures)
        rows += [*_rows("bare", number, bare), *_rows("bridge", number, bridge)]
    return rows


def _rows(arm: str, round_: int, taken_ms: list[float]) -> Iterator[VisualisationTimeRow]:
    for number, taken in enumerate(taken_ms):
        yield VisualisationTimeRow(arm=arm, round=round_, number=number, taken_ms=taken)


def _bare(canvas: RerunCanvas, pictures: int) -> list[float]:
    rr, array, taken = rerun(), picture(), []
    next_s = time.monotonic()
    for _ in range(pictures):
        start_ns = time.time_ns()
        canvas.recording.set_time("received", timestamp=np.datetime64(start_ns, "ns"))
        canvas.recording.log("/bare", rr.Image(array, "RGB"))
        canvas.recording.flush()
        taken.append((time.time_ns() - start_ns) / 1e6)
        next_s += 1 / CAMERA_HZ
        time.sleep(max(0.0, next_s - time.monotonic()))
    return taken


def _look(session: Session) -> Display:
    display = session.add("image", CAMERA_TOPIC)
    session.limit(display.id, None)
    return display


async def _through_bridge(canvas: RerunCanvas, domain_id: int, pictures: int) -> list[float]:
    timed, session = _Timed(canvas), Session()
    _look(session)
    async with (
        Node("view", domain_id=domain_id, interface="lo") as node,
        Bridge(node, session, timed),
        asyncio.timeout(_READY_S + 10 * pictures / CAMERA_HZ),
    ):
        while len(timed.taken_ms) < pictures:  # noqa: ASYNC110 - drawn in another thread
            await asyncio.sleep(_SAMPLE_S)
    return timed.taken_ms[:pictures]


async def watch_memory(
    canvas: RerunCanvas, sink_pid: int, domain_id: int, *, stopped_s: float
) -> list[VisualisationMemoryRow]:
    """Show pictures to a sink that is stopped for a while, and note what waits.

    Args:
        canvas: Goes to the sink; closed afterwards.
        sink_pid: The sink's process.
        domain_id: The camera's DDS domain.
        stopped_s: How long it is stopped; it runs for a second before and after.
    """
    session = Session()
    display = _look(session)
    async with Node("view", domain_id=domain_id, interface="lo") as node, Bridge(node, session, canvas):
        return await _watched(display, canvas, sink_pid, stopped_s)


async def _watched(
    display: Display, canvas: RerunCanvas, sink_pid: int, stopped_s: float
) -> list[VisualisationMemoryRow]:
    import psutil

    rows, me = list[VisualisationMemoryRow](), psutil.Process()
    start_s = time.monotonic()
    while not display.slot.counts.shown and time.monotonic() - start_s < _READY_S:  # noqa: ASYNC110 - no event
        await asyncio.sleep(_SAMPLE_S)
    start_s, is_stopped = time.monotonic(), False
    try:
        while (at_s := time.monotonic() - start_s) < 2 * _RUNS_S + stopped_s:
            due = _RUNS_S <= at_s < _RUNS_S + stopped_s
            if due != is_stopped:
                is_stopped = due
                os.kill(sink_pid, signal.SIGSTOP if due else signal.SIGCONT)
            rows.append(_memory_row(display, canvas, me.memory_info().rss, at_s, stopped=is_stopped))
            await asyncio.sleep(_SAMPLE_S)
    finally:
        os.kill(sink_pid, signal.SIGCONT)
    return rows


def _memory_row(
    display: Display, canvas: RerunCanvas, resident_bytes: int, at_s: float, *, stopped: bool
) -> VisualisationMemoryRow:
    counts = display.slot.counts
    return VisualisationMemoryRow(
        at_s=at_s,
        stopped=stopped,
        queued_bytes=canvas.pending_bytes + counts.waiting * PICTURE_BYTES,
        resident_bytes=resident_bytes,
        received=counts.received,
        shown=counts.shown,
        dropped=counts.dropped,
    )
