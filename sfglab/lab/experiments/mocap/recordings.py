"""Synthetic recordings: faults of cameras against the bridge's verdicts, and estimates of the offset; exact.

A flipped sight is told from a true one only by how it came about; whatever is published counts. Beyond the
paper: where the base is in the tracked object, estimated from motions whose truth is known.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.checks import CheckRow
from sfglab.lab.checks.trees import AGENT, OBJECT, WORLD, figure_6
from sfglab.lab.workers.mocap import FAULTY, MOTION
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.buffer import FrameBuffer
from sfglab.spatial.mocap.bridge import BridgeCore
from sfglab.spatial.mocap.mapping import MappedObject, MocapMapping
from sfglab.spatial.mocap.offset import estimate_offset, pose_pairs
from sfglab.spatial.mocap.synthetic import (
    SyntheticConfig,
    SyntheticMotion,
    TrueCapture,
    synthetic_captures,
)
from sfglab.spatial.mocap.tracking import Lapse, Verdict

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_BELIEVED = frozenset(v.value for v in Verdict if v.believed)
_TURNED_RAD = 2.5
"""Below half a turn less noise: what the object must not be able to have turned since it was last believed."""
_ODOM, _BASE = f"{AGENT}/odom", f"{AGENT}/base"
_OFFSET = Pose.at((0.031, -0.012, -0.118), (0.02, -0.03, 0.06, 1.0))
"""The base in the object's frame: a plate of markers that nobody has put on straight."""
_WORLD_FROM_ODOM = Pose.from_yaw((3.0, -1.0, 0.2), 0.8)
_CAMERAS = SyntheticConfig(rate_hz=20.0)
_ODOM_M, _ODOM_RAD = 0.003, 0.004
_DRIFT_M_S, _DRIFT_RAD_S = 0.01, 0.002
_REPLAY_S = 5.0
_OTHER_WAY = SyntheticMotion(radii_m=(1.0, 1.5, 0.2), period_s=7.0)


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


def offset_row(
    length_s: float, seed: tuple[int, ...], *, drifts: bool, modelled: bool
) -> dict[str, Any]:
    """Return one estimate of the offset, and what it is worth when it goes through the bridge.

    It is made from a motion of `length_s` seconds, whose odometry drifts or not, and may allow for that.
    """
    motion, rng = SyntheticMotion(), np.random.default_rng(seed)
    made = list(synthetic_captures({OBJECT: motion}, _CAMERAS, rng, duration_s=length_s))
    captures = [m.capture for m in made]
    buffer = _odometry(motion, [c.capture_ns for c in captures], rng, drifts=drifts)
    found = estimate_offset(
        pose_pairs(captures, OBJECT, buffer, odom=_ODOM, base=_BASE), drift=modelled
    )
    turn = (_OFFSET.rotation.inv() * found.object_from_base.rotation).as_rotvec()
    error = np.concatenate(
        [turn, np.subtract(found.object_from_base.position_m, _OFFSET.position_m)]
    )
    sigmas = np.array([*found.sigma_rad, *found.sigma_m])
    (before_m, before_rad), (after_m, after_rad) = (
        _replayed(x) for x in (Pose(), found.object_from_base)
    )
    return {
        "length_s": length_s,
        "drifts": drifts,
        "modelled": modelled,
        "pairs": found.pairs,
        **_norms("error", error),
        **_norms("sigma", sigmas),
        "covered": int((np.abs(error) <= 1.96 * sigmas).sum()),
        "before_mm": 1e3 * before_m,
        "after_mm": 1e3 * after_m,
        "before_mrad": 1e3 * before_rad,
        "after_mrad": 1e3 * after_rad,
    }


def _norms(name: str, turn_and_place: np.ndarray) -> dict[str, float]:
    turn_rad, place_m = turn_and_place[:3], turn_and_place[3:]
    norms = {"mm": np.linalg.norm(place_m), "mrad": np.linalg.norm(turn_rad)}
    return {f"{name}_{unit}": 1e3 * float(norm) for unit, norm in norms.items()}


def _odometry(
    motion: SyntheticMotion, times_ns: list[int], rng: np.random.Generator, *, drifts: bool
) -> FrameBuffer:
    """Return what the robot says of itself, at the times of the captures."""
    buffer = FrameBuffer(history_s=None)
    for time_ns in times_ns:
        time_s = time_ns / 1e9
        drift = (
            Pose.from_yaw((_DRIFT_M_S * time_s, 0.0, 0.0), _DRIFT_RAD_S * time_s)
            if drifts
            else Pose()
        )
        noise = Pose.at(rng.normal(size=3) * _ODOM_M, (*(rng.normal(size=3) * _ODOM_RAD / 2), 1.0))
        pose = drift @ _WORLD_FROM_ODOM.inverse() @ motion.pose_at(time_s) @ _OFFSET @ noise
        buffer.insert(StampedTransform(parent=_ODOM, child=_BASE, stamp_ns=time_ns, pose=pose))
    return buffer


def _replayed(offset: Pose) -> tuple[float, float]:
    """Return the median error of the base through the bridge with an offset, in m and rad, on another way."""
    buffer = FrameBuffer()
    buffer.insert(
        StampedTransform(parent=_BASE, child=f"{AGENT}/camera", stamp_ns=0, pose=Pose()),
        static=True,
    )
    mapped = MappedObject(id=OBJECT, via=_BASE, offset=offset)
    core = BridgeCore(MocapMapping(world=WORLD, objects={OBJECT: mapped}), buffer)
    rng = np.random.default_rng(0)
    errors = []
    for made in synthetic_captures({OBJECT: _OTHER_WAY}, _CAMERAS, rng, duration_s=_REPLAY_S):
        for transform in core.take(made.capture, made.capture.receipt_ns):
            true = made.truth[OBJECT] @ _OFFSET
            errors.append((transform.pose.distance_m(true), transform.pose.angle_rad(true)))
    metres, angles = np.median(errors, axis=0)
    return float(metres), float(angles)
