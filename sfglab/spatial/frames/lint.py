"""Errors of a TF tree: parents, loops, roots, names, stamps, and transforms that listeners ignore.

tf2 reports few of these errors. A frame with two parents jumps between them, and in a tree with two roots a lookup
fails later and in another node. Frames have the prefix of their agent, ``<agent>/<frame>`` (paper A, section 4.1,
and `sfglab.names`). The functions check received edges; they need neither a clock nor a node.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

from sfglab.names import SHARED_FRAMES, TF, TF_STATIC, validate_agent
from sfglab.spatial.frames.listener import LOOP
from sfglab.validation import suggestion

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from sfglab.spatial.frames.buffer import Edge


_WHY = {
    "two-parents": "a frame has one parent: it jumps between them, as the latest transform counts",
    "static-and-dynamic": "each of them makes listeners forget the other",
    "two-publishers": "the frame jumps between their poses",
    "loop": "no root is above them, so every look-up fails",
    "unreachable": "no look-up leads from one tree to the other",
    "second-root": "no look-up leads from one tree to the other",
    "name": "a look-up of the right name fails",
    "backwards": "a clock was set, a log is played again, or transforms overtake each other",
    "static-twice": "the frame is where the latest message puts it, and their order is not certain",
    "repeated": "which of the poses a look-up returns depends on the listener",
    "refused": "listeners ignore it: the frame is missing or does not move",
    "namespaced": f"TF listeners subscribe to {TF} and {TF_STATIC} unless they are remapped",
}
"""Consequence of each error, by its code."""


@dataclass(frozen=True, slots=True)
class FrameFinding:
    """One error of a TF tree."""

    code: str  #: Code of the error.
    frames: tuple[str, ...]  #: Frames, or topics, with the error.
    what: str  #: Description of the error.

    @property
    def why(self) -> str:
        """Consequence of the error."""
        return _WHY[self.code]

    def __str__(self) -> str:
        return f"{self.code}: {self.what} ({self.why})"


def lint_frames(
    edges: Iterable[Edge],
    *,
    agents: Iterable[str] = (),
    root: str | None = None,
    refused: Mapping[tuple[str, str, str], int] | None = None,
    namespaced: Iterable[str] = (),
) -> tuple[FrameFinding, ...]:
    """Return the errors of a TF tree.

    Args:
        edges: Edges of the tree, as of `FrameBuffer.edges`.
        agents: Agents whose prefixes are allowed, besides shared frames; none: all names are allowed.
        root: The one root that the tree must have; None: any.
        refused: Refused transforms, as of `TransformIntake.refused`.
        namespaced: Topics with transforms other than /tf and /tf_static.

    Raises:
        FqnError: The name of an agent is not valid.
    """
    import networkx as nx

    edges = tuple(edges)
    tree = nx.DiGraph((edge.child, edge.parent) for edge in edges)
    return (
        *_publishers(edges),
        *_loops(tree),
        *_roots(tree, root),
        *_names(sorted(tree), frozenset(map(validate_agent, agents))),
        *_stamps(edges),
        *_ignored(refused or {}, namespaced),
    )


def _publishers(edges: Iterable[Edge]) -> Iterator[FrameFinding]:
    """Find frames that are published twice, in different ways."""
    by_child: dict[str, list[Edge]] = defaultdict(list)
    for edge in edges:
        by_child[edge.child].append(edge)
    for child, group in by_child.items():
        parents = sorted({edge.parent for edge in group})
        rivals = _rivals(group)
        if len(parents) > 1:
            what = f"{child!r} is placed in {_listed(parents)}"
            yield FrameFinding("two-parents", (child, *parents), what)
        elif len({edge.static for edge in group}) > 1:
            what = f"{child!r} is published on {TF} and on {TF_STATIC}"
            yield FrameFinding("static-and-dynamic", (child,), what)
        elif rivals:
            what = f"{child!r} is published by {_listed(rivals)}"
            yield FrameFinding("two-publishers", (child,), what)


def _rivals(group: Sequence[Edge]) -> list[str]:
    """Return the publishers that publish an edge at the same time, without those that replaced an earlier one."""
    moving = sorted((e for e in group if not e.static), key=lambda e: (e.first_ns, e.last_ns))
    rivals = set()
    for before, after in combinations(moving, 2):
        if before.authority != after.authority and after.first_ns <= before.last_ns:
            rivals |= {before.authority, after.authority}
    return sorted(rivals)


def _loops(tree: Any) -> Iterator[FrameFinding]:
    """Find a loop in each group of frames that are above each other."""
    import networkx as nx

    for frames in sorted(map(sorted, nx.strongly_connected_components(tree))):
        group = tree.subgraph(frames)
        if group.size():
            loop = [child for child, _ in nx.find_cycle(group, frames[0])]
            what = f"{' -> '.join([*loop, loop[0]])}, from child to parent"
            yield FrameFinding("loop", tuple(sorted(loop)), what)


def _roots(tree: Any, root: str | None) -> Iterator[FrameFinding]:
    import networkx as nx

    roots = sorted(frame for frame, parents in tree.out_degree if not parents)
    if root is None:
        if len(roots) > 1:
            what = f"there are {len(roots)} trees, with the roots {_listed(roots)}"
            yield FrameFinding("second-root", tuple(roots), what)
        return
    reached = nx.ancestors(tree, root) if root in tree else set()
    lost = sorted(set(tree) - reached - {root})
    if lost:
        code = "second-root" if root in tree and set(lost) & set(roots) else "unreachable"
        yield FrameFinding(code, tuple(lost), f"{_listed(lost)} cannot be reached from {root!r}")


def _names(frames: Sequence[str], agents: frozenset[str]) -> Iterator[FrameFinding]:
    allowed = [frame for frame in frames if _is_allowed(frame, agents)]
    names = f"<agent>/<frame> of {', '.join(sorted(agents))}, and {', '.join(SHARED_FRAMES)}"
    for frame in frames:
        if agents and not _is_allowed(frame, agents):
            hint = suggestion(frame, allowed)
            yield FrameFinding("name", (frame,), f"given {frame!r}, allowed: {names}{hint}")


def _is_allowed(frame: str, agents: frozenset[str]) -> bool:
    agent, _, rest = frame.partition("/")
    has_prefix = agent in agents and rest != "" and not rest.startswith("/")
    return has_prefix or frame in SHARED_FRAMES


def _stamps(edges: Iterable[Edge]) -> Iterator[FrameFinding]:
    for edge in edges:
        frame = (edge.child,)
        if edge.backwards:
            what = f"stamps of {edge.child!r} step back {edge.backwards} times, by up to {edge.back_ns} ns"
            yield FrameFinding("backwards", frame, what)
        if edge.contradicting:
            code, what = "repeated", "was published with the same stamp"
            if edge.static:
                code, what = "static-twice", "is static and was published"
            times = f"{edge.contradicting}x"
            yield FrameFinding(code, frame, f"{edge.child!r} {what} with another pose ({times})")


def _ignored(
    refused: Mapping[tuple[str, str, str], int], namespaced: Iterable[str]
) -> Iterator[FrameFinding]:
    for (parent, child, why), count in refused.items():
        if why != LOOP:
            what = f"transform {parent!r} -> {child!r} ({count}x): {why}"
            yield FrameFinding("refused", (parent, child), what)
    for topic in namespaced:
        yield FrameFinding("namespaced", (topic,), f"{topic} has transforms")


def _listed(names: Sequence[str]) -> str:
    *others, last = [repr(name) for name in names]
    return f"{', '.join(others)} and {last}" if others else last
