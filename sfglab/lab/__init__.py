"""The laboratory: test hosts, meters, experiments, figures, claims and the notebook runner.

A public name is loaded from its module at its first use, because a process that needs one module of this
package starts faster without the others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.lazy import loader

__all__ = [
    "Actor",
    "CameraConfig",
    "Estimate",
    "Experiment",
    "Finding",
    "How",
    "Link",
    "LiveView",
    "LogViewer",
    "PressedMapping",
    "derived",
    "find_project",
    "median_of",
    "open_source",
    "ratio_of",
    "run_camera",
    "share_of",
]

_MODULES = {
    "Actor": "experiment",
    "CameraConfig": "workers.camera",
    "Estimate": "stats",
    "Experiment": "experiment",
    "Finding": "claims",
    "How": "claims",
    "Link": "experiment",
    "LiveView": "explore.viewer",
    "LogViewer": "explore.viewer",
    "PressedMapping": "explore.mapping",
    "derived": "runs",
    "find_project": "paths",
    "median_of": "stats",
    "open_source": "sources",
    "ratio_of": "stats",
    "run_camera": "workers.camera",
    "share_of": "stats",
}

if TYPE_CHECKING:
    from sfglab.lab.claims import Finding, How
    from sfglab.lab.experiment import Actor, Experiment, Link
    from sfglab.lab.explore.mapping import PressedMapping
    from sfglab.lab.explore.viewer import LiveView, LogViewer
    from sfglab.lab.paths import find_project
    from sfglab.lab.runs import derived
    from sfglab.lab.sources import open_source
    from sfglab.lab.stats import Estimate, median_of, ratio_of, share_of
    from sfglab.lab.workers.camera import CameraConfig, run_camera
else:
    __getattr__ = loader(__name__, _MODULES)
