"""Trajectories: timed waypoints in SE(3), what lies between, what they collide with. Paper A, section 4.5.

Bottom up: `path` (waypoints, headings), `motion` (polyline, Catmull-Rom and rates), `limits` (with re-timing),
`clearance` (with shapes), `exchange` (CSV and messages).
"""

from __future__ import annotations

from sfglab.spatial.trajectory.clearance import (
    Approach,
    Box,
    Cylinder,
    ObstacleApproach,
    Shape,
    Sphere,
    closest_approach,
    closest_to_shape,
)
from sfglab.spatial.trajectory.exchange import (
    csv_from_trajectory,
    multi_dof_from_trajectory,
    path_from_trajectory,
    trajectory_from_csv,
    trajectory_from_multi_dof,
    trajectory_from_path,
)
from sfglab.spatial.trajectory.limits import Limits, Quantity, limit_violations, peaks, retimed
from sfglab.spatial.trajectory.motion import motion_of, pose_at, resampled, sample
from sfglab.spatial.trajectory.path import (
    LATEST_NS,
    Align,
    Interpolation,
    Trajectory,
    TrajectoryError,
    Waypoint,
    align_waypoint,
    aligned_quat,
    in_frame,
    stretched,
)

__all__ = [
    "LATEST_NS",
    "Align",
    "Approach",
    "Box",
    "Cylinder",
    "Interpolation",
    "Limits",
    "ObstacleApproach",
    "Quantity",
    "Shape",
    "Sphere",
    "Trajectory",
    "TrajectoryError",
    "Waypoint",
    "align_waypoint",
    "aligned_quat",
    "closest_approach",
    "closest_to_shape",
    "csv_from_trajectory",
    "in_frame",
    "limit_violations",
    "motion_of",
    "multi_dof_from_trajectory",
    "path_from_trajectory",
    "peaks",
    "pose_at",
    "resampled",
    "retimed",
    "sample",
    "stretched",
    "trajectory_from_csv",
    "trajectory_from_multi_dof",
    "trajectory_from_path",
]
