"""The frame in which a log's space is drawn when nobody chooses one."""

from __future__ import annotations

from collections import Counter
from itertools import islice
from typing import TYPE_CHECKING

from sfglab.record import LogReader
from sfglab.view.visualizers.poses import StaticTransforms, Transforms

if TYPE_CHECKING:
    from pathlib import Path

_MOST_MESSAGES = 10_000  #: Messages that are read of a topic: a tree shows its frames early.
_INPUTS = Transforms.inputs + StaticTransforms.inputs  #: What the viewer takes for transforms.
_USUAL = ("map", "odom")  #: Roots that are preferred among trees of one size (REP 105).


def largest_tree_root(path: str | Path) -> str:
    """Return the root of the largest TF tree of a log or bag; empty: it has no transforms.

    Raises:
        LogError: There is no such file, or it cannot be read.
    """
    parents: dict[str, str] = {}
    with LogReader(path) as reader:
        for topic, info in reader.topics.items():
            if not any(given.fits(topic, info.type_name) for given in _INPUTS):
                continue
            for recorded in islice(reader.decoded(topic), _MOST_MESSAGES):
                for transform in recorded.message.transforms:
                    parent = str(transform.header.frame_id).strip("/")
                    parents[str(transform.child_frame_id).strip("/")] = parent
    sizes = Counter(_root(frame, parents) for frame in parents)
    return min(sizes, key=lambda root: (-sizes[root], *_preference(root)), default="")


def _root(frame: str, parents: dict[str, str]) -> str:
    """Return the last frame on the way up; in a loop the first that comes again."""
    seen = {frame}
    while frame in parents and parents[frame] not in seen:
        frame = parents[frame]
        seen.add(frame)
    return frame


def _preference(root: str) -> tuple[int, str]:
    return (_USUAL.index(root) if root in _USUAL else len(_USUAL), root)
