"""RELIABLE and KEEP_LAST over a lossy medium: one model of writer, reader and medium, with vendors' timing.

`model` describes flows and scenarios, `channel` the medium with its rules, `vendors` the timing of DDS
implementations; `session` runs a scenario. The rest is compiled: `state` has the records, `engine` the events,
`writer` and `reader` the protocol, `medium` the queues and frames, `world` the access to the arrays.
"""

from __future__ import annotations

from sfglab.rtps.channel import Medium
from sfglab.rtps.model import Flow, Scenario
from sfglab.rtps.session import AirFrame, FlowOutcome, Outcome, Session, run, trace
from sfglab.rtps.state import Fate, Frame
from sfglab.rtps.vendors import (
    CYCLONE_DDS,
    FAST_DDS,
    FAST_DDS_ASYNC,
    FAST_DDS_SYNC,
    PRESETS,
    Vendor,
)

__all__ = [
    "CYCLONE_DDS",
    "FAST_DDS",
    "FAST_DDS_ASYNC",
    "FAST_DDS_SYNC",
    "PRESETS",
    "AirFrame",
    "Fate",
    "Flow",
    "FlowOutcome",
    "Frame",
    "Medium",
    "Outcome",
    "Scenario",
    "Session",
    "Vendor",
    "run",
    "trace",
]
