"""Deployment: paper A, section 4.4, Fig. 5.

All files of a fleet are rendered, and programs of other projects confirm or refuse facts about them.
"""

from sfglab.lab.experiments.deployment.experiment import exp
from sfglab.lab.experiments.deployment.results import facts_of

__all__ = ["exp", "facts_of"]
