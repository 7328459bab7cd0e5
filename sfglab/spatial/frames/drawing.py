"""Trees of frames drawn as in paper A's Fig. 6: roots above, what is wrong in colour.

Knows axes, edges and findings. Refuses to know what is wrong (`lint`), and how figures are saved.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from matplotlib.axes import Axes

    from sfglab.spatial.frames.buffer import Edge
    from sfglab.spatial.frames.lint import FrameFinding


# Okabe and Ito's palette, distinct for all common kinds of colour blindness.
WRONG, OUTSIDE, PLAIN = "#D55E00", "#0072B2", "#666666"
_FILL, _WRONG_FILL = "#FFFFFF", "#FBE3D3"


def draw_tree(
    ax: Axes,
    edges: Iterable[Edge],
    *,
    findings: Sequence[FrameFinding] = (),
    outside: str = "",
) -> None:
    """Draw a tree, or what should be one.

    Args:
        ax: Where.
        edges: As `FrameBuffer.edges` has them.
        findings: What `lint_frames` found: its frames are drawn in colour.
        outside: The authority whose edges are drawn in colour, as motion capture's.
    """
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
    ax.set_xlim(min(xs) - 0.6, max(xs) + 0.6)
    ax.set_ylim(min(ys) - 0.5, max(ys) + 0.5)
    ax.set_axis_off()


def tree_layout(edges: Iterable[Edge]) -> dict[str, tuple[float, float]]:
    """Return a place for every frame: rows by the distance to a root, leaves side by side.

    Where a frame has several parents, the first one counts; frames in a circle start at any of them.

    Args:
        edges: As `FrameBuffer.edges` has them.
    """
    edges = tuple(edges)
    parents: dict[str, str] = {}
    children: dict[str, list[str]] = defaultdict(list)
    counts = Counter(child for child, _ in {(edge.child, edge.parent) for edge in edges})
    for edge in edges:
        if parents.setdefault(edge.child, edge.parent) == edge.parent:
            children[edge.parent].append(edge.child)
    for below in children.values():
        below.sort(key=counts.__getitem__)  # who has several parents stands outside, near the other ones
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
    width = _width(frame)
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


def _width(frame: str) -> float:
    """Return the room that a name takes, in the layout's units."""
    return 0.35 + 0.085 * max(map(len, _shown(frame).splitlines()))


def _draw_edge(ax: Axes, edge: Edge, places: Mapping[str, tuple[float, float]], colour: str) -> None:
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
