"""The bridge to the Rerun viewer: paper A, section 4.5.

A scene in which a fleet says all that a visualizer can show is shown from a log and from the bus, and compared
with what was said. What the bridge adds to a picture's way is timed against Rerun's own call.
"""

from sfglab.lab.experiments.visualisation.experiment import added_ms, checks, exp, latency_table

__all__ = ["added_ms", "checks", "exp", "latency_table"]
