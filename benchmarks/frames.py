"""What a look-up in the tree of frames costs, against the same walk through SciPy and through plain Python.

Trees of 100 frames, every edge with 10 s of transforms at 100 Hz, none static:

- fleet: 9 agents below one map, each with odometry, base and nine frames on it, asked for across agents;
- random: every frame below one of the eight before it, asked for between any two;
- chain: all in one line, asked for from end to end, which is 99 edges.

Baselines walk the same tree with the same transforms: "SciPy" makes one `Slerp` and one product of rotations
per edge, which is what a reader of its manual would write, "plain Python" bisects lists and uses `Pose`. What
they return is checked to be the same. Rounds alternate; of each the best is shown, ratios are of the best.

Then the insertion of a transform, and what the motion capture bridge adds to a capture of 10 objects.

    python benchmarks/frames.py
"""

from __future__ import annotations

import argparse
import time
from bisect import bisect_right
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.buffer import FrameBuffer
from sfglab.spatial.mocap.bridge import BridgeCore
from sfglab.spatial.mocap.mapping import MappedObject, MocapMapping
from sfglab.spatial.mocap.synthetic import SyntheticConfig, SyntheticMotion, synthetic_captures

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

FRAMES, RATE_HZ, HISTORY_S = 100, 100, 10
ASKED_US = 20.0
STEP_NS = 10**9 // RATE_HZ


class Question(NamedTuple):
    """One look-up."""

    target: str
    source: str
    time_ns: int


class Plain:
    """The tree as lists, for both baselines."""

    def __init__(self, parents: Sequence[int], rng: np.random.Generator) -> None:
        self.parents = parents
        rows = HISTORY_S * RATE_HZ + 1
        self.stamps = [i * STEP_NS for i in range(rows)]
        self.poses = [[_random_pose(rng) for _ in range(rows)] for _ in parents]
        self.quats = [np.array([p.quat_xyzw for p in edge]) for edge in self.poses]
        self.shifts = [np.array([p.position_m for p in edge]) for edge in self.poses]

    def ways(self, target: int, source: int) -> tuple[list[int], list[int]]:
        """Return the frames from both up to, but without, the one where they meet."""
        up, down = self._above(target), self._above(source)
        while up and down and up[-1] == down[-1]:
            up.pop()
            down.pop()
        return up, down

    def _above(self, frame: int) -> list[int]:
        way = [frame]
        while self.parents[way[-1]] >= 0:
            way.append(self.parents[way[-1]])
        return way

    def buffer(self) -> FrameBuffer:
        """Return the same as a buffer of frames."""
        buffer = FrameBuffer(history_s=HISTORY_S)
        for child, parent in enumerate(self.parents):
            for stamp_ns, pose in zip(
                self.stamps, self.poses[child] if parent >= 0 else (), strict=False
            ):
                buffer.insert(
                    StampedTransform(
                        parent=f"f{parent}", child=f"f{child}", stamp_ns=stamp_ns, pose=pose
                    )
                )
        return buffer


def _random_pose(rng: np.random.Generator) -> Pose:
    return Pose.at(rng.normal(size=3).tolist(), rng.normal(size=4).tolist())


def plain_look_up(tree: Plain, question: Question) -> Pose:
    """Look up with lists and `Pose`."""
    up, down = tree.ways(int(question.target[1:]), int(question.source[1:]))
    row = min(bisect_right(tree.stamps, question.time_ns) - 1, len(tree.stamps) - 2)
    fraction = (question.time_ns - tree.stamps[row]) / STEP_NS
    ends = []
    for way in (up, down):
        pose = Pose()
        for frame in way:
            edge = tree.poses[frame]
            pose = edge[row].interpolate(edge[row + 1], fraction) @ pose
        ends.append(pose)
    return ends[0].inverse() @ ends[1]


def scipy_look_up(tree: Plain, question: Question) -> Pose:
    """Look up with a `Slerp` and a product of rotations per edge."""
    up, down = tree.ways(int(question.target[1:]), int(question.source[1:]))
    row = min(bisect_right(tree.stamps, question.time_ns) - 1, len(tree.stamps) - 2)
    fraction = (question.time_ns - tree.stamps[row]) / STEP_NS
    ends = []
    for way in (up, down):
        turn, shift = Rotation.identity(), np.zeros(3)
        for frame in way:
            two = slice(row, row + 2)
            edge_turn = Slerp([0.0, 1.0], Rotation.from_quat(tree.quats[frame][two]))(fraction)
            a, b = tree.shifts[frame][two]
            shift = edge_turn.apply(shift) + a + fraction * (b - a)
            turn = edge_turn * turn
        ends.append((turn, shift))
    (back, base), (turn, shift) = ends
    return Pose.from_rotation(back.inv().apply(shift - base), back.inv() * turn)


def fleet() -> list[int]:
    """Return the parents of map, and of odometry, base and nine frames for each of nine agents."""
    parents = [-1]
    for _ in range(9):
        odometry = len(parents)
        parents += [0, odometry, *[odometry + 1] * 9]
    return parents


def cases(rng: np.random.Generator, count: int) -> dict[str, tuple[list[int], list[Question]]]:
    """Return trees and what they are asked."""
    times = rng.integers(0, HISTORY_S * 10**9, count).tolist()
    any_two = rng.integers(0, FRAMES, (count, 2)).tolist()
    leaves = [
        [3 + 11 * a + i, 3 + 11 * b + j] for a, b, i, j in rng.integers(0, 9, (count, 4)).tolist()
    ]
    pairs = {"fleet": leaves, "random": any_two, "chain": [[0, FRAMES - 1]] * count}
    trees = {
        "fleet": fleet(),
        "random": [-1, *(int(rng.integers(max(0, i - 8), i)) for i in range(1, FRAMES))],
        "chain": list(range(-1, FRAMES - 1)),
    }
    return {
        name: (
            trees[name],
            [Question(f"f{a}", f"f{b}", t) for (a, b), t in zip(two, times, strict=True)],
        )
        for name, two in pairs.items()
    }


def best_us(run: Callable[[], object], count: int, rounds: int) -> float:
    """Return the shortest of several times per call, in microseconds."""
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times) / count * 1e6


def compare(name: str, parents: list[int], questions: list[Question], rounds: int) -> None:
    """Print one tree's row."""
    tree = Plain(parents, np.random.default_rng(1))
    buffer = tree.buffer()
    few = questions[: max(10, len(questions) // 50)]
    for question in few:
        ours = buffer.look_up(*question)
        for theirs in (plain_look_up(tree, question), scipy_look_up(tree, question)):
            assert ours.same_as(theirs, within_m=1e-6, within_rad=1e-6), (name, question)
    edges = np.mean(
        [sum(map(len, tree.ways(int(q.target[1:]), int(q.source[1:])))) for q in questions]
    )
    ours_us = best_us(lambda: [buffer.look_up(*q) for q in questions], len(questions), rounds)
    plain_us = best_us(lambda: [plain_look_up(tree, q) for q in few], len(few), rounds)
    scipy_us = best_us(lambda: [scipy_look_up(tree, q) for q in few], len(few), rounds)
    verdict = (
        ""
        if name == "chain"
        else f"  asked < {ASKED_US:g}: {'yes' if ours_us < ASKED_US else 'NO'}"
    )
    print(
        f"{name:8} {edges:5.1f} edges  ours {ours_us:6.2f} us  plain Python {plain_us:7.1f} us ="
        f" {plain_us / ours_us:5.1f} x  SciPy {scipy_us:8.1f} us = {scipy_us / ours_us:5.0f} x{verdict}"
    )


def insertion(rounds: int) -> float:
    """Return what one transform costs, in microseconds."""
    count = 20_000
    transforms = [
        StampedTransform(
            parent="map", child=f"f{i % FRAMES}", stamp_ns=i * STEP_NS // FRAMES, pose=Pose()
        )
        for i in range(count)
    ]

    def run() -> None:
        buffer = FrameBuffer(history_s=1.0)
        for transform in transforms:
            buffer.insert(transform)

    return best_us(run, count, rounds)


def bridge(rounds: int) -> float:
    """Return what the bridge's decisions cost for a capture of 10 objects, in microseconds."""
    names = [f"agent_{i}" for i in range(10)]
    objects = {n: MappedObject(id=n, via=f"{n}/markers", frame=f"{n}/base") for n in names}
    motions = {n: SyntheticMotion(centre_m=(5.0 * i, 0.0, 0.5)) for i, n in enumerate(names)}
    made = synthetic_captures(motions, SyntheticConfig(), np.random.default_rng(3), duration_s=5.0)
    captures = [m.capture for m in made]

    def run() -> None:
        buffer = FrameBuffer()
        for name in names:
            buffer.insert(
                StampedTransform(
                    parent=f"{name}/base",
                    child=f"{name}/markers",
                    stamp_ns=0,
                    pose=Pose.at((0, 0, 0.1)),
                ),
                static=True,
            )
        core = BridgeCore(MocapMapping(world="map", objects=objects), buffer)
        for capture in captures:
            assert len(core.take(capture, capture.receipt_ns)) == len(names)

    return best_us(run, len(captures), rounds)


def main() -> None:
    """Print all rows."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--questions", type=int, default=5000)
    options = parser.parse_args()
    for name, (parents, questions) in cases(np.random.default_rng(0), options.questions).items():
        compare(name, parents, questions, options.rounds)
    print(f"insertion {insertion(options.rounds):.1f} us a transform")
    print(f"bridge {bridge(options.rounds):.0f} us a capture of 10 objects")


if __name__ == "__main__":
    main()
