"""Latency: paper A, section 5.4, Fig. 10.

Glass to glass, from a frame's capture to its pixels in a viewer's hands, and from the order to subscribe to the
first picture: standard, through the decoder, and through routers and decoder, in the paper's manner and ours.
"""

from sfglab.lab.experiments.latency.analysis import checks, draw_budget
from sfglab.lab.experiments.latency.experiment import exp

__all__ = ["checks", "draw_budget", "exp"]
