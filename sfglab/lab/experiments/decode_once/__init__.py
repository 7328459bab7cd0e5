"""Decode once per device: paper A, sections 4.3 and 5.2, Fig. 8, Eq. 2 and 3.

A camera stream goes to a host with 1 to 10 subscribers. *Standard*: each receives and decodes. *DDS*, the
paper's way: one decoder publishes pictures. *Proxy*, ours: it shares them in memory. CPU and received bytes are
black-box measurements.
"""

from sfglab.lab.experiments.decode_once import figures
from sfglab.lab.experiments.decode_once.analysis import (
    codecs,
    cost_model,
    frame_checks,
    papers_way,
    slopes,
    stream_facts,
)
from sfglab.lab.experiments.decode_once.experiment import exp

__all__ = [
    "codecs",
    "cost_model",
    "exp",
    "figures",
    "frame_checks",
    "papers_way",
    "slopes",
    "stream_facts",
]
