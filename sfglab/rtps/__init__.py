"""RELIABLE and KEEP_LAST over a lossy medium: one model of writer, reader and medium, with vendors' timing.

Bottom up: `presets` (vendors' constants with their sources), `world`, `heap`, `state`, `medium` and `engine`
(compiled), `outcome` (fates and latencies), `model` (flows and scenarios in, an outcome out), `session` (the
same in steps).
"""

from __future__ import annotations

from sfglab.rtps.model import Flow, Medium, ModelError, Scenario, run
from sfglab.rtps.outcome import FlowOutcome, Outcome
from sfglab.rtps.presets import CYCLONE_DDS, FAST_DDS, PRESETS, Vendor
from sfglab.rtps.session import Delivery, Session
from sfglab.rtps.state import Drop, Fate

__all__ = [
    "CYCLONE_DDS",
    "FAST_DDS",
    "PRESETS",
    "Delivery",
    "Drop",
    "Fate",
    "Flow",
    "FlowOutcome",
    "Medium",
    "ModelError",
    "Outcome",
    "Scenario",
    "Session",
    "Vendor",
    "run",
]
