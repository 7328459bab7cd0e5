"""Latency: paper A, section 5.4, Fig. 10.

Glass to glass, from a frame's capture to its decoded pixels in a viewer's hands, and from the order to
subscribe to the first picture: standard, through the decoder, and through routers and decoder; in the paper's
manner, where the decoder is loaded on demand, waits for a key frame and hands pictures on by DDS, and with a
warm spare, the sender's replay and shared memory.
"""

from sfglab.lab.experiments.latency.analysis import checks, draw_budget
from sfglab.lab.experiments.latency.experiment import exp

__all__ = ["checks", "draw_budget", "exp"]
