"""Interoperability with real ROS 2: what works, and how far our stand-ins are from it.

The experiment has no notebook. ``make ros2`` runs its parts one by one and records them: the feature table in
``ros2.mcap``, and the baseline of an experiment ``x``, which compares rclpy with ``x``'s stand-in, in
``x_ros2.mcap``.
"""

from sfglab.lab.experiments.ros2 import live  # noqa: F401 - declares its parts
from sfglab.lab.experiments.ros2.experiment import BASELINES, exp
from sfglab.lab.experiments.ros2.results import baseline, compared, feature_table

__all__ = ["BASELINES", "baseline", "compared", "exp", "feature_table"]
