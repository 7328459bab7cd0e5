"""The package `rtps` models RELIABLE and KEEP_LAST over a lossy medium: writer, reader, medium, and vendors' timing.

The module `model` describes flows and scenarios, `channel` describes the medium with its rules, and `vendors` has the
timing of DDS implementations. The module `session` runs a scenario. The other modules are compiled: `state` has the
records, `engine` the events, `writer` and `reader` the protocol, `medium` the queues and frames, and `world` the
access to the arrays.
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
