"""Decode once per device: paper A, sections 4.3 and 5.2, Fig. 8, Eq. 2 and 3.

A camera stream goes to a host with 1 to 10 subscribers. In mode *standard* each subscriber receives and
decodes the stream. In mode *DDS*, as in the paper, one decoder publishes the decoded images over DDS. In mode *proxy*,
the sfglab variant, the decoder passes them on over shared memory. CPU load and received bytes are black-box
measurements.
"""

from sfglab.lab.experiments.decode_once import live  # noqa: F401 - declares its parts
from sfglab.lab.experiments.decode_once.experiment import exp
from sfglab.lab.experiments.decode_once.results import (
    NAMES,
    cost_model,
    decoding_costs,
    frame_checks,
    residual_table,
    slopes,
    stream_of_table_two,
)

__all__ = [
    "NAMES",
    "cost_model",
    "decoding_costs",
    "exp",
    "frame_checks",
    "residual_table",
    "slopes",
    "stream_of_table_two",
]
