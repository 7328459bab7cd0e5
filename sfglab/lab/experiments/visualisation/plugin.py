"""A package with visualizers of its own, as another project would install it."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from sfglab.lab.experiments.visualisation.live import MemoryCanvas
from sfglab.messages import default_message, serialize
from sfglab.view.arrivals import Arrival
from sfglab.view.session import Session
from sfglab.view.stage import replay

if TYPE_CHECKING:
    from pathlib import Path

PLUGIN = "a plug-in of another package"

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


class Broken(Battery):
    name = "broken"

    def show(self, update, canvas):
        raise RuntimeError("a mistake of theirs")
'''
_ENTRY_POINTS = f"""[sfglab.visualizers]
battery = {_NAME}:Battery
broken = {_NAME}:Broken
"""


def try_package(folder: Path) -> dict[str, bool]:
    """Install the package into an empty folder, and return whether each fact about its visualizers holds."""
    (folder / f"{_NAME}.py").write_text(_MODULE, encoding="utf-8")
    info = folder / f"{_NAME}-1.0.dist-info"
    info.mkdir()
    (info / "entry_points.txt").write_text(_ENTRY_POINTS, encoding="utf-8")
    sys.path.insert(0, str(folder))
    try:
        session = Session()
    finally:
        sys.path.remove(str(folder))
        sys.modules.pop(_NAME, None)
    offers = [offer.kind for offer in session.offers({_TOPIC: _BATTERY})]
    display = session.add("battery", _TOPIC)
    broken = session.add("broken", _TOPIC)
    session.tune(display.id, "scale", 50.0)
    canvas = MemoryCanvas()
    message = serialize(default_message(_BATTERY, percentage=0.5))
    replay([Arrival(_TOPIC, _BATTERY, 0, message)], session, canvas)
    charges = [float(shown.scalars.as_arrow_array()[0]) for _, shown in canvas.drawn]
    return {
        "offered for its type": "battery" in offers,
        "shown, and tuned": charges == [25.0],
        "one that fails is noted, and the other goes on": broken.errors == 1,
        "gone with its package": "battery" not in Session().kinds,
    }
