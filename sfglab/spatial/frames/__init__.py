"""Frames with time: a buffer of transforms, look-up at any time within it, names with prefixes, and a lint."""

from __future__ import annotations

from sfglab.spatial.frames.buffer import (
    Edge,
    ExtrapolationError,
    FrameBuffer,
    FrameError,
    FrameInputError,
    FrameLoopError,
    NotConnectedError,
    UnknownFrameError,
)
from sfglab.spatial.frames.drawing import draw_tree, tree_layout
from sfglab.spatial.frames.history import Insertion
from sfglab.spatial.frames.lint import (
    SHARED_FRAMES,
    FrameFinding,
    FrameRule,
    agent_of,
    lint_frames,
    prefixed,
    roots_of,
)
from sfglab.spatial.frames.listener import (
    TF_QOS,
    TF_STATIC_QOS,
    TRANSFORMS,
    FramesListener,
    TransformIntake,
    fill_from_log,
)

__all__ = [
    "SHARED_FRAMES",
    "TF_QOS",
    "TF_STATIC_QOS",
    "TRANSFORMS",
    "Edge",
    "ExtrapolationError",
    "FrameBuffer",
    "FrameError",
    "FrameFinding",
    "FrameInputError",
    "FrameLoopError",
    "FrameRule",
    "FramesListener",
    "Insertion",
    "NotConnectedError",
    "TransformIntake",
    "UnknownFrameError",
    "agent_of",
    "draw_tree",
    "fill_from_log",
    "lint_frames",
    "prefixed",
    "roots_of",
    "tree_layout",
]
