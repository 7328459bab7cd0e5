"""Motion capture: where cameras see the agents, published so that every agent's tree of frames stays whole."""

from __future__ import annotations

from sfglab.spatial.mocap.bridge import (
    STATUS,
    STATUS_QOS,
    BridgeOptions,
    MocapBridge,
    status_message,
    status_topic,
)
from sfglab.spatial.mocap.core import BridgeCore, MocapObjectStatus, MocapTrees, mocap_trees
from sfglab.spatial.mocap.mapping import (
    MappedObject,
    MappingError,
    MocapMapping,
    PlacingError,
    direct_name,
    direct_transforms,
    load_mapping,
    place_via_proxy,
    read_mapping,
)
from sfglab.spatial.mocap.offset import OffsetError, OffsetEstimate, PosePair, estimate_offset, pose_pairs
from sfglab.spatial.mocap.sources import LogSource, TopicSource, ViconError, ViconMissingError, ViconSource
from sfglab.spatial.mocap.synthetic import (
    SyntheticConfig,
    SyntheticMotion,
    SyntheticSource,
    TrueCapture,
    synthetic_captures,
)
from sfglab.spatial.mocap.tracking import (
    TRANSITIONS,
    Capture,
    Lapse,
    Limits,
    MocapError,
    MocapSource,
    Track,
    TrackState,
    Verdict,
    judge,
)

__all__ = [
    "STATUS",
    "STATUS_QOS",
    "TRANSITIONS",
    "BridgeCore",
    "BridgeOptions",
    "Capture",
    "Lapse",
    "Limits",
    "LogSource",
    "MappedObject",
    "MappingError",
    "MocapBridge",
    "MocapError",
    "MocapMapping",
    "MocapObjectStatus",
    "MocapSource",
    "MocapTrees",
    "OffsetError",
    "OffsetEstimate",
    "PlacingError",
    "PosePair",
    "SyntheticConfig",
    "SyntheticMotion",
    "SyntheticSource",
    "TopicSource",
    "Track",
    "TrackState",
    "TrueCapture",
    "Verdict",
    "ViconError",
    "ViconMissingError",
    "ViconSource",
    "direct_name",
    "direct_transforms",
    "estimate_offset",
    "judge",
    "load_mapping",
    "mocap_trees",
    "place_via_proxy",
    "pose_pairs",
    "read_mapping",
    "status_message",
    "status_topic",
    "synthetic_captures",
]
