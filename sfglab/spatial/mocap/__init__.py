"""Motion capture: where cameras see the agents, published so that every agent's tree of frames stays whole."""

from __future__ import annotations

from sfglab.spatial.mocap.bridge import BridgeOptions, MocapBridge, status_topic
from sfglab.spatial.mocap.core import BridgeCore, MocapObjectStatus, MocapTrees, mocap_trees
from sfglab.spatial.mocap.mapping import (
    MappedObject,
    MocapMapping,
    direct_transforms,
    load_mapping,
    read_mapping,
)
from sfglab.spatial.mocap.offset import OffsetEstimate, estimate_offset, pose_pairs
from sfglab.spatial.mocap.sources import LogSource, TopicSource, ViconSource
from sfglab.spatial.mocap.synthetic import (
    SyntheticConfig,
    SyntheticMotion,
    SyntheticSource,
    TrueCapture,
    synthetic_captures,
)
from sfglab.spatial.mocap.tracking import Capture, Lapse, Limits, MocapSource, Verdict

__all__ = [
    "BridgeCore",
    "BridgeOptions",
    "Capture",
    "Lapse",
    "Limits",
    "LogSource",
    "MappedObject",
    "MocapBridge",
    "MocapMapping",
    "MocapObjectStatus",
    "MocapSource",
    "MocapTrees",
    "OffsetEstimate",
    "SyntheticConfig",
    "SyntheticMotion",
    "SyntheticSource",
    "TopicSource",
    "TrueCapture",
    "Verdict",
    "ViconSource",
    "direct_transforms",
    "estimate_offset",
    "load_mapping",
    "mocap_trees",
    "pose_pairs",
    "read_mapping",
    "status_topic",
    "synthetic_captures",
]
