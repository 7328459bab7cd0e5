"""The bridge while a camera sends: displays that change, and the time until a sink has a picture.

The camera sends pictures of 640 x 360 (691 kB) 30 times a second over DDS. The sink is a server in a process of
its own, as a viewer is; it has a picture when a flush after it returns. The baseline is Rerun's own call to the
same sink.
"""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus import Node
from sfglab.errors import InvalidValueError
from sfglab.lab.workers.picture_flow import CAMERA_HZ, CAMERA_TOPIC, PictureFlowConfig, picture
from sfglab.processes import Member
from sfglab.qos import DEFAULT, Reliability
from sfglab.view.bridge import Bridge
from sfglab.view.rerunning import RerunCanvas, new_recording, rerun
from sfglab.view.session import Display, Session

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


class _Surface:
    """A surface that keeps what is drawn on it."""

    def __init__(self) -> None:
        self.drawn: list[Any] = []

    def log(self, entity: str, *what: Any, static: bool = False) -> None:  # noqa: ARG002 - a canvas's signature
        """Keep it."""
        self.drawn += what

    def place(self, entity: str, frame: str) -> None:
        """Nothing is placed."""

    def at(self, *, stamp_ns: int, received_ns: int) -> None:
        """Times do not matter here."""

    def settle(self, size_bytes: int) -> None:
        """Nothing is on its way."""

    def close(self) -> None:
        """Nothing is open."""

    def opacity(self) -> float:
        """Return the opacity of the last picture."""
        return round(float(self.drawn[-1].opacity.as_arrow_array().to_pylist()[0]), 3)

    async def drawn_again(self) -> bool:
        """Wait for the next picture."""
        self.drawn.clear()
        return await _until(lambda: bool(self.drawn))

    async def is_silent(self) -> bool:
        """Return whether nothing is drawn for a while."""
        self.drawn.clear()
        await asyncio.sleep(_SILENCE_S)
        return not self.drawn


async def _until(holds: Callable[[], bool]) -> bool:
    """Wait until something holds; return whether it did."""
    end_s = time.monotonic() + _SOON_S
    while not (held := holds()) and time.monotonic() < end_s:  # noqa: ASYNC110 - no event tells of it
        await asyncio.sleep(0.01)
    return held


class Changes:
    """A display that changes while the bridge runs; each method returns what holds of one change.

    Args:
        session: Displays of the bridge.
        surface: Where the bridge draws.
        observer: Another node on the domain, which sees what is subscribed to.
    """

    def __init__(self, session: Session, surface: _Surface, observer: Node) -> None:
        self._session = session
        self._surface = surface
        self._observer = observer
        self._display: Display | None = None

    @property
    def display(self) -> Display:
        """The display, once it is added."""
        assert self._display is not None
        return self._display

    async def add(self) -> dict[str, bool]:
        """Add the display."""
        self._display = self._session.add("image", CAMERA_TOPIC)
        drawn = await self._surface.drawn_again()
        subscribed = await _until(lambda: self._requested() == [Reliability.BEST_EFFORT])
        return {"added: drawn": drawn, "added: subscribed": subscribed}

    async def tune(self) -> dict[str, bool]:
        """Set a parameter, and try to set one that is not allowed."""
        surface, id_ = self._surface, self.display.id
        before = surface.opacity()
        self._session.tune(id_, "opacity", 0.25)
        after = await _until(lambda: bool(surface.drawn) and surface.opacity() == 0.25)
        try:
            self._session.tune(id_, "opacity", 7.0)
            refused = False
        except InvalidValueError:
            refused = self.display.visualizer.settings["opacity"] == 0.25
        return {"before": before == 1.0, "after": after, "what is not allowed is refused": refused}

    async def request(self) -> dict[str, bool]:
        """Request another QoS."""
        self._session.rewire(self.display.id, qos={"image": DEFAULT})
        anew = await _until(lambda: self._requested() == [Reliability.RELIABLE])
        return {"requested": anew, "drawn": await self._surface.drawn_again()}

    async def remove(self) -> dict[str, bool]:
        """Remove the display."""
        self._session.remove(self.display.id)
        ended = await _until(lambda: not self._requested())
        silent = await self._surface.is_silent()
        return {"removed: unsubscribed": ended, "removed: nothing is drawn": silent}

    def _requested(self) -> list[Reliability]:
        """Return the reliability of each subscription that the observer sees on the camera's topic."""
        endpoints = self._observer.graph.subscriptions(CAMERA_TOPIC)
        return [endpoint.qos.reliability for endpoint in endpoints]


async def try_changes(domain_id: int) -> dict[str, dict[str, bool]]:
    """Add, tune, rewire and remove a display while the camera sends; return what holds, by change."""
    session, surface = Session(), _Surface()
    async with (
        Node("view", domain_id=domain_id, interface="lo") as node,
        Node("observer", domain_id=domain_id, interface="lo") as observer,
        Bridge(node, session, surface),
    ):
        changes = Changes(session, surface, observer)
        added = await changes.add()
        tuned = await changes.tune()
        requested = await changes.request()
        removed = await changes.remove()
    return {"display": added | removed, "parameter": tuned, "qos": requested}


def sink_canvas(port: int) -> RerunCanvas:
    """Return a canvas whose recording goes to the sink's process."""
    recording = new_recording("delay")
    address = f"rerun+http://127.0.0.1:{port}/proxy"
    recording.set_sinks(rerun().GrpcSink(address))
    return RerunCanvas(recording, [address])


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


async def time_pictures(
    canvas: RerunCanvas, domain_id: int, *, rounds: int, pictures: int
) -> list[dict[str, Any]]:
    """Return the times of pictures of both arms, taken in turn, so that other load on the machine affects both."""
    rows = []
    for number in range(rounds):
        bare = await asyncio.to_thread(_bare, canvas, pictures)
        bridge = await _through_bridge(canvas, domain_id, pictures)
        for arm, taken_ms in (("bare", bare), ("bridge", bridge)):
            for picture_number, ms in enumerate(taken_ms):
                row = {"arm": arm, "round": number, "number": picture_number, "taken_ms": ms}
                rows.append(row)
    return rows


def _bare(canvas: RerunCanvas, pictures: int) -> list[float]:
    """Return the times of Rerun's own call, ms."""
    rr, array = rerun(), picture()
    taken_ms = []
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


async def _through_bridge(canvas: RerunCanvas, domain_id: int, pictures: int) -> list[float]:
    """Return the times of pictures from the camera, ms."""
    timed, session = _Timed(canvas), Session()
    display = session.add("image", CAMERA_TOPIC)
    session.limit(display.id, None)
    async with (
        Node("view", domain_id=domain_id, interface="lo") as node,
        Bridge(node, session, timed),
        asyncio.timeout(_READY_S + 10 * pictures / CAMERA_HZ),
    ):
        while len(timed.taken_ms) < pictures:  # noqa: ASYNC110 - drawn in another thread
            await asyncio.sleep(_SAMPLE_S)
    return timed.taken_ms[:pictures]
