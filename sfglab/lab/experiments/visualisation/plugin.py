"""A package with visualizers that is installed for a test of plug-ins."""

from __future__ import annotations

import importlib
import sys
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING

from sfglab.lab.experiments.visualisation.recordings import read_recording
from sfglab.messages import default_message, serialize
from sfglab.view.arrivals import Arrival
from sfglab.view.rerunning import open_canvas
from sfglab.view.session import Session, available
from sfglab.view.stage import replay

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_BATTERY = "sensor_msgs/msg/BatteryState"
_TOPIC = "/global/go2/battery_state"
_ENTITY = "/agents/go2/global/battery_state"
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
        kinds, broken = available()
        offers = [offer.kind for offer in Session().offers({_TOPIC: _BATTERY})]
        shown, errors = _shown_charges(folder / "battery.rrd")
    return {
        "found": "battery" in kinds,
        "offered for its type": "battery" in offers,
        "one that cannot be loaded is told": any("Gone" in told for told in broken),
        "ours is not replaced": kinds["image"].__module__.startswith("sfglab."),
        "and that is told": any("'image' is taken" in told for told in broken),
        "shown, and tuned": shown == [50.0, 0.5],
        "one that fails is noted, and the others go on": errors == 2,
        "gone with its package": "battery" not in available().kinds,
    }


def _shown_charges(path: Path) -> tuple[list[float], int]:
    """Show a half full battery with two scales; return the curve, and how often the broken one failed."""
    message = serialize(default_message(_BATTERY, percentage=0.5))
    session = Session()
    display = session.add("battery", _TOPIC)
    broken = session.add("broken", _TOPIC)
    with closing(open_canvas([str(path)])) as canvas:
        for second, scale in enumerate((100.0, 1.0)):
            session.tune(display.id, "scale", scale)
            replay([Arrival(_TOPIC, _BATTERY, 10**9 * second, message)], session, canvas)
    rows = read_recording(path).get((_ENTITY, "Scalars:scalars"), [])
    return [float(value) for row in rows for value in row.content], broken.errors
