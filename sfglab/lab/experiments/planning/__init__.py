"""Planning: paper A, section 4.5, Fig. 7.

Trajectories, headings, interpolation, re-timing, clearance, exchange, edits and files are checked on random
cases; the agents of a scene are sent along its trajectories over the action's server, at once.
"""

from sfglab.lab.experiments.planning.analysis import apart_m, checks
from sfglab.lab.experiments.planning.editor import SceneCell
from sfglab.lab.experiments.planning.experiment import exp

__all__ = ["SceneCell", "apart_m", "checks", "exp"]
