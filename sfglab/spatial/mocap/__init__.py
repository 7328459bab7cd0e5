"""Motion capture: where cameras see the agents, published so that every agent's tree of frames stays whole."""

from __future__ import annotations

from sfglab.spatial.mocap.bridge import BridgeOptions, MocapBridge
from sfglab.spatial.mocap.capture import Capture, Lapse, MocapError, MocapSource, Sight
from sfglab.spatial.mocap.core import BridgeCore, Latency, MocapObjectStatus
from sfglab.spatial.mocap.hand_eye import OffsetError, PosePair
from sfglab.spatial.mocap.mapping import (
    MappedObject,
    MappingError,
    MocapMapping,
    load_mapping,
    read_mapping,
)
from sfglab.spatial.mocap.offset import OffsetEstimate, estimate_offset, pose_pairs
from sfglab.spatial.mocap.placing import (
    PlacingError,
    direct_name,
    direct_transforms,
    place_via_proxy,
    root_below,
)
from sfglab.spatial.mocap.sources import (
    LogSource,
    SyntheticConfig,
    SyntheticMotion,
    SyntheticSource,
    TopicSource,
    TrueCapture,
    ViconError,
    ViconMissingError,
    ViconSource,
    synthetic_captures,
)
from sfglab.spatial.mocap.status import STATUS, STATUS_QOS, status_message, status_topic
from sfglab.spatial.mocap.tracking import TRANSITIONS, Doubt, Limits, Track, TrackState, Verdict, judge
from sfglab.spatial.mocap.trees import MocapTrees, mocap_trees

__all__ = [
    "STATUS",
    "STATUS_QOS",
    "TRANSITIONS",
    "BridgeCore",
    "BridgeOptions",
    "Capture",
    "Doubt",
    "Lapse",
    "Latency",
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
    "Sight",
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
    "root_below",
    "status_message",
    "status_topic",
    "synthetic_captures",
]
