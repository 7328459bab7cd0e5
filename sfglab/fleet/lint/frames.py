"""Checks of transform frames: all agents' trees put together, as every agent sees them behind its router.

Table 1 of paper A forwards /tf and /tf_static; 4.1 asks for prefixes against clashes, 4.5 for a single root.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.fleet.lint.report import Finding, Severity, a_remark, a_warning, an_error
from sfglab.fleet.policy import Crossing
from sfglab.fleet.router.frames import FrameClashError, Frames
from sfglab.names import TF, TF_STATIC, ResourceKind

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from sfglab.fleet.fleet_file import AgentSpec, FrameSpec
    from sfglab.fleet.lint.uses import View


@dataclass(frozen=True, slots=True, kw_only=True)
class Edge:
    """One transform as others hear it."""

    agent: str  #: Who broadcasts it.
    child: str  #: The frame that is placed, with prefix.
    parent: str  #: The frame in which it is placed, with prefix.
    frame: FrameSpec  #: As the agent's nodes write it.


def edges_of(agent: AgentSpec, *, prefix: bool | None = None) -> tuple[Edge, ...]:
    """Return an agent's transforms as others hear them, prefixed or not; None: as the agent does."""
    prefix = agent.tf.prefix_frames if prefix is None else prefix
    frames = Frames(agent=agent.name, shared=frozenset(agent.tf.shared_frames))

    def heard(frame: str) -> str:
        return frames.outward(frame) if prefix else frame.removeprefix("/")

    return tuple(
        Edge(agent=agent.name, child=heard(f.child), parent=heard(f.parent), frame=f)
        for f in agent.tf.frames
    )


def roots_of(edges: Iterable[Edge]) -> dict[str, str]:
    """Return the root above every frame, by its last parent; frames in a circle have none."""
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
    """Find frames that clash, circles, trees without common root and frames under another agent's prefix."""
    crossing = any(
        view.crossing(name, ResourceKind.TOPIC) is Crossing.WHOLE for name in (TF, TF_STATIC)
    )
    trees = [edges_of(agent) for agent in view.fleet.agents]
    for agent, tree in zip(view.fleet.agents, trees, strict=True):
        yield from _check_own(agent, tree)
    if not crossing:
        return
    edges = [edge for tree in trees for edge in tree]
    yield from _clashes(edges)
    yield from _foreign(view, edges)
    yield from _common_root(view, edges)
    yield from _kept_apart(view)


def _check_own(agent: AgentSpec, tree: Sequence[Edge]) -> Iterator[Finding]:
    twice = [child for child, count in Counter(e.child for e in tree).items() if count > 1]
    for child in twice:
        broadcast = [e for e in tree if e.child == child]
        parents = sorted({e.parent for e in broadcast})
        what = f"{agent.name} broadcasts {child} more than once, below {', '.join(parents)}"
        why = "a frame has one parent: listeners take whichever came last"
        code, place = (
            "frame-two-parents" if len(parents) > 1 else "frame-twice",
            broadcast[-1].frame.place,
        )
        yield an_error(
            code=code, place=place, what=what, why=why, remedy="keep one of the transforms"
        )
    circle = sorted({e.child for e in tree} - set(roots_of(tree)))
    if circle:
        what = f"frames of {agent.name} hang in a circle: {', '.join(circle)}"
        why = "a tree has a root from which every frame is reached"
        remedy = "turn one of the transforms around or remove it"
        yield an_error(
            code="frame-circle", place=tree[0].frame.place, what=what, why=why, remedy=remedy
        )
    roots = sorted(set(roots_of(tree).values()))
    if len(roots) > 1 and not twice:
        what = f"the frames of {agent.name} have {len(roots)} roots: {', '.join(roots)}"
        why = "no transform leads from one part to the other (paper A, section 4.5: a single root)"
        remedy = "join the parts with a transform, or correct the frame's name"
        yield an_error(
            code="frame-own-roots", place=agent.tf.place, what=what, why=why, remedy=remedy
        )


def _clashes(edges: Sequence[Edge]) -> Iterator[Finding]:
    by_child: dict[str, list[Edge]] = defaultdict(list)
    for edge in edges:
        by_child[edge.child].append(edge)
    for child, group in by_child.items():
        agents = list(dict.fromkeys(e.agent for e in group))
        if len(agents) < 2:
            continue
        parents = sorted({e.parent for e in group})
        below = (
            f"below {parents[0]}"
            if len(parents) == 1
            else f"with two parents: {', '.join(parents)}"
        )
        what = f"{' and '.join(agents)} both broadcast frame {child}, {below}"
        why = (
            "every agent hears both through its router: the frame jumps between them (paper A, 4.1)"
        )
        remedy = _apart(group, agents)
        yield an_error(
            code="frame-clash", place=group[-1].frame.place, what=what, why=why, remedy=remedy
        )


def _apart(group: Sequence[Edge], agents: Sequence[str]) -> str:
    bare = sorted({e.agent for e in group if e.child == e.frame.child.removeprefix("/")})
    if len(bare) == len(agents):
        return "set prefix_frames: true, and take the frame out of shared_frames"
    return f"give the frame another name in {', '.join(bare) or agents[-1]}"


def _foreign(view: View, edges: Sequence[Edge]) -> Iterator[Finding]:
    agents = {agent.name: agent for agent in view.fleet.agents}
    for edge in edges:
        sender = agents[edge.agent]
        owner = agents.get(edge.child.partition("/")[0]) if "/" in edge.child else None
        if sender.tf.prefix_frames:
            yield from _kept_in(sender, edge)
        elif owner is not None and owner is not sender:
            yield from _placing(owner, edge, edges)


def _kept_in(sender: AgentSpec, edge: Edge) -> Iterator[Finding]:
    """Find a transform that the sender's own router does not let out."""
    try:
        Frames(agent=sender.name, shared=frozenset(sender.tf.shared_frames)).check_outward(
            edge.frame.child
        )
    except FrameClashError as error:
        what = f"{sender.name} broadcasts {edge.child}, which is not its own, and prefixes frames"
        why = f"its router keeps it in: {error}"
        remedy = "rename the frame; motion capture, which places others, has prefix_frames: false"
        yield an_error(
            code="frame-kept-in", place=edge.frame.place, what=what, why=why, remedy=remedy
        )


def _placing(owner: AgentSpec, edge: Edge, edges: Sequence[Edge]) -> Iterator[Finding]:
    """Find a transform into another agent's tree that does not fit it, or that its router does not let in."""
    own = [e for e in edges if e.agent == owner.name]
    if edge.child in {e.child for e in own}:
        return  # a clash, which is reported as such
    bare = edge.child.removeprefix(f"{owner.name}/")
    code, what = (
        "frame-of-another",
        f"{edge.agent} broadcasts {edge.child}, under the prefix of {owner.name}",
    )
    if edge.child not in {e.parent for e in own}:
        severity, remedy = Severity.WARNING, f"place the root of {owner.name}'s own tree"
        why = f"{owner.name} has no transform below that frame: its name may be spelled differently there"
    elif not owner.tf.prefix_frames or bare in owner.tf.placed_by_others:
        severity, remedy = Severity.INFO, ""
        why = f"it gives the root of {owner.name}'s tree a parent (paper A, section 4.5)"
    else:
        code, severity = "frame-kept-out", Severity.ERROR
        why = f"the router of {owner.name} lets nobody else move its frames, so inside there is no parent"
        remedy = f"{owner.name}: tf: placed_by_others: [{bare}]"
    yield Finding(
        severity=severity, code=code, place=edge.frame.place, what=what, why=why, remedy=remedy
    )


def _common_root(view: View, edges: Sequence[Edge]) -> Iterator[Finding]:
    roots = sorted(set(roots_of(edges).values()))
    if len(roots) < 2 or any(
        set(roots_of(edges_of(a)).values()) == set(roots) for a in view.fleet.agents
    ):
        return
    shared = {frame for agent in view.fleet.agents for frame in agent.tf.shared_frames}
    bare = {root.rpartition("/")[2] for root in roots}
    hint = f"; {min(bare & shared)} is shared by some agents only" if bare & shared else ""
    what = f"the fleet's frames have {len(roots)} roots: {', '.join(roots)}{hint}"
    why = "where one agent stands relative to another is unknown (paper A, section 4.5: a single root)"
    remedy = (
        "name the common frame, such as map, in shared_frames of every agent, or join the trees"
    )
    place = view.fleet.agents[0].tf.place
    yield a_warning(code="frame-no-common-root", place=place, what=what, why=why, remedy=remedy)


def _kept_apart(view: View) -> Iterator[Finding]:
    bare: dict[str, set[str]] = defaultdict(set)
    for agent in view.fleet.agents:
        if agent.tf.prefix_frames:
            for edge in edges_of(agent, prefix=False):
                if edge.frame.child not in agent.tf.shared_frames:
                    bare[edge.child].add(agent.name)
    apart = sorted(child for child, agents in bare.items() if len(agents) > 1)
    if apart:
        what = f"prefixes keep {len(apart)} frame names of several agents apart: {', '.join(apart)}"
        why = "without prefix_frames they would clash in every agent"
        yield a_remark(code="frames-kept-apart", place=view.fleet.place, what=what, why=why)
