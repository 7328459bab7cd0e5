"""The bridge to the Rerun viewer: paper A, section 4.5.

The experiment checks facts about visualizers, from plug-ins to the points of a synchronised pair of messages. It also
measures the delay that the bridge adds to an image, relative to a direct call of Rerun.
"""

from sfglab.lab.experiments.visualisation.experiment import exp
from sfglab.lab.experiments.visualisation.results import (
    STATEMENTS,
    added_ms,
    facts,
    latency_table,
)

__all__ = ["STATEMENTS", "added_ms", "exp", "facts", "latency_table"]
