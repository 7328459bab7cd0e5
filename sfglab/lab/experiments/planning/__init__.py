"""Planning: paper A, section 4.5, Fig. 7.

Facts of trajectories, edits and scene files are tried on random cases, and the agents of a scene carry out
their trajectories as goals of an action.
"""

from sfglab.lab.experiments.planning.editor import SceneCell
from sfglab.lab.experiments.planning.experiment import exp
from sfglab.lab.experiments.planning.results import fact_table, facts_of, goals_of

__all__ = ["SceneCell", "exp", "fact_table", "facts_of", "goals_of"]
