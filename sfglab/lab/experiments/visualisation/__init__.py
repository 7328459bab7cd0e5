"""The bridge to the Rerun viewer: paper A, section 4.5.

Facts about visualizers, from plug-ins to the points of a synchronised pair, and the delay that the bridge adds to
a picture, beside Rerun's own call.
"""

from sfglab.lab.experiments.visualisation.experiment import exp
from sfglab.lab.experiments.visualisation.results import (
    STATEMENTS,
    added_ms,
    facts,
    latency_table,
)

__all__ = ["STATEMENTS", "added_ms", "exp", "facts", "latency_table"]
