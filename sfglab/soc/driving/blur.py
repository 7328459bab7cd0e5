"""Gaussian blur: a low-pass filter over the compensated image."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from sfglab.soc.driving.ports import Ports

if TYPE_CHECKING:
    from numpy.typing import NDArray


PORTS = Ports(node="gaussian_blur", subscribes=("/A",), publishes=("/blurred",))


def blur(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the image through a Gaussian of 5 x 5 pixels, sigma 1 (paper C, section 6; size assumed)."""
    return np.asarray(cv2.GaussianBlur(bgr, (5, 5), 1.0), np.uint8)
