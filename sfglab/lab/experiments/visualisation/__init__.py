"""The bridge to the Rerun viewer: paper A, section 4.5.

A scene in which a fleet says everything that a visualizer of the list can show is shown from a log and, sent by
another process, from the bus; what the recordings hold is compared with what was said. Checks on handling,
plugins, synchronisation and points are run. What the bridge adds to a picture's way is timed against Rerun's
own call, and what waits is watched while the sink stands still.
"""

from sfglab.lab.experiments.visualisation.experiment import added_ms, checks, exp, latency_table

__all__ = ["added_ms", "checks", "exp", "latency_table"]
