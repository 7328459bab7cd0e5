"""Checks of synchronisation: streams whose partners are known, and points against a back-projection."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.checks import Case, CheckRow, Checks, Sample
from sfglab.lab.checks.fleet_scene import (
    CAMERA,
    SIZE,
    Moment,
    back_projected,
    camera_info,
    image_message,
)
from sfglab.lab.checks.recordings import read_recording
from sfglab.messages import serialize
from sfglab.view.arrivals import Arrival
from sfglab.view.rerunning import open_canvas
from sfglab.view.session import Session
from sfglab.view.stage import replay
from sfglab.view.sync import PATIENCE, Approximate, Exact, synchronizer

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

checks = Checks("synchronisation")

_TOPICS = ("image", "info", "depth")
_PERIOD_NS = 33_333_333
_JITTER_NS = 5_000_000
_ROOT = "/local/go2/camera_front/aligned_depth"
_PICTURE = "/local/go2/camera_front/color/image_raw"
_STEP, _MAX_M = 4, 10.0
_TOLERANCE_M = 1e-5


@checks.cases("exact time: the sets of three topics are those that were sent, each once, in order")
def _exact(sample: Sample) -> Iterator[Case]:
    return _matched(sample, Exact(depth=30), 0)


@checks.cases(
    "approximate time: the sets of three topics are those that were sent, each once, in order"
)
def _approximate(sample: Sample) -> Iterator[Case]:
    return _matched(sample, Approximate(slop_ns=2 * _JITTER_NS, depth=30), _JITTER_NS)


@checks.cases(
    "what waits is bounded, what is not newer is dropped, and a partner that comes finds the rest gone"
)
def _bounded(_sample: Sample) -> Iterator[Case]:
    for policy in (Exact(depth=5), Approximate(slop_ns=0, depth=5)):
        queues = synchronizer(policy, _TOPICS[:2])
        found = [m for n in (*range(8), 7) for m in queues.offer("image", n, n)]
        yield (
            repr(policy),
            (found, queues.waiting, queues.unmatched, queues.disordered) == ([], 5, 3, 1),
        )
        [matched] = queues.offer("info", 6, 6)
        yield (
            repr(policy),
            (matched.items, queues.waiting) == (dict.fromkeys(_TOPICS[:2], (6, 6)), 1),
        )


@checks.cases("a camera's calibration that was said once holds, until it is said again")
def _steady(_sample: Sample) -> Iterator[Case]:
    for policy in (Exact(depth=30), Approximate(slop_ns=0, depth=30)):
        queues = synchronizer(policy, _TOPICS[:2], steady=("info",))
        said = [
            ("info", 0),
            *(("image", n) for n in range(1, 9)),
            ("info", 9),
            ("image", 9),
            ("image", 10),
        ]
        found = [
            [n for _, n in m.items.values()] for topic, n in said for m in queues.offer(topic, n, n)
        ]
        yield repr(policy), found == [*([n, 0] for n in range(PATIENCE + 1, 9)), [9, 9]]


def _matched(sample: Sample, policy: Any, jitter_ns: int) -> Iterator[Case]:
    """Synchronise random streams of three topics, some messages lost; a case is a set, sent whole or found."""
    rng = np.random.default_rng(sample.seed)  # the same streams for both, but for their jitter
    for _ in range(sample.count):
        found, whole = _streams(policy, jitter_ns, rng)
        same = sum(a == b for a, b in zip(found, whole, strict=False))
        for number in range(max(len(found), len(whole))):
            yield f"{sample.count} streams", number < same


def _streams(policy: Any, jitter_ns: int, rng: np.random.Generator) -> tuple[list[Any], list[Any]]:
    """Return the sets that come out, and those that were sent whole."""
    kept = rng.random((40, 3)) > 0.2
    kept[-1] = True  # a last whole set, so that what waits before it is decided
    jitter = rng.integers(-jitter_ns, jitter_ns + 1, (40, 3))
    items = [
        (float(n + rng.uniform(0, 0.4)), topic, n * _PERIOD_NS + int(jitter[n, t]), n)
        for n in range(40)
        for t, topic in enumerate(_TOPICS)
        if kept[n, t]
    ]
    queues = synchronizer(policy, _TOPICS)
    found = [m for _, topic, stamp_ns, n in sorted(items) for m in queues.offer(topic, stamp_ns, n)]
    sets = [tuple(number for _, number in matched.items.values()) for matched in found]
    whole = [(n,) * 3 for n in range(40) if kept[n].all()]
    if jitter_ns:  # the last one may have to wait for a message that says it gets no better
        whole, sets = whole[:-1], [s for s in sets if s != (39,) * 3]
    return sets, whole


@dataclass(frozen=True, slots=True, kw_only=True)
class Cloud:
    """A depth image as points: what the recording holds, and the reference."""

    moment: Moment  #: The picture and its depth.
    shown: NDArray[np.float64]  #: Points of the recording, metres, shape (N, 3).
    colors: NDArray[np.uint8]  #: Their colours, shape (N, 3).
    expected: NDArray[np.float64]  #: Points of the reference.
    expected_colors: NDArray[np.uint8]  #: Their colours.

    @property
    def errors_m(self) -> NDArray[np.float64]:
        """Distance of each point from its reference; empty if there are not as many."""
        same = self.shown.shape == self.expected.shape
        return np.linalg.norm(self.shown - self.expected, axis=1) if same else np.zeros(0)

    @property
    def row(self) -> dict[str, Any]:
        """The cloud in numbers: what the experiment's table says of an image."""
        same = self.colors.shape == self.expected_colors.shape
        wrong = (
            int((self.colors != self.expected_colors).any(axis=1).sum())
            if same
            else len(self.expected)
        )
        return {
            "stamp_ns": self.moment.stamp_ns,
            "points": len(self.shown),
            "expected": len(self.expected),
            "largest_error_m": float(self.errors_m.max()) if len(self.errors_m) else float("inf"),
            "wrong_colors": wrong,
        }


def show_clouds(moments: Sequence[Moment], path: Path) -> list[Cloud]:
    """Show synchronised depth, camera info and picture as points in a recording, and read them back."""
    session = Session()
    topics = {"depth": f"{_ROOT}/image_raw", "info": f"{_ROOT}/camera_info", "color": _PICTURE}
    display = session.add("depth_cloud", topics, {"decimation": _STEP, "depth_max_m": _MAX_M})
    session.rewire(display.id, sync=Exact())
    session.limit(display.id, None)
    with closing(open_canvas([str(path)])) as canvas:
        replay((arrival for moment in moments for arrival in _arrivals(moment)), session, canvas)
    recording = read_recording(path)
    entity = "/agents/go2/local/camera_front/aligned_depth/image_raw/cloud"
    points = {s.capture_ns: s.content for s in recording.get((entity, "Points3D:positions"), [])}
    colors = {s.capture_ns: s.content for s in recording.get((entity, "Points3D:colors"), [])}
    nothing: NDArray[Any] = np.zeros(0)
    return [
        _cloud(m, points.get(m.stamp_ns, nothing), colors.get(m.stamp_ns, nothing)) for m in moments
    ]


def _cloud(moment: Moment, points: Any, colors: Any) -> Cloud:
    packed = np.asarray(colors, dtype=np.uint32)
    info = camera_info(moment.header(CAMERA), SIZE)
    depth, rgb = moment.depth_mm[::_STEP, ::_STEP] / 1000.0, moment.rgb[::_STEP, ::_STEP]
    return Cloud(
        moment=moment,
        shown=np.asarray(points, dtype=np.float64).reshape(-1, 3),
        colors=np.stack([(packed >> shift) & 255 for shift in (24, 16, 8)], axis=1).astype(
            np.uint8
        ),
        expected=back_projected(moment.depth_mm, info, step=_STEP, max_m=_MAX_M),
        expected_colors=rgb[(depth > 0) & (depth <= _MAX_M)],
    )


def _arrivals(moment: Moment) -> Iterator[Arrival]:
    """Yield a picture's three messages and, among them, one of another time that belongs to no depth."""
    header, other = moment.header(CAMERA), moment.header(CAMERA)
    other.stamp.nanosec += 1
    messages = [
        (f"{_ROOT}/camera_info", camera_info(header, SIZE)),
        (_PICTURE, image_message(moment.rgb, "rgb8", header)),
        (_PICTURE, image_message(moment.rgb[::-1], "rgb8", other)),
        (f"{_ROOT}/image_raw", image_message(moment.depth_mm, "16UC1", header)),
    ]
    for place, (topic, message) in enumerate(messages):
        yield Arrival(topic, message.__msgtype__, moment.stamp_ns + place, serialize(message))


def check_clouds(clouds: Sequence[Cloud]) -> CheckRow:
    """Check that points and colours are those of the reference, to a hundredth of a millimetre."""
    rows = [cloud.row for cloud in clouds]
    whole = [r for r in rows if r["points"] == r["expected"] > 0 and not r["wrong_colors"]]
    largest = max(row["largest_error_m"] for row in rows)
    return CheckRow(
        check="depth, camera info and picture of one time become the points of an independent back-projection",
        checked=len(rows),
        held=sum(row["largest_error_m"] <= _TOLERANCE_M for row in whole),
        example=f"{sum(row['points'] for row in rows)} points, largest error {1e6 * largest:.2f} um",
    )
