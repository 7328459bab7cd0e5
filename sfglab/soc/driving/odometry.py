"""Visual odometry in ORB-SLAM's place: ORB features, matching, pose; no map, no loop closure, so it drifts.

ORB features (Rublee et al., 2011) of the ground ahead, matched from frame to keyframe, give the planar motion
in metres, as the camera's height is known. The paper runs ORB-SLAM 3, which also lives on buildings' key
points. Refuses to know the car's commands and the town.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.soc.driving.car import Camera

_FEATURES = 220
"""On one level: a pyramid places key points a part of a pixel off, which adds up to a false heading."""

_FARTHEST_M = 3.0  #: Ground points farther off are measured too coarsely.

_INLIER_M = 0.02
_FEWEST = 8
_KEYFRAME_M, _KEYFRAME_RAD = 0.15, 0.08


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """A planar pose; of the car since the first frame, in metres and radians."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0

    def outwards(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return a point of this pose's frame in the outer frame."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return self.x_m + cos * x_m - sin * y_m, self.y_m + sin * x_m + cos * y_m

    def inwards(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return a point of the outer frame in this pose's frame."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        x_m, y_m = x_m - self.x_m, y_m - self.y_m
        return cos * x_m + sin * y_m, cos * y_m - sin * x_m

    def then(self, step: Pose) -> Pose:
        """Return where a step, said in this pose's frame, leads to."""
        x_m, y_m = self.outwards(step.x_m, step.y_m)
        return Pose(x_m=x_m, y_m=y_m, yaw_rad=math.remainder(self.yaw_rad + step.yaw_rad, math.tau))


def planar_motion(before_xy: NDArray[np.float64], now_xy: NDArray[np.float64]) -> Pose | None:
    """Return a vehicle's motion between views (n, 2), m, of the same ground points; None if under eight agree.

    RANSAC and then least squares (Kabsch) over the inliers give the pose now in the frame before.
    """
    if len(now_xy) < _FEWEST:
        return None
    agree = cv2.estimateAffinePartial2D(
        now_xy, before_xy, ransacReprojThreshold=_INLIER_M, maxIters=300
    )[1]
    if agree is None or agree.sum() < _FEWEST:
        return None
    now, before = now_xy[agree.ravel() > 0], before_xy[agree.ravel() > 0]
    now_middle, before_middle = now.mean(axis=0), before.mean(axis=0)
    p, q = now - now_middle, before - before_middle
    yaw = math.atan2(float((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum()), float((p * q).sum()))
    turned = Pose(yaw_rad=yaw).outwards(*now_middle)
    return Pose(x_m=before_middle[0] - turned[0], y_m=before_middle[1] - turned[1], yaw_rad=yaw)


@dataclass(frozen=True, slots=True, kw_only=True)
class _View:
    """Ground points and descriptors of a frame."""

    points_xy: NDArray[np.float64]
    descriptors: NDArray[np.uint8]


class VisualOdometry:
    """The odometry node: integrates planar motion since the last keyframe; the camera's height is the scale."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._orb = cv2.ORB.create(
            nfeatures=_FEATURES, nlevels=1, fastThreshold=6, edgeThreshold=16
        )
        # The image's first row whose ground is not too far, with the rim that ORB needs above it.
        _, v, w = camera.image_from_ground @ (_FARTHEST_M, 0.0, 1.0)
        self._top = max(round(float(v / w)) - 16, camera.horizon_row)
        self._matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
        self._keyframe: _View | None = None
        self._key_pose = Pose()
        self._step = Pose()
        self.lost = 0

    @property
    def pose(self) -> Pose:
        """The car's pose since the first frame."""
        return self._key_pose.then(self._step)

    def see(self, bgr: NDArray[np.uint8]) -> Pose:
        """Return the pose at an image of topic A; one that does not match is `lost` and begins a keyframe."""
        view = self._view(bgr)
        step = self._motion(view)
        if step is None:
            self.lost += self._keyframe is not None
            self._begin(view)
            return self.pose
        self._step = step
        if math.hypot(step.x_m, step.y_m) > _KEYFRAME_M or abs(step.yaw_rad) > _KEYFRAME_RAD:
            self._begin(view)
        return self.pose

    def _begin(self, view: _View) -> None:
        self._key_pose, self._step, self._keyframe = self.pose, Pose(), view

    def _motion(self, view: _View) -> Pose | None:
        key = self._keyframe
        if key is None or not len(view.descriptors) or not len(key.descriptors):
            return None
        matches = self._matcher.match(view.descriptors, key.descriptors)
        now = view.points_xy[[m.queryIdx for m in matches]]
        return planar_motion(key.points_xy[[m.trainIdx for m in matches]], now)

    def _view(self, bgr: NDArray[np.uint8]) -> _View:
        """Return an image's ORB features that lie on near ground."""
        grey = cv2.cvtColor(bgr[self._top :], cv2.COLOR_BGR2GRAY)
        keypoints, descriptors = self._orb.detectAndCompute(grey, None)
        if not keypoints:
            return _View(points_xy=np.empty((0, 2)), descriptors=np.empty((0, 32), np.uint8))
        pixels = np.array([[k.pt[0], k.pt[1] + self._top, 1.0] for k in keypoints])
        raw = pixels @ self._camera.ground_from_image.T
        return _View(
            points_xy=raw[:, :2] / raw[:, 2:], descriptors=np.asarray(descriptors, np.uint8)
        )
