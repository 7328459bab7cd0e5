"""The largest TF tree of a log: without another choice, its root is the frame of the 3D view."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

from sfglab.view.visualizers.poses import StaticTransforms, Transforms

if TYPE_CHECKING:
    from sfglab.record import LogReader

#: Number of messages that are read per topic; frames of a tree appear early.
_MOST_MESSAGES = 10_000
_INPUTS = Transforms.inputs + StaticTransforms.inputs  #: Inputs whose topics have transforms.
_USUAL = ("map", "odom")  #: Roots that are preferred among trees of one size (REP 105).


@dataclass(frozen=True, slots=True)
class Tree:
    """Root of a TF tree of a log, and the time at which the tree is complete."""

    root: str = ""  #: Name of the frame without a parent; empty: the log has no transforms.
    #: Time, ns on the log's clock, at which all frames of the tree have appeared.
    complete_ns: int = 0


def largest_tree(log: LogReader) -> Tree:
    """Return the TF tree with the most frames in the first 10,000 messages per transform topic of a log or bag."""
    parents: dict[str, str] = {}
    first_ns: dict[str, int] = {}
    for topic, info in log.topics.items():
        if not any(given.fits(topic, info.type_name) for given in _INPUTS):
            continue
        for recorded in islice(log.decoded(topic), _MOST_MESSAGES):
            for transform in recorded.message.transforms:
                child = transform.child_frame_id.strip("/")
                parents[child] = transform.header.frame_id.strip("/")
                earlier_ns = first_ns.get(child, recorded.log_time_ns)
                first_ns[child] = min(earlier_ns, recorded.log_time_ns)
    trees: dict[str, list[int]] = {}
    for frame in parents:
        trees.setdefault(_root(frame, parents), []).append(first_ns[frame])
    if not trees:
        return Tree()
    root = min(trees, key=lambda root: (-len(trees[root]), *_preference(root)))
    return Tree(root, max(trees[root]))


def _root(frame: str, parents: dict[str, str]) -> str:
    """Return the highest frame above a frame; in a loop, the first frame that repeats."""
    seen = {frame}
    while frame in parents and parents[frame] not in seen:
        frame = parents[frame]
        seen.add(frame)
    return frame


def _preference(root: str) -> tuple[int, str]:
    return (_USUAL.index(root) if root in _USUAL else len(_USUAL), root)
