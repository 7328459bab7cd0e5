"""The bridge while a camera sends: displays that change, and the time until a sink has a picture.

The camera sends pictures of 640 x 360 (691 kB) 30 times a second over DDS. The sink is a server in a process of
its own, as a viewer is; it has a picture when a flush after it returns. The baseline is Rerun's own call to the
same sink.
"""

from __future__ import annotations

import asyncio
import time
from contextlib import closing, suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus import Node
from sfglab.errors import InvalidValueError
from sfglab.lab.workers.picture_flow import CAMERA_HZ, CAMERA_TOPIC, PictureFlowConfig, picture
from sfglab.processes import Member
from sfglab.qos import DEFAULT, Reliability
from sfglab.view.bridge import Bridge
from sfglab.view.rerunning import RerunCanvas, new_recording, rr
from sfglab.view.session import Session

if TYPE_CHECKING:
    from collections.abc import Callable

_SOON_S = 5.0
_SILENCE_S = 0.3
_SAMPLE_S = 0.05
_READY_S = 15.0


def member(role: str, **values: Any) -> Member:
    """Return a process of a role of `sfglab.lab.workers.picture_flow`."""
    config = PictureFlowConfig(role=role, **values)
    return Member(name=role, module="sfglab.lab.workers.picture_flow", config=config)


class MemoryCanvas:
    """A canvas that keeps what is drawn on it."""

    def __init__(self) -> None:
        self.drawn: list[tuple[int, Any]] = []  #: Time stamp (ns) and archetype.
        self._stamp_ns = 0

    def at(self, *, stamp_ns: int, received_ns: int) -> None:  # noqa: ARG002 - a canvas's signature
        """Set the time."""
        self._stamp_ns = stamp_ns

    def log(self, entity: str, *what: Any, static: bool = False) -> None:  # noqa: ARG002 - likewise
        """Keep it."""
        self.drawn += [(self._stamp_ns, each) for each in what]

    def place(self, entity: str, frame: str) -> None:
        """Nothing is placed."""

    def settle(self, size_bytes: int) -> None:
        """Nothing is on its way."""

    def close(self) -> None:
        """Nothing is open."""

    async def draws_again(self) -> bool:
        """Wait for the next picture."""
        self.drawn.clear()
        return await _until(lambda: bool(self.drawn))

    async def has_opacity(self, opacity: float) -> bool:
        """Wait for a picture with this opacity."""
        return await _until(
            lambda: self.drawn[-1][1].opacity.as_arrow_array()[0].as_py() == opacity
        )


async def _until(holds: Callable[[], bool]) -> bool:
    """Wait until something holds; return whether it did."""
    end_s = time.monotonic() + _SOON_S
    while not (held := holds()) and time.monotonic() < end_s:  # noqa: ASYNC110 - no event tells of it
        await asyncio.sleep(0.01)
    return held


async def try_changes(domain_id: int) -> dict[str, dict[str, bool]]:
    """Return what holds of a display that changes while the camera sends, by kind of change."""
    session = Session()
    canvas = MemoryCanvas()
    async with (
        Node("view", domain_id=domain_id, interface="lo") as node,
        Node("observer", domain_id=domain_id, interface="lo") as observer,
        Bridge(node, session, canvas),
    ):

        async def is_requested(*wanted: Reliability) -> bool:
            """Wait until the observer sees these subscriptions on the camera's topic, and no others."""
            graph = observer.graph
            return await _until(
                lambda: (
                    wanted == tuple(e.qos.reliability for e in graph.subscriptions(CAMERA_TOPIC))
                )
            )

        display = session.add("image", CAMERA_TOPIC)
        shown = {
            "added: drawn": await canvas.draws_again(),
            "added: subscribed": await is_requested(Reliability.BEST_EFFORT),
        }
        tuned = {"before": await canvas.has_opacity(1.0)}
        session.tune(display.id, "opacity", 0.25)
        tuned["after"] = await canvas.has_opacity(0.25)
        tuned["what is not allowed is refused"] = _is_refused(session, display.id)
        session.request(display.id, "image", DEFAULT)
        requested = {
            "requested": await is_requested(Reliability.RELIABLE),
            "drawn": await canvas.draws_again(),
        }
        session.remove(display.id)
        shown["removed: unsubscribed"] = await is_requested()
        canvas.drawn.clear()
        await asyncio.sleep(_SILENCE_S)
        shown["removed: nothing is drawn"] = not canvas.drawn
    return {"display": shown, "parameter": tuned, "qos": requested}


def _is_refused(session: Session, id_: str) -> bool:
    """Return whether an opacity that is not allowed is refused, and the one before stays."""
    with suppress(InvalidValueError):
        session.tune(id_, "opacity", 7.0)
    return session.display(id_).visualizer.settings["opacity"] == 0.25


class _TimedCanvas(RerunCanvas):
    """A canvas that waits for the sink after each picture, and notes how long it took since its arrival."""

    def __init__(self, recording: Any, to: list[str]) -> None:
        super().__init__(recording, to)
        self.taken_ms: list[float] = []

    def settle(self, size_bytes: int) -> None:
        """Wait for the sink."""
        if size_bytes:
            self.flush()
            self.taken_ms.append((time.time_ns() - self._now_ns) / 1e6)

    def close(self) -> None:
        """Leave the recording open for the next round."""


async def time_pictures(
    port: int, domain_id: int, *, rounds: int, pictures: int
) -> list[dict[str, Any]]:
    """Return the times of pictures of both arms, taken in turn, so that other load on the machine affects both.

    Args:
        port: Port of the sink.
        domain_id: Domain of the camera.
        rounds: Number of rounds.
        pictures: Pictures of an arm in one round.
    """
    recording, address = new_recording("delay"), f"rerun+http://127.0.0.1:{port}/proxy"
    recording.set_sinks(rr.GrpcSink(address))
    rows = []
    with closing(RerunCanvas(recording, [address])):
        for number in range(rounds):
            canvas = _TimedCanvas(recording, [address])
            arms = {
                "bare": await asyncio.to_thread(_bare, recording, pictures),
                "bridge": await _through_bridge(canvas, domain_id, pictures),
            }
            for arm, taken_ms in arms.items():
                for picture_number, ms in enumerate(taken_ms):
                    row = {"arm": arm, "round": number, "number": picture_number, "taken_ms": ms}
                    rows.append(row)
    return rows


def _bare(recording: Any, pictures: int) -> list[float]:
    """Return the times of Rerun's own call, ms."""
    array = picture()
    taken_ms = []
    next_s = time.monotonic()
    for _ in range(pictures):
        start_ns = time.time_ns()
        recording.set_time("received", timestamp=np.datetime64(start_ns, "ns"))
        recording.log("/bare", rr.Image(array, "RGB"))
        recording.flush()
        taken_ms.append((time.time_ns() - start_ns) / 1e6)
        next_s += 1 / CAMERA_HZ
        time.sleep(max(0.0, next_s - time.monotonic()))
    return taken_ms


async def _through_bridge(canvas: _TimedCanvas, domain_id: int, pictures: int) -> list[float]:
    """Return the times of pictures from the camera, ms."""
    session = Session()
    display = session.add("image", CAMERA_TOPIC)
    session.limit(display.id, None)
    async with (
        Node("view", domain_id=domain_id, interface="lo") as node,
        Bridge(node, session, canvas),
        asyncio.timeout(_READY_S + 10 * pictures / CAMERA_HZ),
    ):
        while len(canvas.taken_ms) < pictures:  # noqa: ASYNC110 - drawn in another thread
            await asyncio.sleep(_SAMPLE_S)
    return canvas.taken_ms[:pictures]
