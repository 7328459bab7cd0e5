"""Time of a look-up in the TF tree, and of a motion capture frame in the bridge, with their bounds.

Two robots below one map have six frames in a line each, with 10 s of transforms at 100 Hz, none of them
static. The bridge gets captures of ten objects. The best of several rounds counts. The exit status is 1
if a bound is exceeded.

    python benchmarks/frames.py
"""

import argparse
import sys
import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.buffer import FrameBuffer
from sfglab.spatial.mocap.bridge import BridgeCore
from sfglab.spatial.mocap.mapping import MappedObject, MocapMapping
from sfglab.spatial.mocap.synthetic import SyntheticConfig, SyntheticMotion, synthetic_captures

LOOK_UP_US = 100.0  #: Bound of a look-up over 12 edges, us.
CAPTURE_US = 300.0  #: Bound of a capture of ten objects, us.
RATE_HZ, HISTORY_S = 100, 10
DEPTH = 6  #: Frames of each robot.


def look_ups(count: int) -> Callable[[], object]:
    """Return a function that looks up the last frame of one robot in that of the other, many times."""
    rng = np.random.default_rng(0)
    buffer = FrameBuffer(history_s=HISTORY_S)
    for robot in ("a", "b"):
        names = ["map", *(f"{robot}{depth}" for depth in range(DEPTH))]
        for parent, child in pairwise(names):
            for stamp_ns in range(0, HISTORY_S * 10**9 + 1, 10**9 // RATE_HZ):
                pose = Pose.at(rng.normal(size=3), rng.normal(size=4))
                step = StampedTransform(parent=parent, child=child, stamp_ns=stamp_ns, pose=pose)
                buffer.insert(step)
    times_ns = rng.integers(0, HISTORY_S * 10**9, count).tolist()
    target, source = f"a{DEPTH - 1}", f"b{DEPTH - 1}"
    return lambda: [buffer.look_up(target, source, time_ns) for time_ns in times_ns]


def captures(count: int) -> Callable[[], object]:
    """Return a function that sends captures of ten objects through a new bridge."""
    buffer = FrameBuffer()
    objects, motions = {}, {}
    for number in range(10):
        name = f"agent_{number}"
        objects[name] = MappedObject(id=name, via=f"{name}/markers", frame=f"{name}/base")
        motions[name] = SyntheticMotion(centre_m=(5.0 * number, 0.0, 0.5))
        markers = StampedTransform(
            parent=f"{name}/base", child=f"{name}/markers", stamp_ns=0, pose=Pose.at((0, 0, 0.1))
        )
        buffer.insert(markers, static=True)
    config = SyntheticConfig(rate_hz=RATE_HZ)
    rng = np.random.default_rng(3)
    seen = list(synthetic_captures(motions, config, rng, duration_s=count / RATE_HZ))
    mapping = MocapMapping(world="map", objects=objects)

    def run() -> None:
        core = BridgeCore(mapping, buffer)
        for capture in seen:
            assert len(core.take(capture)) == len(objects)

    return run


def best_us(run: Callable[[], object], count: int, rounds: int) -> float:
    """Return the shortest time of several rounds, per call, in us of this thread's CPU time."""
    times_s = []
    for _ in range(rounds):
        start_s = time.thread_time()
        run()
        times_s.append(time.thread_time() - start_s)
    return min(times_s) / count * 1e6


def main() -> int:
    """Print both times and their bounds."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=20, help="Rounds.")
    parser.add_argument("--count", type=int, default=500, help="Calls per round.")
    options = parser.parse_args()
    parts = {
        "look-up over 12 edges": (look_ups, LOOK_UP_US),
        "capture of 10 objects": (captures, CAPTURE_US),
    }
    status = 0
    for name, (prepare, bound_us) in parts.items():
        took_us = best_us(prepare(options.count), options.count, options.rounds)
        print(f"{name}: {took_us:.0f} us, bound {bound_us:.0f} us")
        status |= took_us > bound_us
    return int(status)


if __name__ == "__main__":
    sys.exit(main())
