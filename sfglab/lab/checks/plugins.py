"""Checks of plugins: somebody else's package with visualizers, and what the view makes of it."""

from __future__ import annotations

import importlib
import sys
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING

from sfglab.lab.checks import CheckRow, facts_row
from sfglab.lab.checks.recordings import read_recording
from sfglab.messages import default_message, serialize
from sfglab.view.arrivals import Arrival
from sfglab.view.rerunning import open_canvas
from sfglab.view.session import Session, available
from sfglab.view.stage import replay

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


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
    """Check that a package's visualizers are found, shown and tuned, and that its mistakes hurt nobody else.

    Package and recording are put into an empty folder.
    """
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
    message = default_message(BATTERY)
    message.percentage = 0.5
    session = Session()
    display, broken = session.add("battery", topic), session.add("broken", topic)
    with closing(open_canvas([str(path)])) as canvas:
        for number, scale in enumerate((100.0, 1.0)):
            session.tune(display.id, "scale", scale)
            replay([Arrival(topic, BATTERY, 10**9 * number, serialize(message))], session, canvas)
    recording = read_recording(path)
    shown = recording.get(("/agents/go2/global/battery_state", "Scalars:scalars"), [])
    return [float(value) for s in shown for value in s.content], broken.errors
