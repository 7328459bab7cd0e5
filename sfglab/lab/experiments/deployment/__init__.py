"""Deployment: paper A, section 4.4, Fig. 5.

The experiment renders all files of a fleet. Programs of other projects confirm or refute facts about the files.
"""

from sfglab.lab.experiments.deployment.experiment import exp
from sfglab.lab.experiments.deployment.results import facts_of

__all__ = ["exp", "facts_of"]
