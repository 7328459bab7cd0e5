"""Checks of transform frames: the TF trees of all agents together, as every agent sees them behind its router.

Table 1 of paper A forwards /tf and /tf_static. Section 4.1 requires prefixes against clashes, section 4.5 a
single root.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.fleet.lint.report import Finding, a_warning, an_error
from sfglab.fleet.policy import Crossing
from sfglab.fleet.router.frames import Frames
from sfglab.names import TF, TF_STATIC, ResourceKind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from sfglab.fleet.fleet_file import AgentSpec, FrameSpec
    from sfglab.fleet.lint.uses import View


@dataclass(frozen=True, slots=True, kw_only=True)
class Edge:
    """One transform as other agents receive it."""

    agent: str  #: Agent that broadcasts it.
    child: str  #: Child frame, with prefix.
    parent: str  #: Parent frame, with prefix.
    frame: FrameSpec  #: Transform as the agent's nodes write it.


def edges_of(agent: AgentSpec) -> tuple[Edge, ...]:
    """Return an agent's transforms as other agents receive them."""
    frames = Frames(agent=agent.name, shared=frozenset(agent.tf.shared_frames))

    def outside(frame: str) -> str:
        return frames.outward(frame) if agent.tf.prefix_frames else frame.removeprefix("/")

    edges = []
    for frame in agent.tf.frames:
        child, parent = outside(frame.child), outside(frame.parent)
        edges.append(Edge(agent=agent.name, child=child, parent=parent, frame=frame))
    return tuple(edges)


def roots_of(edges: Iterable[Edge]) -> dict[str, str]:
    """Return the root of every frame, along its last parents; frames in a cycle have none."""
    parents = {edge.child: edge.parent for edge in edges}
    roots = {}
    for frame in {*parents, *parents.values()}:
        above, seen = frame, {frame}
        while above in parents:
            above = parents[above]
            if above in seen:
                break
            seen.add(above)
        else:
            roots[frame] = above
    return roots


def check_frames(view: View) -> Iterator[Finding]:
    """Find frames that clash, cycles, and trees without a common root."""
    edges: list[Edge] = []
    for agent in view.fleet.agents:
        tree = edges_of(agent)
        edges += tree
        if tree:
            yield from _check_tree(agent, tree)
    if any(view.crossing(n, ResourceKind.TOPIC) is Crossing.WHOLE for n in (TF, TF_STATIC)):
        yield from _clashes(edges)
        yield from _roots(view, edges)


def _check_tree(agent: AgentSpec, tree: Sequence[Edge]) -> Iterator[Finding]:
    """Find the errors within one agent's tree."""
    repeated = _by_child(tree, lambda edges: len(edges) > 1)
    for child, edges in repeated.items():
        parents = sorted({edge.parent for edge in edges})
        yield an_error(
            "frame-two-parents" if len(parents) > 1 else "frame-twice",
            edges[-1].frame.place,
            what=f"{agent.name} broadcasts {child} more than once, below {', '.join(parents)}",
            why="a frame has one parent: listeners take the one that they received last",
            remedy="keep one of the transforms",
        )
    roots = roots_of(tree)
    circle = sorted({edge.child for edge in tree} - set(roots))
    if circle:
        yield an_error(
            "frame-circle",
            tree[0].frame.place,
            what=f"frames of {agent.name} form a circle: {', '.join(circle)}",
            why="a tree has a root from which every frame is reached",
            remedy="turn one of the transforms around or remove it",
        )
    tops = sorted(set(roots.values()))
    if len(tops) > 1 and not repeated:
        yield an_error(
            "frame-own-roots",
            agent.tf.place,
            what=f"the frames of {agent.name} have {len(tops)} roots: {', '.join(tops)}",
            why="no transform leads from one part to the other (paper A, section 4.5: a single root)",
            remedy="join the parts with a transform, or correct the frame's name",
        )


def _clashes(edges: Sequence[Edge]) -> Iterator[Finding]:
    """Find frames that several agents broadcast."""
    for child, group in _by_child(edges, lambda group: len(_agents(group)) > 1).items():
        agents = _agents(group)
        parents = sorted({edge.parent for edge in group})
        below = f"below {parents[0]}"
        if len(parents) > 1:
            below = f"with two parents: {', '.join(parents)}"
        unprefixed = _agents([e for e in group if child == e.frame.child.removeprefix("/")])
        remedy = f"give the frame another name in {', '.join(unprefixed) or agents[-1]}"
        if unprefixed == agents:
            remedy = "set prefix_frames: true, and take the frame out of shared_frames"
        yield an_error(
            "frame-clash",
            group[-1].frame.place,
            what=f"{' and '.join(agents)} both broadcast frame {child}, {below}",
            why="every agent receives both: the frame jumps between them (paper A, 4.1)",
            remedy=remedy,
        )


def _by_child(
    edges: Sequence[Edge], keep: Callable[[Sequence[Edge]], bool]
) -> dict[str, list[Edge]]:
    groups: dict[str, list[Edge]] = defaultdict(list)
    for edge in edges:
        groups[edge.child].append(edge)
    return {child: group for child, group in groups.items() if keep(group)}


def _agents(edges: Iterable[Edge]) -> list[str]:
    return list(dict.fromkeys(edge.agent for edge in edges))


def _roots(view: View, edges: Sequence[Edge]) -> Iterator[Finding]:
    """Find a fleet whose trees have no common root."""
    roots = set(roots_of(edges).values())
    trees = [set(roots_of(edges_of(agent)).values()) for agent in view.fleet.agents]
    if len(roots) < 2 or roots in trees:
        return
    shared = {frame for agent in view.fleet.agents for frame in agent.tf.shared_frames}
    half_shared = shared & {root.rpartition("/")[2] for root in roots}
    hint = f"; {min(half_shared)} is shared by some agents only" if half_shared else ""
    yield a_warning(
        "frame-no-common-root",
        view.fleet.agents[0].tf.place,
        what=f"the fleet's frames have {len(roots)} roots: {', '.join(sorted(roots))}{hint}",
        why="the transform between agents is unknown (paper A, section 4.5: a single root)",
        remedy="name the common frame, such as map, in shared_frames of every agent, or join the trees",
    )
