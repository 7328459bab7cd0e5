"""The stage: a scene shown from a log and from the bus; a camera, a sink, and the bridge between them.

Pictures of 640 x 360 (691 kB) come 30 times a second over DDS; the sink is a server in a third process. The
baseline is Rerun's own call to the same sink. A picture has been taken when a flush after it returns.
"""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np
import psutil

from sfglab.bus import Node
from sfglab.component import beside
from sfglab.lab.checks.fleet_scene import PERIOD_NS, RECEIVED_AFTER_NS, START_NS, Part
from sfglab.lab.checks.recordings import Recording, read_recording
from sfglab.lab.workers.scene_publisher import (
    CAMERA_HZ,
    CAMERA_TOPIC,
    ScenePublisherConfig,
    picture,
)
from sfglab.processes import Member, ProcessFailedError, ProcessGroup
from sfglab.qos import DEFAULT
from sfglab.record import LogWriter
from sfglab.view.app import ViewOptions, session_for, view_live
from sfglab.view.bridge import Bridge
from sfglab.view.rerunning import WINDOW_BYTES, RerunCanvas, rerun
from sfglab.view.session import Display, Session

if TYPE_CHECKING:
    from pathlib import Path

ADDED_MS = 5.0
"""What the bridge may add to a picture of 640 x 360, ms, at the median and at 99 %; the paper states none."""
PICTURE_BYTES = 640 * 360 * 3
BOUND_BYTES = WINDOW_BYTES + 2 * PICTURE_BYTES
"""What may wait at most: a window of drawn pictures, the one that fills it, and one that waits for its turn."""

_REACH_S = 60.0
_LATCHED = ("tf_static", "agent_status", "communication")
"""Reliable by themselves, and they ask for the past, too."""
_SAMPLE_S = 0.05
_RUNS_S = 0.8
_READY_S = 15.0


def member(role: str, **values: Any) -> Member:
    """Return a process of a role of `sfglab.lab.workers.scene_publisher`."""
    config = ScenePublisherConfig(role=role, **values)
    return Member(name=role, module="sfglab.lab.workers.scene_publisher", config=config)


def processes(*members: Member) -> ProcessGroup:
    """Return processes on this host that end with a block."""
    return ProcessGroup(members)


def write_scene(parts: tuple[Part, ...], path: Path) -> None:
    """Write the scene's messages as a log, in the order of their stamps."""
    with LogWriter(path) as log:
        for number, messages in enumerate(zip(*(part.messages for part in parts), strict=True)):
            at_ns = START_NS + number * PERIOD_NS + RECEIVED_AFTER_NS
            for part, message in zip(parts, messages, strict=True):
                if message is not None:
                    log.write(part.topic, message, log_time_ns=at_ns)


async def show_live(parts: tuple[Part, ...], scene: Path, to: Path, domain_id: int) -> Recording:
    """Show the scene while another process sends it over DDS, into a file, and read that.

    The next moment is sent when the last one has been drawn, and everything is reliable.
    """
    session = _reliable_session(parts)
    async with (
        Node("view", domain_id=domain_id, interface="lo") as node,
        processes() as group,
        beside(view_live(node, ViewOptions(to=(str(to),)), session=session)),
    ):
        await group.start(member("scene", domain_id=domain_id, path=str(scene)))
        sent: Counter[str] = Counter()
        for _ in range(group["scene"].readiness["moments"]):
            sent.update((await group.ask("sent", timeout_s=_REACH_S, do="next"))["scene"]["topics"])
            await _drawn(session, sent)
    return read_recording(to)


def _reliable_session(parts: tuple[Part, ...]) -> Session:
    session = session_for({part.topic: part.type for part in parts}, ViewOptions())
    for display in session.displays:
        session.limit(display.id, None)
        if display.visualizer.name not in _LATCHED:
            session.rewire(display.id, qos=dict.fromkeys(display.visualizer.topics, DEFAULT))
    return session


async def _drawn(session: Session, sent: Counter[str]) -> None:
    """Wait until every display has what was sent of its topics.

    Raises:
        ProcessFailedError: It did not arrive.
    """
    late: list[str] = []
    for _ in range(round(_REACH_S / 0.01)):
        wanted = [(d, sum(sent[t] for t in d.visualizer.topics.values())) for d in session.displays]
        late = [d.id for d, count in wanted if d.slot.counts.received < count]
        if not late and not any(len(d.slot) for d, _ in wanted):
            return
        await asyncio.sleep(0.01)
    missing = ", ".join(late) or "drawing"
    raise ProcessFailedError(f"scene: within {_REACH_S:g} s there is still missing: {missing}")


class _Timed:
    """A canvas that waits for the sink after each picture, and notes how long it took since its arrival."""

    def __init__(self, canvas: RerunCanvas) -> None:
        self._canvas, self._received_ns = canvas, 0
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


async def time_pictures(
    canvas: RerunCanvas, domain_id: int, *, rounds: int, pictures: int
) -> list[dict[str, Any]]:
    """Time so many pictures of both arms in turn, so that other load on the machine falls on both."""
    rows = list[dict[str, Any]]()
    for number in range(rounds):
        bare = await asyncio.to_thread(_bare, canvas, pictures)
        bridge = await _through_bridge(canvas, domain_id, pictures)
        for arm, taken in (("bare", bare), ("bridge", bridge)):
            rows += [
                {"arm": arm, "round": number, "number": i, "taken_ms": ms}
                for i, ms in enumerate(taken)
            ]
    return rows


def _bare(canvas: RerunCanvas, pictures: int) -> list[float]:
    rr, array, taken_ms = rerun(), picture(), list[float]()
    next_s = time.monotonic()
    for _ in range(pictures):
        start_ns = time.time_ns()
        canvas.recording.set_time("received", timestamp=np.datetime64(start_ns, "ns"))
        canvas.recording.log("/bare", rr.Image(array, "RGB"))
        canvas.recording.flush()
        taken_ms.append((time.time_ns() - start_ns) / 1e6)
        next_s += 1 / CAMERA_HZ
        time.sleep(max(0.0, next_s - time.monotonic()))
    return taken_ms


def _look() -> tuple[Session, Display]:
    session = Session()
    display = session.add("image", CAMERA_TOPIC)
    session.limit(display.id, None)
    return session, display


async def _through_bridge(canvas: RerunCanvas, domain_id: int, pictures: int) -> list[float]:
    timed, (session, _) = _Timed(canvas), _look()
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
) -> list[dict[str, Any]]:
    """Show pictures to a sink that is stopped for a while, and note what waits.

    The canvas goes to the sink, which runs for a while before and after.
    """
    (session, display), rows, is_stopped = _look(), list[dict[str, Any]](), False
    async with (
        Node("view", domain_id=domain_id, interface="lo") as node,
        Bridge(node, session, canvas),
    ):
        start_s = time.monotonic()
        while not display.slot.counts.shown and time.monotonic() - start_s < _READY_S:  # noqa: ASYNC110 - no event
            await asyncio.sleep(_SAMPLE_S)
        start_s = time.monotonic()
        try:
            while (at_s := time.monotonic() - start_s) < 2 * _RUNS_S + stopped_s:
                due = _RUNS_S <= at_s < _RUNS_S + stopped_s
                if due != is_stopped:
                    is_stopped = due
                    os.kill(sink_pid, signal.SIGSTOP if due else signal.SIGCONT)
                rows.append({"at_s": at_s, "stopped": is_stopped, **_waiting(display, canvas)})
                await asyncio.sleep(_SAMPLE_S)
        finally:
            os.kill(sink_pid, signal.SIGCONT)
    return rows


def _waiting(display: Display, canvas: RerunCanvas) -> dict[str, int]:
    counts = display.slot.counts
    return {
        "queued_bytes": canvas.pending_bytes + counts.waiting * PICTURE_BYTES,
        "resident_bytes": psutil.Process().memory_info().rss,
        **{name: getattr(counts, name) for name in ("received", "shown", "dropped")},
    }
