"""Planning: paper A, section 4.5, Fig. 7.

The experiment tries facts about trajectories, edits and scene files on random cases. The agents of a scene execute
their trajectories as goals of an action.
"""

from sfglab.lab.experiments.planning.editor import SceneCell
from sfglab.lab.experiments.planning.experiment import exp
from sfglab.lab.experiments.planning.results import fact_table, facts_of, goals_of

__all__ = ["SceneCell", "exp", "fact_table", "facts_of", "goals_of"]
