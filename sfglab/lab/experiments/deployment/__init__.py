"""Deployment: paper A, section 4.4, Fig. 5.

The paper's test bed is made into all files of its machines; these are checked, brought to folders in place of
machines and taken back; hooks are run; containers' commands are run between namespaces; an image is built.
"""

from sfglab.lab.experiments.deployment.experiment import exp

__all__ = ["exp"]
