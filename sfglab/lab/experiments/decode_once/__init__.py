"""Decode once per device: paper A, sections 4.3 and 5.2, Fig. 8, Eq. 2 and 3.

An edge host sends a camera stream to a consumer host with 1 to 10 local subscribers. *Standard*: each
subscriber receives and decodes for itself. *DDS*, the paper's way: the decoder receives and decodes once and
publishes the pictures. *Proxy*, ours: it shares them by shared memory. Measured are the consumer's CPU and what
its interface receives: black-box measurements, from outside of the processes.
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

__all__ = ["codecs", "cost_model", "exp", "figures", "frame_checks", "papers_way", "slopes", "stream_facts"]
