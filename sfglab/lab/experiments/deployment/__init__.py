"""Deployment: paper A, section 4.4, Fig. 5: its test bed's files, checked, applied and run."""

from sfglab.lab.experiments.deployment.experiment import exp

__all__ = ["exp"]
