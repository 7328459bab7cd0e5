"""Frames with time: a buffer of transforms, look-up at any time within it, names with prefixes, and a lint."""

from __future__ import annotations

from sfglab.spatial.frames.buffer import (
    Edge,
    ExtrapolationError,
    FrameBuffer,
    FrameError,
    NotConnectedError,
    UnknownFrameError,
)
from sfglab.spatial.frames.lint import FrameFinding, FrameRule, draw_tree, lint_frames
from sfglab.spatial.frames.listener import TF_QOS, TF_STATIC_QOS, TRANSFORMS, FramesListener, fill_from_log

__all__ = [
    "TF_QOS",
    "TF_STATIC_QOS",
    "TRANSFORMS",
    "Edge",
    "ExtrapolationError",
    "FrameBuffer",
    "FrameError",
    "FrameFinding",
    "FrameRule",
    "FramesListener",
    "NotConnectedError",
    "UnknownFrameError",
    "draw_tree",
    "fill_from_log",
    "lint_frames",
]
