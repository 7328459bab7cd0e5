"""Faults of a tree of frames, said before anybody stumbles over them: parents, loops, roots, names, time.

tf2 takes what comes: with two parents the frame jumps between them, with two roots a look-up fails much later
and elsewhere. Paper A, section 4.1, asks for prefixes, ``<agent>/<frame>``; that rule is `sfglab.names`'. Trees
are drawn as in the paper's Fig. 6: roots above, what is wrong in colour. Pure: judges edges that were observed.
"""

from __future__ import annotations

import difflib
from collections import Counter, defaultdict
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

from sfglab.names import SHARED_FRAMES, validate_agent

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from matplotlib.axes import Axes

    from sfglab.spatial.frames.buffer import Edge


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameRule:
    """Which names frames may have; FqnError where an agent's is none that an agent may bear."""

    agents: frozenset[str]  #: Agents whose prefixes are known.
    shared: frozenset[str] = frozenset(SHARED_FRAMES)  #: Frames without prefix that are allowed.

    def __post_init__(self) -> None:
        for agent in self.agents:
            validate_agent(agent)

    def problem(self, frame: str, known: frozenset[str] = frozenset()) -> str | None:
        """Say what is wrong with a frame's name, or return None; what was meant is sought among the known."""
        agent, slash, rest = frame.partition("/")
        if frame in self.shared or (
            slash and agent in self.agents and rest and not rest.startswith("/")
        ):
            return None
        fitting = sorted(name for name in known - {frame} if self.problem(name) is None)
        near = difflib.get_close_matches(frame, fitting, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        allowed = f"<agent>/<frame> of {', '.join(sorted(self.agents)) or 'no agent'}"
        shared = ", ".join(sorted(self.shared)) or "nothing"
        return f"given {frame!r}, allowed are {allowed}, and {shared}{hint}"


_WHY = {
    "two-parents": "a frame has one parent: it jumps between them, as whichever came last counts",
    "static-and-dynamic": "each of them makes listeners forget the other",
    "two-publishers": "the frame jumps between what they say",
    "loop": "no root is above them, so no look-up ends",
    "unreachable": "no look-up leads from one tree to the other",
    "second-root": "no look-up leads from one tree to the other",
    "name": "who looks for it by its right name finds nothing",
    "backwards": "a clock was set, a log plays again, or transforms overtake each other",
}
"""Every code of a fault, and what comes of it."""


@dataclass(frozen=True, slots=True)
class FrameFinding:
    """One fault of a tree."""

    code: str  #: Which fault.
    frames: tuple[str, ...]  #: The frames that it is about.
    what: str  #: What was found.

    @property
    def why(self) -> str:
        """What comes of it."""
        return _WHY[self.code]

    def __str__(self) -> str:
        return f"{self.code}: {self.what} ({self.why})"


def lint_frames(
    edges: Iterable[Edge], *, rule: FrameRule | None = None, root: str | None = None
) -> tuple[FrameFinding, ...]:
    """Judge a tree's parents, loops, roots, names and time; without rule or root any is allowed."""
    edges = tuple(edges)
    by_child: dict[str, list[Edge]] = defaultdict(list)
    for edge in edges:
        by_child[edge.child].append(edge)
    above = {
        child: tuple(dict.fromkeys(e.parent for e in group)) for child, group in by_child.items()
    }
    return (
        *_parents(by_child),
        *_loops(above),
        *_roots(above, root),
        *_names(edges, rule),
        *_backwards(edges),
    )


def _parents(by_child: Mapping[str, Sequence[Edge]]) -> Iterator[FrameFinding]:
    for child, group in by_child.items():
        parents = sorted({e.parent for e in group})
        authorities = _rivals(group)
        if len(parents) > 1:
            yield FrameFinding(
                "two-parents", (child, *parents), f"{child!r} is placed in {_listed(parents)}"
            )
        elif len({e.static for e in group}) > 1:
            yield FrameFinding(
                "static-and-dynamic", (child,), f"{child!r} comes on /tf and on /tf_static"
            )
        elif authorities:
            yield FrameFinding(
                "two-publishers", (child,), f"{child!r} is published by {_listed(authorities)}"
            )


def _rivals(group: Sequence[Edge]) -> list[str]:
    """Return who publishes an edge while others do; one that took over, as after a restart, is no rival."""
    moving = sorted((e for e in group if not e.static), key=lambda e: (e.first_ns, e.last_ns))
    rivals = set()
    for before, after in combinations(moving, 2):
        if before.authority != after.authority and after.first_ns <= before.last_ns:
            rivals |= {before.authority, after.authority}
    return sorted(rivals)


def _loops(parents: Mapping[str, Sequence[str]]) -> Iterator[FrameFinding]:
    """Find circles; each is told once, beginning with its first frame by name."""
    told: set[frozenset[str]] = set()
    for start in sorted(parents):
        loop = _loop_from(start, parents)
        if loop and frozenset(loop) not in told:
            told.add(frozenset(loop))
            yield FrameFinding(
                "loop", tuple(loop), f"{' -> '.join((*loop, loop[0]))} (child -> parent)"
            )


def _loop_from(start: str, parents: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the shortest way from a frame up to itself; empty when there is none."""
    ways = [[start]]
    seen = {start}
    for way in ways:
        for parent in parents.get(way[-1], ()):
            if parent == start:
                return way
            if parent not in seen:
                seen.add(parent)
                ways.append([*way, parent])
    return []


def _roots(parents: Mapping[str, Sequence[str]], root: str | None) -> Iterator[FrameFinding]:
    frames = {*parents, *(p for group in parents.values() for p in group)}
    roots = sorted(frames - set(parents))
    others = [r for r in roots if r != root]
    if root is not None and frames:
        lost = sorted(frames - _below(root, parents) - set(others))
        if others or lost:
            code = "second-root" if root in frames and others else "unreachable"
            what = f"{_listed([*others, *lost])} cannot be reached from {root!r}"
            yield FrameFinding(code, (*others, *lost), what)
    elif len(roots) > 1:
        what = f"there are {len(roots)} trees, with the roots {_listed(roots)}"
        yield FrameFinding("second-root", tuple(roots), what)


def _below(root: str, parents: Mapping[str, Sequence[str]]) -> set[str]:
    children: dict[str, list[str]] = defaultdict(list)
    for child, group in parents.items():
        for parent in group:
            children[parent].append(child)
    below, rest = {root}, [root]
    while rest:
        new = [child for child in children[rest.pop()] if child not in below]
        below.update(new)
        rest += new
    return below


def _names(edges: Sequence[Edge], rule: FrameRule | None) -> Iterator[FrameFinding]:
    if rule is None:
        return
    frames = frozenset(name for e in edges for name in (e.child, e.parent))
    for frame in sorted(frames):
        if problem := rule.problem(frame, frames):
            yield FrameFinding("name", (frame,), problem)


def _backwards(edges: Sequence[Edge]) -> Iterator[FrameFinding]:
    for edge in edges:
        if edge.backwards:
            what = f"stamps of {edge.child!r} step back {edge.backwards} times, by up to {edge.back_ns} ns"
            yield FrameFinding("backwards", (edge.child,), what)


def _listed(names: Sequence[str]) -> str:
    quoted = [repr(name) for name in names]
    return quoted[0] if len(quoted) == 1 else f"{', '.join(quoted[:-1])} and {quoted[-1]}"


# Okabe and Ito's palette, distinct for all common kinds of colour blindness.
WRONG, OUTSIDE, PLAIN = "#D55E00", "#0072B2", "#666666"
_FILL, _WRONG_FILL = "#FFFFFF", "#FBE3D3"


def draw_tree(
    ax: Axes, edges: Iterable[Edge], *, findings: Sequence[FrameFinding] = (), outside: str = ""
) -> None:
    """Draw a tree, or what should be one; findings' frames and an outside authority's edges in colour."""
    edges = tuple(edges)
    places = tree_layout(edges)
    wrong = {frame for finding in findings for frame in finding.frames}
    for edge in edges:
        _draw_edge(ax, edge, places, OUTSIDE if edge.authority == outside and outside else PLAIN)
    for frame, (x, y) in places.items():
        bad = frame in wrong
        box = {
            "boxstyle": "round,pad=0.35",
            "facecolor": _WRONG_FILL if bad else _FILL,
            "edgecolor": WRONG if bad else PLAIN,
            "linewidth": 1.8 if bad else 1.0,
        }
        ax.text(x, y, _shown(frame), ha="center", va="center", fontsize=8, bbox=box, zorder=3)
    xs, ys = zip(*places.values(), strict=True) if places else ((0.0,), (0.0,))
    ax.set(xlim=(min(xs) - 0.6, max(xs) + 0.6), ylim=(min(ys) - 0.5, max(ys) + 0.5))
    ax.set_axis_off()


def tree_layout(edges: Iterable[Edge]) -> dict[str, tuple[float, float]]:
    """Return a place for every frame, below its first parent, leaves side by side; a circle starts anywhere."""
    edges = tuple(edges)
    parents: dict[str, str] = {}
    children: dict[str, list[str]] = defaultdict(list)
    counts = Counter(child for child, _ in {(edge.child, edge.parent) for edge in edges})
    for edge in edges:
        if parents.setdefault(edge.child, edge.parent) == edge.parent:
            children[edge.parent].append(edge.child)
    for below in children.values():
        below.sort(
            key=counts.__getitem__
        )  # who has several parents stands outside, near the other ones
    frames = list(dict.fromkeys(name for edge in edges for name in (edge.parent, edge.child)))
    places: dict[str, tuple[float, float]] = {}
    right = 0.0
    for frame in sorted(frames, key=lambda name: name in parents):
        if frame not in places:
            right = _place(frame, 0, right, children, places)
    return places


def _place(
    frame: str,
    depth: int,
    left: float,
    children: Mapping[str, Sequence[str]],
    places: dict[str, tuple[float, float]],
) -> float:
    """Place a frame above its children and return where the next one may begin."""
    # The room that a name takes, in the layout's units.
    width = 0.35 + 0.085 * max(map(len, _shown(frame).splitlines()))
    places[frame] = (left + width / 2, -float(depth))
    below = [child for child in dict.fromkeys(children.get(frame, ())) if child not in places]
    right = left
    for child in below:
        right = _place(child, depth + 1, right, children, places)
    if below:
        first, last = places[below[0]][0], places[below[-1]][0]
        places[frame] = ((first + last) / 2, -float(depth))
    return max(right, left + width)


def _shown(frame: str) -> str:
    return frame.replace("/", "/\n")


def _draw_edge(
    ax: Axes, edge: Edge, places: Mapping[str, tuple[float, float]], colour: str
) -> None:
    ax.annotate(
        "",
        xy=places[edge.child],
        xytext=places[edge.parent],
        arrowprops={
            "arrowstyle": "-|>",
            "color": colour,
            "linewidth": 1.2 if edge.static else 1.8,
            "shrinkA": 15,
            "shrinkB": 16,
        },
        zorder=2,
    )
