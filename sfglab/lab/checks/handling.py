"""Checks of handling: displays changed while pictures come, and somebody else's package with visualizers."""

from __future__ import annotations

import asyncio
import importlib
import sys
import time
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, Any

from sfglab.bus import Node
from sfglab.errors import InvalidValueError
from sfglab.lab.checks import CheckRow, facts_row
from sfglab.lab.checks.recordings import read_recording
from sfglab.lab.workers.scene_publisher import CAMERA_TOPIC
from sfglab.messages import default_message, serialize
from sfglab.qos import DEFAULT, Reliability
from sfglab.view.arrivals import Arrival
from sfglab.view.bridge import Bridge
from sfglab.view.rerunning import open_canvas
from sfglab.view.session import Display, Session, available
from sfglab.view.stage import replay

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    Requested = Callable[[], list[Reliability]]

_SOON_S = 5.0
_LIMIT_HZ = 5.0


class _Handled:
    """A session that is looked at while it changes, and a surface that keeps what is drawn on it."""

    def __init__(self, session: Session) -> None:
        self.session = session
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

    async def until(self, holds: Callable[[], bool]) -> bool:
        """Wait until something holds; return whether it did."""
        end_s = time.monotonic() + _SOON_S
        while not (held := holds()) and time.monotonic() < end_s:  # noqa: ASYNC110 - no event tells of it
            await asyncio.sleep(0.01)
        return held

    async def drawn_again(self) -> bool:
        """Wait for the next picture."""
        self.drawn.clear()
        return await self.until(lambda: bool(self.drawn))

    async def count(self, seconds: float) -> int:
        """Return how many pictures are drawn in a time."""
        self.drawn.clear()
        await asyncio.sleep(seconds)
        return len(self.drawn)


async def check_handling(domain_id: int, *, observed_s: float) -> list[CheckRow]:
    """Change a session in every way while a camera sends in a domain; pictures are counted for `observed_s`."""
    session = Session()
    handled = _Handled(session)
    async with (
        Node("view", domain_id=domain_id, interface="lo") as node,
        Node("observer", domain_id=domain_id, interface="lo") as observer,
        Bridge(node, session, handled),
    ):

        def requested() -> list[Reliability]:
            """Return the reliability of each subscription that another node sees on the topic."""
            return [
                endpoint.qos.reliability for endpoint in observer.graph.subscriptions(CAMERA_TOPIC)
            ]

        display = session.add("image", CAMERA_TOPIC)
        groups = {
            "added: its topic is subscribed to, and pictures come": {
                "drawn": await handled.drawn_again(),
                "subscribed": await handled.until(lambda: requested() == [Reliability.BEST_EFFORT]),
            },
            "a parameter counts from the next picture": await _tuned(handled, display),
            "a rate budget counts at once": await _limited(handled, display, observed_s),
            "a QoS profile is requested anew": await _rewired(handled, display, requested),
            "switched off and on again, and removed": await _removed(handled, display, requested),
        }
    return [facts_row(check, facts) for check, facts in groups.items()]


async def _tuned(handled: _Handled, display: Display) -> dict[str, bool]:
    before = handled.opacity()
    handled.session.tune(display.id, "opacity", 0.25)
    after = await handled.until(lambda: bool(handled.drawn) and handled.opacity() == 0.25)
    try:
        handled.session.tune(display.id, "opacity", 7.0)
        refused = False
    except InvalidValueError:
        refused = display.visualizer.settings["opacity"] == 0.25
    return {"before": before == 1.0, "after": after, "what is not allowed is refused": refused}


async def _limited(handled: _Handled, display: Display, seconds: float) -> dict[str, bool]:
    handled.session.limit(display.id, _LIMIT_HZ)
    await handled.drawn_again()
    limited = await handled.count(seconds)
    handled.session.limit(display.id, None)
    freed = await handled.count(seconds)
    return {
        f"{limited} pictures in {seconds:g} s at {_LIMIT_HZ:g} Hz": abs(
            limited - _LIMIT_HZ * seconds
        )
        <= 2,
        f"{freed} without a limit": freed > 2 * limited,
    }


async def _rewired(handled: _Handled, display: Display, requested: Requested) -> dict[str, bool]:
    handled.session.rewire(display.id, qos={"image": DEFAULT})
    anew = await handled.until(lambda: requested() == [Reliability.RELIABLE])
    return {"requested": anew, "drawn": await handled.drawn_again()}


async def _removed(handled: _Handled, display: Display, requested: Requested) -> dict[str, bool]:
    session = handled.session
    session.enable(display.id, enabled=False)
    ended = await handled.until(lambda: not requested())
    silent = await handled.count(0.3)
    session.enable(display.id, enabled=True)
    again = await handled.drawn_again()
    session.remove(display.id)
    return {
        "off: unsubscribed": ended,
        "off: nothing is drawn": silent == 0,
        "on: drawn again": again,
        "removed: unsubscribed": await handled.until(lambda: not requested()),
        "removed: nothing is drawn": await handled.count(0.3) == 0,
    }


BATTERY = "sensor_msgs/msg/BatteryState"

PLUGIN = '''
import rerun as rr

from sfglab.view import Input, Parameter, Visualizer


class Battery(Visualizer):
    """The charge of a battery as a curve."""

    name = "battery"
    inputs = (Input(role="state", type="sensor_msgs/msg/BatteryState"),)
    parameters = (Parameter(name="scale", default=100.0, help="what a full battery is drawn as"),)

    def show(self, update, canvas):
        canvas.log(self.entity, rr.Scalars([update.only.percentage * self["scale"]]))


class Image(Battery):
    name = "image"


class Broken(Battery):
    name = "broken"

    def show(self, update, canvas):
        raise RuntimeError("a mistake of theirs")
'''
_ENTRIES = "battery = {0}:Battery\ngone = {0}:Gone\nimage = {0}:Image\nbroken = {0}:Broken\nnumber = math:pi\n"
_MODULE = "visualisation_plugin"


@contextmanager
def installed(folder: Path) -> Iterator[None]:
    """Have a package of a folder on the path: a module and its metadata, as pip would leave them."""
    (folder / f"{_MODULE}.py").write_text(PLUGIN, encoding="utf-8")
    info = folder / f"{_MODULE}-1.0.dist-info"
    info.mkdir()
    metadata = f"Metadata-Version: 2.1\nName: {_MODULE}\nVersion: 1.0\n"
    (info / "METADATA").write_text(metadata, encoding="utf-8")
    entries = f"[sfglab.visualizers]\n{_ENTRIES.format(_MODULE)}"
    (info / "entry_points.txt").write_text(entries, encoding="utf-8")
    sys.path.insert(0, str(folder))
    importlib.invalidate_caches()
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        sys.modules.pop(_MODULE, None)
        importlib.invalidate_caches()


def check_plugins(folder: Path) -> CheckRow:
    """Check in an empty folder that a package's visualizers are found and tuned, and its mistakes contained."""
    with installed(folder):
        facts = _facts(folder)
    facts["gone with its package"] = "battery" not in available().kinds
    return facts_row("a package's visualizers through entry points", facts)


def _facts(folder: Path) -> dict[str, bool]:
    kinds, broken = available()
    topic = "/global/go2/battery_state"
    offers = [offer.kind for offer in Session().offers({topic: BATTERY})]
    shown, errors = _charges(folder / "battery.rrd", topic)
    return {
        "found": "battery" in kinds,
        "offered for its type": "battery" in offers,
        "one that cannot be loaded is told": any("Gone" in told for told in broken),
        "ours is not replaced": kinds["image"].__module__.startswith("sfglab."),
        "and that is told": any("'image' is taken" in told for told in broken),
        "shown, and tuned": shown == [50.0, 0.5],
        "one that fails is noted, and the others go on": errors == 2,
    }


def _charges(path: Path, topic: str) -> tuple[list[float], int]:
    """Show two half full batteries with a parameter tuned in between; return the curve, and what failed."""
    message = default_message(BATTERY, percentage=0.5)
    session = Session()
    display, broken = session.add("battery", topic), session.add("broken", topic)
    with closing(open_canvas([str(path)])) as canvas:
        for number, scale in enumerate((100.0, 1.0)):
            session.tune(display.id, "scale", scale)
            replay([Arrival(topic, BATTERY, 10**9 * number, serialize(message))], session, canvas)
    shown = read_recording(path).get(("/agents/go2/global/battery_state", "Scalars:scalars"), [])
    return [float(value) for s in shown for value in s.content], broken.errors
