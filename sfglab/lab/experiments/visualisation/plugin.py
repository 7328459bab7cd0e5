"""A package with visualizers that is installed for a test of plug-ins."""

from __future__ import annotations

import importlib
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

from sfglab.lab.experiments.visualisation.live import MemoryCanvas
from sfglab.messages import default_message, serialize
from sfglab.units import NS_PER_S
from sfglab.view.arrivals import Arrival
from sfglab.view.session import Session
from sfglab.view.stage import replay

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_BATTERY = "sensor_msgs/msg/BatteryState"
_TOPIC = "/global/go2/battery_state"
_NAME = "visualisation_plugin"
_MODULE = '''
import rerun as rr

from sfglab.view import Input, Parameter, Visualizer


class Battery(Visualizer):
    """The charge of a battery as a curve."""

    name = "battery"
    inputs = (Input("state", "sensor_msgs/msg/BatteryState"),)
    parameters = (Parameter("scale", 100.0, "what a full battery is drawn as"),)

    def show(self, update, canvas):
        canvas.log(self.entity, rr.Scalars([update.only.percentage * self["scale"]]))


class Image(Battery):
    name = "image"


class Broken(Battery):
    name = "broken"

    def show(self, update, canvas):
        raise RuntimeError("a mistake of theirs")
'''
_ENTRY_POINTS = f"""[sfglab.visualizers]
battery = {_NAME}:Battery
gone = {_NAME}:Gone
image = {_NAME}:Image
broken = {_NAME}:Broken
number = math:pi
"""


@contextmanager
def installed(folder: Path) -> Iterator[None]:
    """Have the package in an empty folder, and on Python's path until the block ends."""
    (folder / f"{_NAME}.py").write_text(_MODULE, encoding="utf-8")
    info = folder / f"{_NAME}-1.0.dist-info"
    info.mkdir()
    metadata = f"Metadata-Version: 2.1\nName: {_NAME}\nVersion: 1.0\n"
    (info / "METADATA").write_text(metadata, encoding="utf-8")
    (info / "entry_points.txt").write_text(_ENTRY_POINTS, encoding="utf-8")
    sys.path.insert(0, str(folder))
    importlib.invalidate_caches()
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        sys.modules.pop(_NAME, None)
        importlib.invalidate_caches()


def try_package(folder: Path) -> dict[str, bool]:
    """Return what holds of the package's visualizers: found, offered, shown and tuned; mistakes are contained."""
    with installed(folder):
        session = Session()
        offers = [offer.kind for offer in session.offers({_TOPIC: _BATTERY})]
        charges, errors = _shown_charges(session)
    told = "\n".join(session.problems)
    return {
        "found": "battery" in session.kinds,
        "offered for its type": "battery" in offers,
        "one that cannot be loaded is told": "Gone" in told,
        "ours is not replaced": session.kinds["image"].__module__.startswith("sfglab."),
        "and that is told": "'image' is taken" in told,
        "shown, and tuned": charges == [50.0, 0.5],
        "one that fails is noted, and the others go on": errors == 2,
        "gone with its package": "battery" not in Session().kinds,
    }


def _shown_charges(session: Session) -> tuple[list[float], int]:
    """Show a half full battery with two scales; return the curve, and how often the broken one failed."""
    message = serialize(default_message(_BATTERY, percentage=0.5))
    canvas = MemoryCanvas()
    display = session.add("battery", _TOPIC)
    broken = session.add("broken", _TOPIC)
    for second, scale in enumerate((100.0, 1.0)):
        session.tune(display.id, "scale", scale)
        replay([Arrival(_TOPIC, _BATTERY, second * NS_PER_S, message)], session, canvas)
    charges = [float(shown.scalars.as_arrow_array()[0]) for _, shown in canvas.drawn]
    return charges, broken.errors
