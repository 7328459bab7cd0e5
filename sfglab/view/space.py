"""The frame in which a log's space is drawn when nobody chooses one."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

from sfglab.record import LogReader
from sfglab.view.visualizers.poses import StaticTransforms, Transforms

if TYPE_CHECKING:
    from pathlib import Path

_MOST_MESSAGES = 10_000  #: Messages that are read of a topic: a tree shows its frames early.
_INPUTS = Transforms.inputs + StaticTransforms.inputs  #: What the viewer takes for transforms.
_USUAL = ("map", "odom")  #: Roots that are preferred among trees of one size (REP 105).


@dataclass(frozen=True, slots=True)
class Tree:
    """A TF tree of a log."""

    root: str = ""  #: Name of the frame without a parent; empty: the log has no transforms.
    complete_ns: int = 0  #: Time on the log's clock when the last of its frames first appears.


def largest_tree_root(path: str | Path) -> str:
    """Return the root of `largest_tree`."""
    return largest_tree(path).root


def largest_tree(path: str | Path) -> Tree:
    """Return the largest TF tree of a log or bag.

    Raises:
        LogError: There is no such file, or it cannot be read.
    """
    parents: dict[str, str] = {}
    first_ns: dict[str, int] = {}
    with LogReader(path) as reader:
        for topic, info in reader.topics.items():
            if not any(given.fits(topic, info.type_name) for given in _INPUTS):
                continue
            for recorded in islice(reader.decoded(topic), _MOST_MESSAGES):
                for transform in recorded.message.transforms:
                    child = str(transform.child_frame_id).strip("/")
                    parents[child] = str(transform.header.frame_id).strip("/")
                    at_ns = recorded.log_time_ns
                    first_ns[child] = min(at_ns, first_ns.get(child, at_ns))
    roots = {frame: _root(frame, parents) for frame in parents}
    if not roots:
        return Tree()
    sizes = Counter(roots.values())
    root = min(sizes, key=lambda root: (-sizes[root], *_preference(root)))
    return Tree(root, max(first_ns[frame] for frame in roots if roots[frame] == root))


def _root(frame: str, parents: dict[str, str]) -> str:
    """Return the last frame on the way up; in a loop the first that comes again."""
    seen = {frame}
    while frame in parents and parents[frame] not in seen:
        frame = parents[frame]
        seen.add(frame)
    return frame


def _preference(root: str) -> tuple[int, str]:
    return (_USUAL.index(root) if root in _USUAL else len(_USUAL), root)
