"""Checks of methods that join motion capture and a robot's TF tree: paper A, section 4.5, Eq. 4 and Fig. 6.

The checks are computed for the paper's example and for random robots. A robot's tree is joined with each of three
methods; each joined tree is linted, and its frames are looked up. A table at the end of the module has the checks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.buffer import FrameBuffer, FrameError
from sfglab.spatial.frames.lint import lint_frames
from sfglab.spatial.mocap.bridge import BridgeCore
from sfglab.spatial.mocap.mapping import MappedObject, MocapMapping, direct_transforms
from sfglab.spatial.mocap.tracking import Capture

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

AGENT, WORLD, OBJECT = "agent_x", "map", "agent_x/markers"
DIRECT = "direct"  #: The transforms of the direct receiver: Fig. 6, left.
#: The same transforms with the right name of the frame: "even if this naming conflict were resolved".
RENAMED = "renamed"
PROXY = "proxy"  #: The transforms of the bridge: Fig. 6, right.
WAYS = (DIRECT, RENAMED, PROXY)  #: Ways in which motion capture joins a robot's tree.
CAMERAS = "mocap"  #: Publisher of motion capture.
_ROBOT = "robot"
_LARGEST = 12  # links of a random robot
_PERIOD_NS = 10_000_000
_CLOSE = 1e-9


def figure_6() -> tuple[list[StampedTransform], MocapMapping]:
    """Return the robot of Fig. 6, with base, markers and a camera, and the mapping of its markers."""
    markers = _static("base", "markers", Pose.at((0.1, 0.0, 0.2), (0, 0, 0.3, 1)))
    camera = _static("base", "camera", Pose.at((0.3, 0.0, 0.0)))
    mapped = MappedObject(id=OBJECT, via=OBJECT, frame=f"{AGENT}/base")
    return [markers, camera], MocapMapping(world=WORLD, objects={OBJECT: mapped})


def captures_of(poses: Iterable[Pose]) -> list[Capture]:
    """Return captures of the markers at poses in the world, 10 ms apart."""
    captures = []
    for number, pose in enumerate(poses):
        at_ns = (number + 1) * _PERIOD_NS
        captures.append(
            Capture(number=number, capture_ns=at_ns, receipt_ns=at_ns, sights={OBJECT: pose})
        )
    return captures


def join_trees(
    robot: Sequence[StampedTransform], mapping: MocapMapping, captures: Sequence[Capture]
) -> dict[str, FrameBuffer]:
    """Return the tree of a robot's own, static frames, joined with captures by each of the methods `WAYS`."""
    trees = {way: FrameBuffer() for way in WAYS}
    for tree in trees.values():
        for transform in robot:
            tree.insert(transform, static=True, authority=_ROBOT)
    core = BridgeCore(mapping, trees[PROXY])
    for capture in captures:
        for transform in direct_transforms(capture, world=mapping.world):
            renamed = replace(transform, child=mapping.objects[OBJECT].via)
            trees[DIRECT].insert(transform, authority=CAMERAS)
            trees[RENAMED].insert(renamed, authority=CAMERAS)
        for transform in core.take(capture):
            trees[PROXY].insert(transform, authority=CAMERAS)
    return trees


@dataclass(frozen=True, slots=True)
class Joined:
    """A robot with its TF trees after motion capture was joined with each method."""

    name: str  #: Name in examples of checks.
    robot: Sequence[StampedTransform]  #: The robot's own transforms, from the root down.
    via: str  #: Frame of the markers.
    seen: Pose  #: Latest pose of the markers in the world.
    last_ns: int  #: Time of that pose, ns.
    trees: Mapping[str, FrameBuffer]  #: Trees by method.

    @property
    def root(self) -> str:
        """Root of the robot's own tree."""
        return self.robot[0].parent

    @property
    def frames(self) -> set[str]:
        """Names of the robot's own frames."""
        return {self.root, *(step.child for step in self.robot)}

    def found(self, way: str) -> set[str]:
        """Return the codes of all errors of a tree."""
        findings = lint_frames(self.trees[way].edges, agents=[AGENT], root=WORLD)
        return {finding.code for finding in findings}

    def reached(self, way: str) -> set[str]:
        """Return the robot's frames that can be looked up from the world."""
        reached = set()
        for frame in self.frames:
            try:
                self.trees[way].look_up(WORLD, frame)
            except FrameError:
                continue
            reached.add(frame)
        return reached


def joined(count: int, seed: int) -> Iterator[Joined]:
    """Yield the paper's example and a number of random robots."""
    rng = np.random.default_rng([seed, 0])
    for number in range(count + 1):
        robot, mapping = _random_robot(rng) if number else figure_6()
        begin, step = _random_pose(rng), Pose.from_yaw((0.01, 0.0, 0.0), 0.02)
        seen = begin @ step @ step
        captures = captures_of((begin, begin @ step, seen))
        yield Joined(
            name=f"robot {number}" if number else "figure 6",
            robot=robot,
            via=mapping.objects[OBJECT].via,
            seen=seen,
            last_ns=captures[-1].capture_ns,
            trees=join_trees(robot, mapping, captures),
        )


def _random_robot(rng: np.random.Generator) -> tuple[list[StampedTransform], MocapMapping]:
    """Return a robot of any shape whose markers are at any of its frames."""
    links = [f"link_{number}" for number in range(int(rng.integers(1, _LARGEST)) + 1)]
    robot = []
    for number in range(1, len(links)):
        parent = links[rng.integers(number)]
        robot.append(_static(parent, links[number], _random_pose(rng)))
    via = f"{AGENT}/{links[rng.integers(len(links))]}"
    return robot, MocapMapping(world=WORLD, objects={OBJECT: MappedObject(id=OBJECT, via=via)})


def _random_pose(rng: np.random.Generator) -> Pose:
    return Pose.at(rng.normal(size=3).tolist(), rng.normal(size=4).tolist())


def _static(parent: str, child: str, pose: Pose) -> StampedTransform:
    return StampedTransform(
        parent=f"{AGENT}/{parent}", child=f"{AGENT}/{child}", stamp_ns=0, pose=pose
    )


def _proxy_own(one: Joined) -> bool:
    own = {(step.parent, step.child, True, 1) for step in one.robot}
    edges = [edge for edge in one.trees[PROXY].edges if edge.authority == _ROBOT]
    return own == {(edge.parent, edge.child, edge.static, edge.count) for edge in edges}


def _proxy_places(one: Joined) -> bool:
    """Compare the pose of each frame in the world with a product of matrices from the root down."""
    below = {one.root: np.eye(4)}
    for step in one.robot:
        below[step.child] = below[step.parent] @ step.pose.matrix()
    world_from_root = one.seen.matrix() @ np.linalg.inv(below[one.via])
    off = []
    for frame, matrix in below.items():
        found = one.trees[PROXY].look_up(WORLD, frame, one.last_ns).matrix()
        off.append(np.abs(found - world_from_root @ matrix).max())
    return bool(max(off) < _CLOSE)


TWO_PARENTS = "renamed: the markers have two parents"
NOT_REACHED = "renamed: the robot's root is not reached from the world"
AT_THE_ROOT = "renamed, markers at the root: the tree is whole"

CHECKS: dict[str, Callable[[Joined], bool]] = {
    "direct: what is published is no frame of the robot": lambda one: "name" in one.found(DIRECT),
    "direct: the robot's tree has a root of its own": lambda one: (
        "second-root" in one.found(DIRECT)
    ),
    "direct: no frame of the robot is reached from the world": lambda one: not one.reached(DIRECT),
    TWO_PARENTS: lambda one: "two-parents" in one.found(RENAMED),
    NOT_REACHED: lambda one: one.root not in one.reached(RENAMED),
    "proxy: nothing is found wrong": lambda one: not one.found(PROXY),
    "proxy: every frame of the robot is reached from the world": lambda one: (
        one.reached(PROXY) == one.frames
    ),
    "proxy: the robot's own edges are as they were": _proxy_own,
    "proxy: every frame stands where matrices put it": _proxy_places,
    AT_THE_ROOT: lambda one: not one.found(RENAMED),
}
"""Functions by check; each returns whether the check holds for a robot."""


def checked(one: Joined) -> dict[str, bool]:
    """Return whether each check holds for a robot, by the check's name.

    For a robot with markers at the root of its tree, the direct receiver with the right name is sufficient.
    """
    left_out = (TWO_PARENTS, NOT_REACHED) if one.via == one.root else (AT_THE_ROOT,)
    return {name: holds(one) for name, holds in CHECKS.items() if name not in left_out}
