"""The view: what a fleet sees and how it hears itself, in the Rerun viewer (paper A, section 4.5).

Visualizers are small classes with declared inputs, QoS, synchronisation and rate budget, found through entry
points (group ``sfglab.visualizers``). A `Session` adds, removes and tunes them at run time; a `Bridge` feeds
them from the bus, `view_log` from an MCAP file or a bag; `open_canvas` sends what they draw to a viewer, a
notebook or a ``.rrd`` file. Rerun comes with the extra ``view``.

A visualizer of your own is a class in your package:

    import rerun as rr
    from sfglab.view import Input, Parameter, Visualizer

    class Battery(Visualizer):
        name = "battery"
        inputs = (Input(role="state", type="sensor_msgs/msg/BatteryState"),)
        parameters = (Parameter(name="scale", default=100.0, help="what a full battery is drawn as"),)

        def show(self, update, canvas):
            canvas.log(self.entity, rr.Scalars([update.only.percentage * self["scale"]]))

and an entry point in your ``pyproject.toml``:

    [project.entry-points."sfglab.visualizers"]
    battery = "your_package:Battery"

`sfglab view` then offers it for every topic of its type. Several inputs are synchronised by the class attribute
``sync``: `Exact`, `Approximate` or `Latest`.
"""

from __future__ import annotations

from sfglab.view.app import Report, ViewOptions, report_of, view_live, view_log
from sfglab.view.arrivals import Arrival
from sfglab.view.bridge import Bridge
from sfglab.view.errors import ContentError, SessionError, SettingError, SinkError, SourceError, ViewError
from sfglab.view.registry import available, find
from sfglab.view.rerunning import RerunCanvas, blueprint, layout_of_fleet, open_canvas
from sfglab.view.session import Display, Session
from sfglab.view.stage import replay
from sfglab.view.sync import Approximate, Exact, Independent, Latest
from sfglab.view.visualizer import Canvas, Input, Parameter, Update, Visualizer, entity_of_topic

__all__ = [
    "Approximate",
    "Arrival",
    "Bridge",
    "Canvas",
    "ContentError",
    "Display",
    "Exact",
    "Independent",
    "Input",
    "Latest",
    "Parameter",
    "Report",
    "RerunCanvas",
    "Session",
    "SessionError",
    "SettingError",
    "SinkError",
    "SourceError",
    "Update",
    "ViewError",
    "ViewOptions",
    "Visualizer",
    "available",
    "blueprint",
    "entity_of_topic",
    "find",
    "layout_of_fleet",
    "open_canvas",
    "replay",
    "report_of",
    "view_live",
    "view_log",
]
