"""Where points of a scene are on the page of its editor."""

import math

import numpy as np

CAMERA = "[list(map(float, c.position)), list(map(float, c.look_at)), float(c.fov)]"
"""Attributes of a browser's camera `c` that `pixel` needs."""


def pixel(camera, canvas, point):
    """Return where a point is, by what `CAMERA` gives, and the canvas's x, y, width and height on the page."""
    position, look_at, fov = camera
    x, y, width, height = canvas
    ahead = np.subtract(look_at, position)
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    seen = np.subtract(point, position)
    scale = height / 2 / math.tan(fov / 2) / (seen @ ahead)
    return (x + width / 2 + scale * (seen @ right), y + height / 2 + scale * (seen @ down))
