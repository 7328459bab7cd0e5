"""Compensation: an image's histogram stretched and its outlier pixels removed; knows no lane and no light."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from sfglab.soc.driving.ports import Ports

if TYPE_CHECKING:
    from numpy.typing import NDArray


PORTS = Ports(node="compensation", subscribes=("/image",), publishes=("/A",))

_OUTLIER = 48
"""Levels by which a pixel differs from the median around it when it is noise, in every case but a lamp's
edge."""

_TAIL = 0.005
"""Share of darkest and of brightest pixels that the histogram is not stretched for."""


def compensate(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Remove outlier pixels, then stretch the histogram over all levels (paper C, section 6: Compensation).

    The paper names the histogram and the removal of outliers and no method: an outlier here is a pixel far from
    the median of its 3 x 3 neighbourhood, which replaces it, and the stretch is linear and the same for all
    channels, so that hues stay.

    Args:
        bgr: Shape (height, width, 3).

    Returns:
        An image of the same shape.
    """
    median = cv2.medianBlur(bgr, 3)
    difference = cv2.absdiff(bgr, median)
    outlier = cv2.inRange(difference, (0, 0, 0), (_OUTLIER, _OUTLIER, _OUTLIER)) == 0
    clean = np.where(outlier[..., None], median, bgr)
    return np.asarray(cv2.LUT(clean, stretch(clean)), np.uint8)


def stretch(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the table of 256 levels that stretches a grey histogram, without its tails, to 0 .. 255."""
    grey = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
    share = np.cumsum(cv2.calcHist([grey], [0], None, [256], [0, 256]).ravel()) / grey.size
    low, high = np.searchsorted(share, [_TAIL, 1 - _TAIL])
    levels = (np.arange(256) - low) * (255.0 / max(int(high) - int(low), 1))
    return np.asarray(np.clip(np.rint(levels), 0, 255), np.uint8)
