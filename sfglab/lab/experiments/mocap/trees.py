"""Both trees of Fig. 6, and the same for robots of any shape: exact, no clock and no network."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np

from sfglab.lab.checks import CheckRow
from sfglab.lab.experiments.mocap.robot import AGENT, OBJECT, WORLD
from sfglab.lab.experiments.mocap.rows import MocapEdgeRow
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames import FrameBuffer, FrameError, FrameRule, lint_frames
from sfglab.spatial.mocap import Capture, MappedObject, MocapMapping, MocapTrees, mocap_trees

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence


RULE = FrameRule(agents=frozenset({AGENT}))
_LARGEST = 12
_PERIOD_NS = 10_000_000
_CLOSE_M, _CLOSE_RAD = 1e-9, 1e-7


def figure_6() -> tuple[tuple[StampedTransform, ...], MocapMapping]:
    """Return the robot of Fig. 6, rooted at its base, with markers and a camera, and the bridge's mapping."""
    parts = (("markers", Pose.at((0.1, 0.0, 0.2), (0, 0, 0.3, 1))), ("camera", Pose.at((0.3, 0.0, 0.0))))
    robot = tuple(_static(f"{AGENT}/base", f"{AGENT}/{name}", pose) for name, pose in parts)
    mapped = MappedObject(id=OBJECT, via=OBJECT, frame=f"{AGENT}/base")
    return robot, MocapMapping(world=WORLD, objects={OBJECT: mapped})


def edge_rows(where: str, trees: MocapTrees) -> Iterator[MocapEdgeRow]:
    """Yield the edges of all three trees."""
    for way in ("direct", "renamed", "proxy"):
        for edge in getattr(trees, way).edges:
            yield MocapEdgeRow(
                where=where,
                way=way,
                child=edge.child,
                parent=edge.parent,
                static=edge.static,
                authority=edge.authority,
                count=edge.count,
                first_ns=edge.first_ns,
                last_ns=edge.last_ns,
                backwards=edge.backwards,
                back_ns=edge.back_ns,
            )


def tree_checks(count: int, rng: np.random.Generator) -> list[CheckRow]:
    """Check what the paper says of both trees on its example and on random robots.

    Args:
        count: How many robots.
        rng: Draws them.
    """
    results: dict[str, list[tuple[str, bool]]] = defaultdict(list)
    for number in range(count + 1):
        name = "figure 6" if number == 0 else f"robot {number}"
        robot, mapping = figure_6() if number == 0 else _random_robot(rng)
        for check, holds in _checked(robot, mapping, rng):
            results[check].append((name, holds))
    return [_row(check, outcomes) for check, outcomes in results.items()]


def _row(check: str, outcomes: Sequence[tuple[str, bool]]) -> CheckRow:
    wrong = [name for name, holds in outcomes if not holds]
    return CheckRow(
        check=check,
        checked=len(outcomes),
        held=len(outcomes) - len(wrong),
        example=(wrong or [outcomes[0][0]])[0],
    )


def _checked(
    robot: Sequence[StampedTransform], mapping: MocapMapping, rng: np.random.Generator
) -> Iterator[tuple[str, bool]]:
    begin, step = _pose(rng), Pose.from_yaw((0.01, 0.0, 0.0), 0.02)
    captures = [
        _capture(number, pose) for number, pose in enumerate((begin, begin @ step, begin @ step @ step))
    ]
    trees = mocap_trees(robot, mapping, captures)
    frames = {name for edge in robot for name in (edge.parent, edge.child)}
    root = next(edge.parent for edge in robot if edge.parent not in {e.child for e in robot})
    via = mapping.objects[OBJECT].via
    found = {way: _codes(getattr(trees, way)) for way in ("direct", "renamed", "proxy")}
    yield "direct: what is published is no frame of the robot", "name" in found["direct"]
    yield "direct: the robot's tree has a root of its own", "second-root" in found["direct"]
    yield "direct: no frame of the robot is reached from the world", not _reached(trees.direct, frames)
    if via == root:
        yield "renamed, markers at the root: the tree is whole", not found["renamed"]
    else:
        yield "renamed: the markers have two parents", "two-parents" in found["renamed"]
        yield "renamed: the robot's root is not reached from the world", not _reached(trees.renamed, {root})
    yield "proxy: nothing is found wrong", not found["proxy"]
    yield "proxy: every frame of the robot is reached from the world", _reached(trees.proxy, frames) == frames
    yield "proxy: the robot's own edges are as they were", _own(trees.proxy) == _told(robot)
    truth = _places(robot, via, captures[-1])
    yield (
        "proxy: every frame stands where matrices put it",
        all(
            trees.proxy.look_up(WORLD, frame, captures[-1].capture_ns).same_as(
                Pose.from_matrix(matrix), within_m=_CLOSE_M, within_rad=_CLOSE_RAD
            )
            for frame, matrix in truth.items()
        ),
    )


def _codes(tree: FrameBuffer) -> set[str]:
    return {finding.code for finding in lint_frames(tree.edges, rule=RULE, root=WORLD)}


def _reached(tree: FrameBuffer, frames: Iterable[str]) -> set[str]:
    reached = set()
    for frame in frames:
        try:
            tree.look_up(WORLD, frame)
        except FrameError:
            continue
        reached.add(frame)
    return reached


def _own(tree: FrameBuffer) -> set[tuple[str, str, bool, int]]:
    return {(e.parent, e.child, e.static, e.count) for e in tree.edges if e.authority == "robot"}


def _told(robot: Sequence[StampedTransform]) -> set[tuple[str, str, bool, int]]:
    return {(edge.parent, edge.child, True, 1) for edge in robot}


def _places(robot: Sequence[StampedTransform], via: str, capture: Capture) -> dict[str, np.ndarray]:
    """Return where every frame is in the world, by products of matrices from the root down."""
    root = next(edge.parent for edge in robot if edge.parent not in {e.child for e in robot})
    below = {root: np.eye(4)}
    rest = list(robot)
    while rest:
        edge = rest.pop(0)
        if edge.parent in below:
            below[edge.child] = below[edge.parent] @ edge.pose.matrix()
        else:
            rest.append(edge)
    seen = capture.sights[OBJECT]
    assert isinstance(seen, Pose)
    world_from_root = seen.matrix() @ np.linalg.inv(below[via])
    return {frame: world_from_root @ matrix for frame, matrix in below.items()}


def _random_robot(rng: np.random.Generator) -> tuple[tuple[StampedTransform, ...], MocapMapping]:
    """Return a robot of any shape whose markers are at any of its frames, the root included."""
    size = int(rng.integers(1, _LARGEST))
    robot = tuple(
        _static(f"{AGENT}/link_{rng.integers(child)}", f"{AGENT}/link_{child}", _pose(rng))
        for child in range(1, size + 1)
    )
    via = f"{AGENT}/link_{rng.integers(size + 1)}"
    return robot, MocapMapping(world=WORLD, objects={OBJECT: MappedObject(id=OBJECT, via=via)})


def _pose(rng: np.random.Generator) -> Pose:
    return Pose.at(rng.normal(size=3).tolist(), rng.normal(size=4).tolist())


def _capture(number: int, pose: Pose) -> Capture:
    time_ns = (number + 1) * _PERIOD_NS
    return Capture(number=number, capture_ns=time_ns, receipt_ns=time_ns, sights={OBJECT: pose})


def _static(parent: str, child: str, pose: Pose) -> StampedTransform:
    return StampedTransform(parent=parent, child=child, stamp_ns=0, pose=pose)
