"""Interoperability with rclpy on Fast DDS: tested features, and the differences of the surrogate nodes from it.

The experiment has no notebook. ``make ros2`` runs its parts one by one and records them. The file ``ros2.mcap`` has
the feature table. The file ``x_ros2.mcap`` has the baseline of an experiment ``x``: the comparison of rclpy nodes with
the surrogate nodes of ``x``.
"""

from sfglab.lab.experiments.ros2 import live  # noqa: F401 - declares its parts
from sfglab.lab.experiments.ros2.experiment import BASELINES, exp
from sfglab.lab.experiments.ros2.results import baseline, compared, feature_table

__all__ = ["BASELINES", "baseline", "compared", "exp", "feature_table"]
