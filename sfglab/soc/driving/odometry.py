"""The module `odometry` has the visual odometry, which is the software subscriber of topic A.

The odometry matches ORB features (Rublee et al., 2011) of the ground ahead between a frame and the last keyframe.
The motion of the matched features gives the car's planar motion in metres, because the camera's height is known.
The paper runs ORB-SLAM 3 instead of a visual odometry, and ORB-SLAM 3 creates a map. The odometry builds no map and closes no
loop, so the pose of the odometry drifts. The odometry has no information about the car's commands and the town.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from sfglab.soc.driving.pose import Pose

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.soc.driving.car import Camera

    Image = NDArray[np.uint8]
    Floats = NDArray[np.float64]

#: Number of features, all on one level of the image pyramid. Features of several levels have less exact positions, so
#: the heading would drift.
_FEATURES = 220
_FARTHEST_M = 3.0  #: Largest distance of ground points whose positions are exact enough.
_RIM_PX = 16  #: Width of the image's margin without features, pixels.
_INLIER_M = 0.02  #: Largest distance of a match from the common motion.
_MIN_MATCHES = 8
_KEYFRAME_M = 0.15  #: Distance from the last keyframe at which the next keyframe begins.
_KEYFRAME_RAD = 0.08  #: Turn since the last keyframe at which the next keyframe begins.


def planar_motion(before_xy: Floats, now_xy: Floats) -> Pose | None:
    """Return the motion of a vehicle whose camera showed the same ground points before and now.

    RANSAC selects the matches that agree, then least squares (Kabsch) gives the vehicle's motion.

    Args:
        before_xy: Points (n, 2), m, in the earlier vehicle frame.
        now_xy: The same ground points in the present vehicle frame.

    Returns:
        The present pose relative to the earlier pose, or None if fewer than 8 matches agree.
    """
    if len(now_xy) < _MIN_MATCHES:
        return None
    _, agreeing = cv2.estimateAffinePartial2D(
        now_xy, before_xy, ransacReprojThreshold=_INLIER_M, maxIters=300
    )
    if agreeing is None or agreeing.sum() < _MIN_MATCHES:
        return None
    chosen = agreeing.ravel() > 0
    # The points are complex numbers, so the turn is the phase of a product, and the shift is the remaining motion.
    now = now_xy[chosen] @ (1, 1j)
    before = before_xy[chosen] @ (1, 1j)
    turn = np.vdot(now - now.mean(), before - before.mean())
    direction = turn / abs(turn) if turn else 1  # Points at one place define no turn.
    shift = before.mean() - direction * now.mean()
    yaw_rad = float(np.angle(turn))
    return Pose(x_m=float(shift.real), y_m=float(shift.imag), yaw_rad=yaw_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class _View:
    """A `_View` has the features of a frame."""

    points_xy: Floats  #: Ground points in the vehicle frame, shape (n, 2), m.
    descriptors: Image  #: ORB descriptors, shape (n, 32), uint8.


class VisualOdometry:
    """The odometry node adds the motion since the last keyframe to the keyframe's pose."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._orb = cv2.ORB.create(
            nfeatures=_FEATURES, nlevels=1, fastThreshold=6, edgeThreshold=_RIM_PX
        )
        self._matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
        _, v, w = camera.image_from_ground @ (_FARTHEST_M, 0.0, 1.0)
        self._top = max(round(float(v / w)) - _RIM_PX, camera.horizon_row)
        self._keyframe: _View | None = None
        self._keyframe_pose = Pose()
        self.pose = Pose()  #: Pose of the car since the first frame.

    def update(self, bgr: Image) -> Pose:
        """Return the car's pose at an image (height, width, 3) of topic A.

        If an image does not match the keyframe, the pose stays unchanged and the image becomes the keyframe.
        """
        view = self._features(bgr)
        if self._keyframe is None:
            self._keyframe = view
            return self.pose
        motion = self._motion(self._keyframe, view)
        if motion is not None:
            self.pose = self._keyframe_pose.then(motion)
        if motion is None or _is_far(motion):
            self._keyframe = view
            self._keyframe_pose = self.pose
        return self.pose

    def _features(self, bgr: Image) -> _View:
        """Return the ORB features of an image on the near ground."""
        grey = cv2.cvtColor(bgr[self._top :], cv2.COLOR_BGR2GRAY)
        keypoints, descriptors = self._orb.detectAndCompute(grey, None)
        if not keypoints:
            return _View(points_xy=np.empty((0, 2)), descriptors=np.empty((0, 32), np.uint8))
        pixels = np.array([(point.pt[0], point.pt[1] + self._top, 1.0) for point in keypoints])
        raw = pixels @ self._camera.ground_from_image.T
        points_xy = raw[:, :2] / raw[:, 2:]
        return _View(points_xy=points_xy, descriptors=np.asarray(descriptors, np.uint8))

    def _motion(self, before: _View, now: _View) -> Pose | None:
        if not len(now.descriptors) or not len(before.descriptors):
            return None
        matches = self._matcher.match(now.descriptors, before.descriptors)
        now_indices = [match.queryIdx for match in matches]
        before_indices = [match.trainIdx for match in matches]
        return planar_motion(before.points_xy[before_indices], now.points_xy[now_indices])


def _is_far(motion: Pose) -> bool:
    return math.hypot(motion.x_m, motion.y_m) > _KEYFRAME_M or abs(motion.yaw_rad) > _KEYFRAME_RAD
