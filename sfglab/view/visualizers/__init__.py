"""The visualizers that come with sfglab, by what they show."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.view.visualizers.clouds import CompressedDepthCloud, DepthCloud, LaserScan, PointCloud
from sfglab.view.visualizers.fleet import AgentStatus, Communication
from sfglab.view.visualizers.images import (
    CameraModel,
    CompressedImage,
    CompressedImageVideo,
    FfmpegVideo,
    FoxgloveVideo,
    Image,
)
from sfglab.view.visualizers.markers import Marker, MarkerArray
from sfglab.view.visualizers.poses import Imu, Odometry, Path, Pose, StaticTransforms, Transforms

if TYPE_CHECKING:
    from sfglab.view.visualizer import Visualizer

__all__ = ["BUILT_IN"]

BUILT_IN: tuple[type[Visualizer], ...] = (
    Image,
    CompressedImage,
    CameraModel,
    FfmpegVideo,
    FoxgloveVideo,
    CompressedImageVideo,
    DepthCloud,
    CompressedDepthCloud,
    PointCloud,
    LaserScan,
    Transforms,
    StaticTransforms,
    Pose,
    Path,
    Odometry,
    Imu,
    Marker,
    MarkerArray,
    AgentStatus,
    Communication,
)
"""All of them, in the order in which they offer themselves for a topic."""
