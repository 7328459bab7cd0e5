"""Trajectories: timed waypoints in SE(3), what lies between, what they collide with. Paper A, section 4.5.

Bottom up: `path` (waypoints), `alignment` (headings), `motion` (polyline, Catmull-Rom and rates), `limits`,
`retiming`, `shapes`, `clearance`, `ros` and `csv_text` (export and import).
"""

from __future__ import annotations

from sfglab.spatial.trajectory.alignment import Align, align_waypoint, aligned_quat, heading_quat
from sfglab.spatial.trajectory.clearance import (
    TOLERANCE_M,
    Approach,
    ObstacleApproach,
    closest_approach,
    closest_to_shape,
)
from sfglab.spatial.trajectory.csv_text import csv_from_trajectory, trajectory_from_csv
from sfglab.spatial.trajectory.limits import Limits, LimitViolation, Peaks, Quantity, limit_violations, peaks
from sfglab.spatial.trajectory.motion import Motion, Samples, motion_of, pose_at, resampled, sample
from sfglab.spatial.trajectory.path import (
    LATEST_NS,
    Interpolation,
    Trajectory,
    TrajectoryError,
    Waypoint,
    in_frame,
    stretched,
    with_durations,
)
from sfglab.spatial.trajectory.retiming import retimed
from sfglab.spatial.trajectory.ros import (
    multi_dof_from_trajectory,
    path_from_trajectory,
    trajectory_from_multi_dof,
    trajectory_from_path,
)
from sfglab.spatial.trajectory.shapes import Box, Cylinder, Shape, Sphere

__all__ = [
    "LATEST_NS",
    "TOLERANCE_M",
    "Align",
    "Approach",
    "Box",
    "Cylinder",
    "Interpolation",
    "LimitViolation",
    "Limits",
    "Motion",
    "ObstacleApproach",
    "Peaks",
    "Quantity",
    "Samples",
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
    "heading_quat",
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
    "with_durations",
]
