"""Synthetic recordings: faults of cameras against the bridge's verdicts; exact.

A flipped sight is told from a true one only by how it came about; whatever is published counts.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.checks import CheckRow
from sfglab.lab.checks.trees import OBJECT, figure_6
from sfglab.lab.workers.mocap import FAULTY, MOTION
from sfglab.spatial import Pose
from sfglab.spatial.frames.buffer import FrameBuffer
from sfglab.spatial.mocap.bridge import BridgeCore
from sfglab.spatial.mocap.synthetic import TrueCapture, synthetic_captures
from sfglab.spatial.mocap.tracking import Lapse, Verdict

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_BELIEVED = frozenset(v.value for v in Verdict if v.believed)
_TURNED_RAD = 2.5
"""Below half a turn less noise: what the object must not be able to have turned since it was last believed."""


@dataclass(slots=True)
class Tally:
    """What came of one recording after the other."""

    confusion: Counter[tuple[str, str]] = field(default_factory=Counter)  #: By truth and verdict.
    missing: int = 0  #: Captures that never came.
    dropped: int = 0  #: How many the bridge counted.
    plain: int = 0  #: Flipped sights that began in plain sight.
    plain_believed: int = 0  #: How many of them were published too early.


def confusion_of(recordings: int, length_s: float, seed: int) -> Tally:
    """Send so many recordings with known faults, each so many seconds long, through the bridge."""
    tally = Tally()
    for number in range(recordings):
        rng = np.random.default_rng([seed, 1, number])
        _pass(synthetic_captures({OBJECT: MOTION}, FAULTY, rng, duration_s=length_s), tally)
    return tally


def fault_checks(tally: Tally) -> Iterator[CheckRow]:
    """Yield what must hold of the bridge's verdicts."""
    occluded = sum(n for (truth, _), n in tally.confusion.items() if truth == "occluded")
    counted = max(0, tally.missing - abs(tally.missing - tally.dropped))
    held, plain = (
        tally.plain - tally.plain_believed,
        "a flip that begins in plain sight is not published",
    )
    rows = (
        (
            "occluded sights are counted as such",
            occluded,
            tally.confusion["occluded", "occluded"],
            "sights",
        ),
        (
            "captures that never came are counted",
            tally.missing,
            counted,
            f"missing, {tally.dropped} counted",
        ),
        (f"{plain} before it is held for long", tally.plain, held, "flipped sights"),
    )
    for check, checked, held, words in rows:
        yield CheckRow(
            check=f"faults: {check}", checked=checked, held=held, example=f"{checked} {words}"
        )


def published_check(confusion: Mapping[Any, int]) -> CheckRow:
    """Return whether no flipped sight is published, however it came; from counts by truth and verdict."""
    verdicts = {
        verdict: count for (truth, verdict), count in confusion.items() if truth == "flipped"
    }
    published = {verdict: count for verdict, count in verdicts.items() if verdict in _BELIEVED}
    count, check = sum(verdicts.values()), "faults: no flipped sight is published"
    words = (
        ", ".join(f"{n} as {verdict}" for verdict, n in published.items())
        or f"{count} flipped sights"
    )
    return CheckRow(
        check=check, checked=max(1, count), held=count - sum(published.values()), example=words
    )


def _pass(recording: Iterator[TrueCapture], tally: Tally) -> None:
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
        truth = truth_of(made)
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


def truth_of(made: TrueCapture) -> str:
    """Return what a sight is: ``flipped``, ``occluded`` or ``seen``."""
    if made.flipped:
        return "flipped"
    sight = made.capture.sights[OBJECT]
    assert isinstance(sight, Pose | Lapse)
    return "occluded" if isinstance(sight, Lapse) else "seen"
