"""The view shows the messages of a fleet, live or from a log, in the Rerun viewer (paper A, section 4.5).

Visualizers are small classes with declared inputs, QoS, synchronisation and rate budget, found through entry
points (group ``sfglab.visualizers``). A session adds, removes and tunes them at run time (`session`, `panel`).
The messages come from the bus (`bridge`) or from an MCAP file or a bag (`arrivals`); `app` starts both. `rerunning`
sends the drawn data to a viewer, a notebook or a ``.rrd`` file. Rerun is in the extra ``view``.

A visualizer of your own is a class in your package:

    import rerun as rr
    from sfglab.view import Input, Parameter, Visualizer

    class Battery(Visualizer):
        name = "battery"
        inputs = (Input("state", "sensor_msgs/msg/BatteryState"),)
        parameters = (Parameter("scale", 100.0, "what a full battery is drawn as"),)

        def show(self, update, canvas):
            canvas.log(self.entity, rr.Scalars([update.only.percentage * self["scale"]]))

and an entry point in your ``pyproject.toml``:

    [project.entry-points."sfglab.visualizers"]
    battery = "your_package:Battery"

`sfglab view` then offers it for every topic of its type. Several inputs are synchronised by the class attribute
``sync``: `Exact` or `Approximate`.
"""

from sfglab.view.sync import Approximate, Exact, Independent
from sfglab.view.visualizer import Canvas, Input, Parameter, Update, Visualizer

__all__ = [
    "Approximate",
    "Canvas",
    "Exact",
    "Independent",
    "Input",
    "Parameter",
    "Update",
    "Visualizer",
]
