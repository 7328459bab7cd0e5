"""Checks of how motion capture joins a robot's tree of frames, exact; paper A, section 4.5, Eq. 4, Fig. 6."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np

from sfglab.documents import DocumentError
from sfglab.lab.checks import NOTHING, Case, CheckRow, Checks, Sample
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.buffer import FrameBuffer, FrameError
from sfglab.spatial.frames.lint import FrameRule, lint_frames
from sfglab.spatial.mocap.bridge import BridgeCore, MocapTrees, mocap_trees, status_message
from sfglab.spatial.mocap.mapping import MappedObject, MocapMapping, read_mapping
from sfglab.spatial.mocap.tracking import Capture

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    Robot = tuple[StampedTransform, ...]

checks = Checks("trees")

AGENT, WORLD, OBJECT = "agent_x", "map", "agent_x/markers"
RULE = FrameRule(agents=frozenset({AGENT}))  #: The names that are demanded of frames.
#: How motion capture joins a robot's tree: attributes of `MocapTrees`.
WAYS = ("direct", "renamed", "proxy")
_LARGEST = 12
_PERIOD_NS = 10_000_000
_CLOSE_M, _CLOSE_RAD = 1e-9, 1e-7


def figure_6() -> tuple[Robot, MocapMapping]:
    """Return the robot of Fig. 6, rooted at its base, with markers and a camera, and the bridge's mapping."""
    parts = (
        ("markers", Pose.at((0.1, 0.0, 0.2), (0, 0, 0.3, 1))),
        ("camera", Pose.at((0.3, 0.0, 0.0))),
    )
    robot = tuple(_static(f"{AGENT}/base", f"{AGENT}/{name}", pose) for name, pose in parts)
    mapped = MappedObject(id=OBJECT, via=OBJECT, frame=f"{AGENT}/base")
    return robot, MocapMapping(world=WORLD, objects={OBJECT: mapped})


def captures_of(poses: Iterable[Pose]) -> list[Capture]:
    """Return captures of the markers at these poses in the world, 10 ms apart."""
    times = ((number, (number + 1) * _PERIOD_NS, pose) for number, pose in enumerate(poses))
    return [
        Capture(number=i, capture_ns=t, receipt_ns=t, sights={OBJECT: pose}) for i, t, pose in times
    ]


@dataclass(frozen=True, slots=True)
class _Joined:
    """A robot whose tree motion capture has joined in all ways."""

    name: str
    robot: Robot
    via: str  #: The frame that the markers are.
    seen: Pose  #: Where the cameras saw it last.
    last_ns: int  #: When that was.
    trees: MocapTrees

    @property
    def root(self) -> str:
        return next(
            edge.parent for edge in self.robot if edge.parent not in {e.child for e in self.robot}
        )

    @property
    def frames(self) -> set[str]:
        return {name for edge in self.robot for name in (edge.parent, edge.child)}

    def found(self, way: str) -> set[str]:
        """Return codes of everything that is wrong with a tree."""
        return {
            finding.code
            for finding in lint_frames(getattr(self.trees, way).edges, rule=RULE, root=WORLD)
        }


@lru_cache(maxsize=1)
def _joined(count: int, seed: int) -> tuple[_Joined, ...]:
    """Return the paper's example and so many random robots; all checks share them."""
    rng = np.random.default_rng([seed, 0])
    joined = []
    for number in range(count + 1):
        robot, mapping = figure_6() if number == 0 else _random_robot(rng)
        begin, step = _pose(rng), Pose.from_yaw((0.01, 0.0, 0.0), 0.02)
        captures = captures_of((begin, begin @ step, begin @ step @ step))
        name = f"robot {number}" if number else "figure 6"
        via, trees = mapping.objects[OBJECT].via, mocap_trees(robot, mapping, captures)
        joined.append(
            _Joined(name, robot, via, begin @ step @ step, captures[-1].capture_ns, trees)
        )
    return tuple(joined)


def _random_robot(rng: np.random.Generator) -> tuple[Robot, MocapMapping]:
    """Return a robot of any shape whose markers are at any of its frames, the root included."""
    links = [f"{AGENT}/link_{number}" for number in range(int(rng.integers(1, _LARGEST)) + 1)]
    robot = tuple(
        _static(links[rng.integers(i)], links[i], _pose(rng)) for i in range(1, len(links))
    )
    via = links[rng.integers(len(links))]
    return robot, MocapMapping(world=WORLD, objects={OBJECT: MappedObject(id=OBJECT, via=via)})


def _pose(rng: np.random.Generator) -> Pose:
    return Pose.at(rng.normal(size=3).tolist(), rng.normal(size=4).tolist())


def _static(parent: str, child: str, pose: Pose) -> StampedTransform:
    return StampedTransform(parent=parent, child=child, stamp_ns=0, pose=pose)


def _reached(tree: FrameBuffer, frames: Iterable[str]) -> set[str]:
    """Return those frames that can be looked up from the world."""
    reached = set()
    for frame in frames:
        try:
            tree.look_up(WORLD, frame)
        except FrameError:
            continue
        reached.add(frame)
    return reached


def _robot_s_own(joined: _Joined) -> bool:
    own = {
        (e.parent, e.child, e.static, e.count)
        for e in joined.trees.proxy.edges
        if e.authority == "robot"
    }
    return own == {(edge.parent, edge.child, True, 1) for edge in joined.robot}


def _in_place(joined: _Joined) -> bool:
    return all(
        joined.trees.proxy.look_up(WORLD, frame, joined.last_ns).same_as(
            Pose.from_matrix(matrix), within_m=_CLOSE_M, within_rad=_CLOSE_RAD
        )
        for frame, matrix in _places(joined).items()
    )


def _places(joined: _Joined) -> dict[str, np.ndarray]:
    """Return where every frame is in the world, by products of matrices from the root down."""
    below = {joined.root: np.eye(4)}
    rest = list(joined.robot)
    while rest:
        edge = rest.pop(0)
        if edge.parent in below:
            below[edge.child] = below[edge.parent] @ edge.pose.matrix()
        else:
            rest.append(edge)
    world_from_root = joined.seen.matrix() @ np.linalg.inv(below[joined.via])
    return {frame: world_from_root @ matrix for frame, matrix in below.items()}


_AT_THE_ROOT = "renamed, markers at the root: the tree is whole"
_PROPERTIES: dict[str, Callable[[_Joined], bool]] = {
    "direct: what is published is no frame of the robot": lambda j: "name" in j.found("direct"),
    "direct: the robot's tree has a root of its own": lambda j: "second-root" in j.found("direct"),
    "direct: no frame of the robot is reached from the world": lambda j: (
        not _reached(j.trees.direct, j.frames)
    ),
    "renamed: the markers have two parents": lambda j: "two-parents" in j.found("renamed"),
    "renamed: the robot's root is not reached from the world": lambda j: (
        not _reached(j.trees.renamed, {j.root})
    ),
    "proxy: nothing is found wrong": lambda j: not j.found("proxy"),
    "proxy: every frame of the robot is reached from the world": lambda j: (
        _reached(j.trees.proxy, j.frames) == j.frames
    ),
    "proxy: the robot's own edges are as they were": _robot_s_own,
    "proxy: every frame stands where matrices put it": _in_place,
    _AT_THE_ROOT: lambda j: not j.found("renamed"),
}


def _cases(name: str, sample: Sample) -> Iterator[Case]:
    """Yield a case a robot; under the right name it matters whether the markers are at the robot's root."""
    for joined in _joined(sample.count, sample.seed):
        if not name.startswith("renamed") or (joined.via == joined.root) == (name == _AT_THE_ROOT):
            yield joined.name, _PROPERTIES[name](joined)


for _name in _PROPERTIES:
    checks.cases(_name)(partial(_cases, _name))

_TEXT = (
    f"world: {WORLD}\nobjects: {{{OBJECT}: {{via: {OBJECT}, offset: {{position_m: [1, 0, 0]}}}}}}"
)
_BROKEN = (
    *((f"via: {OBJECT}", f"via: {name}") for name in ("/markers", "' markers'", "''", "3", WORLD)),
    ("[1, 0, 0]", "[1, 0]"),
    ("[1, 0, 0]", "[1, 0, 0], quat_xyzw: [0, 0, 0, 0]"),
)


@checks.cases("a mapping's text is read as what it says, or refused in words that name the place")
def _texts(_: Sample) -> Iterator[Case]:
    mapped = MappedObject(id=OBJECT, via=OBJECT, offset=Pose.at((1.0, 0.0, 0.0)))
    yield "a whole text", read_mapping(_TEXT) == MocapMapping(world=WORLD, objects={OBJECT: mapped})
    for old, new in _BROKEN:
        try:
            read_mapping(_TEXT.replace(old, new))
        except DocumentError as error:
            yield new, f"objects.{OBJECT}" in str(error)
        else:
            yield new, False


@checks.cases(
    "proxy: what comes again or flips is not published before it is held, and all is counted"
)
def _counted(_: Sample) -> Iterator[Case]:
    robot, mapping = figure_6()
    buffer = FrameBuffer()
    for transform in robot:
        buffer.insert(transform, static=True)
    core = BridgeCore(mapping, buffer)
    first, *flipped = captures_of([Pose(), *[Pose.from_yaw((0.0, 0.0, 0.0), np.pi)] * 60])
    published = [len(core.take(capture, 0)) for capture in (first, first, *flipped)]
    yield "published", published == [1, 0, *[0] * 50, *[1] * 10]
    core.take(replace(first, number=63, sights={"stranger": Pose()}), 0)
    said, (status,) = status_message(core, 0), core.statuses
    yield "counted", (said.captures, said.dropped, said.unmapped, status.absent) == (63, 2, 1, 1)
    yield "said", (said.world, said.objects[0].id, said.objects[0].published) == (WORLD, OBJECT, 11)


def tree_rows(count: int, seed: int) -> Iterator[CheckRow]:
    """Return the properties' rows, without the one of markers at the root where no robot has them there."""
    return (
        row
        for row in checks.rows(count, seed)
        if (row.check, row.example) != (_AT_THE_ROOT, NOTHING)
    )
