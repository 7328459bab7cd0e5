"""What the bridge makes of sights that are wrong, against what was really there: exact, in no time.

A flipped sight is told from a true one only by how it came about, so the bridge cannot know one that begins
while the object is hidden, nor one that lasts; both are counted apart.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from sfglab.lab.checks import CheckRow
from sfglab.lab.experiments.mocap.config import FAULTY
from sfglab.lab.experiments.mocap.robot import MOTION, OBJECT
from sfglab.lab.experiments.mocap.rows import ConfusionRow
from sfglab.lab.experiments.mocap.trees import figure_6
from sfglab.spatial import Pose
from sfglab.spatial.frames import FrameBuffer
from sfglab.spatial.mocap import BridgeCore, Lapse, Verdict, synthetic_captures

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.lab.experiments.mocap.config import Config
    from sfglab.spatial.mocap import TrueCapture


_BELIEVED = frozenset(v.value for v in Verdict if v.believed)
_TURNED_RAD = 2.5
"""Below half a turn less noise: what the object must not be able to have turned since it was last believed."""


@dataclass(slots=True)
class _Tally:
    """What came of one recording after the other."""

    confusion: Counter[tuple[str, str]] = field(default_factory=Counter)
    missing: int = 0
    dropped: int = 0
    plain: int = 0
    plain_believed: int = 0


def fault_rows(config: Config) -> tuple[list[ConfusionRow], list[CheckRow]]:
    """Send recordings with known faults through the bridge and compare.

    Args:
        config: How many recordings and how long.

    Returns:
        The confusion table, and what must hold of it.
    """
    tally = _Tally()
    for number in range(config.fault_recordings):
        rng = np.random.default_rng([config.seed, 1, number])
        _pass(synthetic_captures({OBJECT: MOTION}, FAULTY, rng, duration_s=config.fault_s), tally)
    rows = [
        ConfusionRow(truth=truth, verdict=verdict, count=count)
        for (truth, verdict), count in sorted(tally.confusion.items())
    ]
    return rows, list(_checks(tally))


def _checks(tally: _Tally) -> Iterator[CheckRow]:
    occluded = sum(n for (truth, _), n in tally.confusion.items() if truth == "occluded")
    yield CheckRow(
        check="faults: occluded sights are counted as such",
        checked=occluded,
        held=tally.confusion["occluded", Verdict.OCCLUDED.value],
        example=f"{occluded} sights",
    )
    yield CheckRow(
        check="faults: captures that never came are counted",
        checked=tally.missing,
        held=max(0, tally.missing - abs(tally.missing - tally.dropped)),
        example=f"{tally.missing} missing, {tally.dropped} counted",
    )
    yield CheckRow(
        check="faults: a flip that begins in plain sight is not published before it is held for long",
        checked=tally.plain,
        held=tally.plain - tally.plain_believed,
        example=f"{tally.plain} flipped sights",
    )


def _pass(recording: Iterator[TrueCapture], tally: _Tally) -> None:
    robot, mapping = figure_6()
    buffer = FrameBuffer()
    for transform in robot:
        buffer.insert(transform, static=True)
    core, limits = BridgeCore(mapping, buffer), mapping.limits
    reach_ns = 1e9 * (_TURNED_RAD - limits.slack_rad) / limits.turn_rad_s
    first = last = -1
    believed_ns = flipped_ns = 0
    for made in recording:
        capture = made.capture
        number = capture.number or 0
        first, last = (number if first < 0 else first), number
        truth = _truth(made)
        before = core.verdicts(OBJECT)
        core.take(capture, capture.receipt_ns)
        (verdict,) = Counter(core.verdicts(OBJECT)) - Counter(before)
        tally.confusion[truth, verdict] += 1
        if truth != "flipped":
            flipped_ns = capture.capture_ns
        elif capture.capture_ns - believed_ns < reach_ns:
            tally.plain += 1
            held = capture.capture_ns - flipped_ns >= limits.believe_after_s * 1e9
            tally.plain_believed += verdict in _BELIEVED and not held
        if truth == "seen" and verdict in _BELIEVED:
            believed_ns = capture.capture_ns
    tally.missing += last - first + 1 - core.captures
    tally.dropped += core.dropped


def _truth(made: TrueCapture) -> str:
    if made.flipped:
        return "flipped"
    sight = made.capture.sights[OBJECT]
    assert isinstance(sight, Pose | Lapse)
    return "occluded" if isinstance(sight, Lapse) else "seen"
