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
    from collections.abc import Iterable, Iterator, Sequence

    from sfglab.documents import Place
    from sfglab.fleet.fleet_file import AgentSpec
    from sfglab.fleet.lint.uses import View


@dataclass(frozen=True, slots=True)
class Edge:
    """One transform of an agent, with the frame names that other agents receive."""

    agent: str  #: Agent that broadcasts the transform.
    child: str  #: Child frame, with prefix.
    parent: str  #: Parent frame, with prefix.
    place: Place  #: Place of the transform in the fleet file.


def edges_of(agent: AgentSpec) -> list[Edge]:
    """Return an agent's transforms as other agents receive them."""
    frames = Frames(agent=agent.name, shared=frozenset(agent.tf.shared_frames))

    def outside(frame: str) -> str:
        return frames.outward(frame) if agent.tf.prefix_frames else frame.removeprefix("/")

    return [
        Edge(agent.name, outside(frame.child), outside(frame.parent), frame.place)
        for frame in agent.tf.frames
    ]


def roots_of(edges: Iterable[Edge]) -> dict[str, str]:
    """Return the root of every frame, along its last parents; frames that lead into a circle have none."""
    parents = {edge.child: edge.parent for edge in edges}
    roots = {}
    for frame in [*parents, *parents.values()]:
        root = frame
        path = set()
        while root in parents and root not in path:
            path.add(root)
            root = parents[root]
        if root not in parents:
            roots[frame] = root
    return roots


def check_frames(view: View) -> Iterator[Finding]:
    """Find frames that clash, circles, and trees without a common root."""
    agents = view.fleet.agents
    trees = [edges_of(agent) for agent in agents]
    for agent, tree in zip(agents, trees, strict=True):
        if tree:
            yield from _check_tree(agent, tree)
    if all(view.crossing(name, ResourceKind.TOPIC) is Crossing.NONE for name in (TF, TF_STATIC)):
        return
    edges = [edge for tree in trees for edge in tree]
    yield from _clashes(edges)
    roots = set(roots_of(edges).values())
    if len(roots) > 1 and roots not in [set(roots_of(tree).values()) for tree in trees]:
        yield a_warning(
            "frame-no-common-root",
            agents[0].tf.place,
            what=f"the fleet's frames have {len(roots)} roots: {', '.join(sorted(roots))}",
            why="the transform between agents is unknown (paper A, section 4.5: a single root)",
            remedy="name the common frame, such as map, in shared_frames of every agent, or join the trees",
        )


def _check_tree(agent: AgentSpec, tree: Sequence[Edge]) -> Iterator[Finding]:
    """Find the errors within one agent's tree."""
    repeated = [group for group in _by_child(tree) if len(group) > 1]
    for group in repeated:
        parents = sorted({edge.parent for edge in group})
        yield an_error(
            "frame-two-parents" if len(parents) > 1 else "frame-twice",
            group[-1].place,
            what=f"{agent.name} broadcasts {group[0].child} more than once, below {', '.join(parents)}",
            why="a frame has one parent: listeners take the one that they received last",
            remedy="keep one of the transforms",
        )
    roots = roots_of(tree)
    circle = sorted({edge.child for edge in tree} - set(roots))
    if circle:
        yield an_error(
            "frame-circle",
            tree[0].place,
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
    for group in _by_child(edges):
        agents = list(dict.fromkeys(edge.agent for edge in group))
        if len(agents) > 1:
            parents = sorted({edge.parent for edge in group})
            yield an_error(
                "frame-clash",
                group[-1].place,
                what=f"{' and '.join(agents)} both broadcast frame {group[0].child}, below {', '.join(parents)}",
                why="every agent receives both: the frame jumps between them (paper A, 4.1)",
                remedy="set prefix_frames: true, take the frame out of shared_frames, or give it another "
                "name in one of the agents",
            )


def _by_child(edges: Sequence[Edge]) -> list[list[Edge]]:
    groups: dict[str, list[Edge]] = defaultdict(list)
    for edge in edges:
        groups[edge.child].append(edge)
    return list(groups.values())
