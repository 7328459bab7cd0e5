"""Planning: paper A, section 4.5, Fig. 7: trajectories and edits checked, agents sent along."""

from sfglab.lab.experiments.planning.analysis import apart_m, checks
from sfglab.lab.experiments.planning.editor import SceneCell
from sfglab.lab.experiments.planning.experiment import exp

__all__ = ["SceneCell", "apart_m", "checks", "exp"]
