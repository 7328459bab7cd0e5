"""The bridge while a camera publishes: changes of displays, and the time until a sink has received an image.

The camera publishes images of 640 x 360 (691 kB) at 30 Hz over DDS. The sink is a server in the camera's
process, because a viewer is also outside of the bridge's process. The sink has received an image when a flush after
the image returns. The baseline is a direct call of Rerun with the same sink.
"""

from __future__ import annotations

import asyncio
import time
from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus import Node
from sfglab.lab.workers.picture_flow import CAMERA_HZ, CAMERA_TOPIC, PictureFlowConfig, picture
from sfglab.processes import Member
from sfglab.qos import DEFAULT, Reliability
from sfglab.view.bridge import Bridge
from sfglab.view.rerunning import RerunCanvas, new_recording, rr
from sfglab.view.session import Session

if TYPE_CHECKING:
    from collections.abc import Callable

DISPLAY = "a visualizer added and removed while the bridge runs"
PARAMETER = "a parameter changed at run time"
QOS = "a QoS profile changed at run time"

_SOON_S = 5.0
_SILENCE_S = 0.3
_SAMPLE_S = 0.05
_READY_S = 15.0


def camera_and_sink(domain_id: int, port: int) -> Member:
    """Return the process that publishes images in a domain, and is the sink of the drawn images at a port."""
    config = PictureFlowConfig(domain_id=domain_id, port=port)
    return Member(name="camera", module="sfglab.lab.workers.picture_flow", config=config)


class MemoryCanvas:
    """A canvas that stores the drawn archetypes."""

    def __init__(self) -> None:
        self.drawn: list[tuple[int, Any]] = []  #: Time stamp (ns) and archetype.
        self._stamp_ns = 0

    def at(self, *, stamp_ns: int, received_ns: int) -> None:  # noqa: ARG002 - a canvas's signature
        """Set the time of everything drawn next."""
        self._stamp_ns = stamp_ns

    def log(self, entity: str, *what: Any, static: bool = False) -> None:  # noqa: ARG002 - likewise
        """Store the archetypes with their time."""
        self.drawn += [(self._stamp_ns, each) for each in what]

    def place(self, entity: str, frame: str) -> None:
        """Do nothing, because no coordinate frame is needed."""

    def settle(self, size_bytes: int) -> None:
        """Do nothing, because no data is in flight."""

    def close(self) -> None:
        """Do nothing, because nothing is open."""


async def _until(holds: Callable[[], bool]) -> bool:
    """Wait until something holds; return whether it did."""
    end_s = time.monotonic() + _SOON_S
    while not (held := holds()) and time.monotonic() < end_s:  # noqa: ASYNC110 - no event tells of it
        await asyncio.sleep(0.01)
    return held


async def try_changes(domain_id: int) -> dict[str, dict[str, bool]]:
    """Change a display while the camera publishes, and return whether each fact holds, by part and fact."""
    session = Session()
    canvas = MemoryCanvas()

    async def is_drawn(opacity: float) -> bool:
        """Wait for a new image with this opacity, and return whether it was drawn."""
        canvas.drawn.clear()
        return await _until(lambda: opacity in map(_opacity, canvas.drawn))

    async with (
        Node("view", domain_id=domain_id, interface="lo") as node,
        Node("observer", domain_id=domain_id, interface="lo") as observer,
        Bridge(node, session, canvas),
    ):

        async def is_requested(*wanted: Reliability) -> bool:
            """Wait until the observer discovers exactly these subscriptions of the camera's topic."""

            def is_seen() -> bool:
                seen = observer.graph.subscriptions(CAMERA_TOPIC)
                return wanted == tuple(one.qos.reliability for one in seen)

            return await _until(is_seen)

        display = session.add("image", CAMERA_TOPIC)
        shown = {
            "added: drawn": await is_drawn(1.0),
            "added: subscribed": await is_requested(Reliability.BEST_EFFORT),
        }
        session.tune(display.id, "opacity", 0.25)
        tuned = {"in the next pictures": await is_drawn(0.25)}
        session.request(display.id, "image", DEFAULT)
        requested = {
            "requested": await is_requested(Reliability.RELIABLE),
            "drawn": await is_drawn(0.25),
        }
        session.remove(display.id)
        shown["removed: unsubscribed"] = await is_requested()
        canvas.drawn.clear()
        await asyncio.sleep(_SILENCE_S)
        shown["removed: nothing is drawn"] = not canvas.drawn
    return {DISPLAY: shown, PARAMETER: tuned, QOS: requested}


def _opacity(drawn: tuple[int, Any]) -> float:
    """Return the opacity of a drawn image."""
    return float(drawn[1].opacity.as_arrow_array()[0].as_py())


class _TimedCanvas(RerunCanvas):
    """A canvas that waits for the sink after each image, and records the time since the image's arrival."""

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
) -> dict[str, list[float]]:
    """Return the times of images by arm, ms; the arms alternate, so that other load on the machine affects both.

    Args:
        port: Port of the sink.
        domain_id: Domain of the camera.
        rounds: Number of rounds.
        pictures: Number of images of an arm in one round.
    """
    recording = new_recording("delay")
    address = f"rerun+http://127.0.0.1:{port}/proxy"
    recording.set_sinks(rr.GrpcSink(address))
    taken_ms: dict[str, list[float]] = {"bare": [], "bridge": []}
    with closing(RerunCanvas(recording, [address])):
        for _ in range(rounds):
            taken_ms["bare"] += await asyncio.to_thread(_bare, recording, pictures)
            canvas = _TimedCanvas(recording, [address])
            taken_ms["bridge"] += await _through_bridge(canvas, domain_id, pictures)
    return taken_ms


def _bare(recording: Any, pictures: int) -> list[float]:
    """Return the times of images with a direct call of Rerun, ms."""
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
    """Return the times of images from the camera through the bridge, ms."""
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
