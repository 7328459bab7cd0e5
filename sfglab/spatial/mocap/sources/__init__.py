"""Where captures come from: a Vicon Tracker, topics, logs, or nowhere but arithmetic."""

from __future__ import annotations

from sfglab.spatial.mocap.sources.ros import LogSource, TopicSource
from sfglab.spatial.mocap.sources.synthetic import (
    SyntheticConfig,
    SyntheticMotion,
    SyntheticSource,
    TrueCapture,
    synthetic_captures,
)
from sfglab.spatial.mocap.sources.vicon import ViconError, ViconMissingError, ViconSource

__all__ = [
    "LogSource",
    "SyntheticConfig",
    "SyntheticMotion",
    "SyntheticSource",
    "TopicSource",
    "TrueCapture",
    "ViconError",
    "ViconMissingError",
    "ViconSource",
    "synthetic_captures",
]
