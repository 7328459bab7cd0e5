"""Points of synchronised depth, camera info and picture in a recording, beside their closed form."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.visualisation.recordings import read_recording
from sfglab.lab.experiments.visualisation.scene import (
    CAMERA,
    SIZE,
    Moment,
    back_projected,
    camera_info,
    image_message,
)
from sfglab.messages import serialize
from sfglab.view import Exact
from sfglab.view.arrivals import Arrival
from sfglab.view.rerunning import open_canvas
from sfglab.view.session import Session
from sfglab.view.stage import replay

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

_DEPTH = "/local/go2/camera_front/aligned_depth"
_PICTURE = "/local/go2/camera_front/color/image_raw"
_ENTITY = "/agents/go2/local/camera_front/aligned_depth/image_raw/cloud"
_STEP = 4
_MAX_M = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Cloud:
    """A depth image as points: those of the recording and those of the closed form."""

    moment: Moment  #: The picture and its depth.
    shown: NDArray[np.float64]  #: Points of the recording, m, shape (N, 3).
    colors: NDArray[np.uint8]  #: Their colours, shape (N, 3).
    expected: NDArray[np.float64]  #: Points of the closed form, m, shape (N, 3).
    expected_colors: NDArray[np.uint8]  #: Their colours, shape (N, 3).

    @property
    def errors_m(self) -> NDArray[np.float64]:
        """Distance of each point from that of the closed form; empty if there are not as many."""
        if self.shown.shape != self.expected.shape:
            return np.zeros(0)
        return np.asarray(np.linalg.norm(self.shown - self.expected, axis=1))

    @property
    def wrong_colors(self) -> int:
        """Number of points whose colour differs from that of the picture; all if there are not as many."""
        if self.colors.shape != self.expected_colors.shape:
            return len(self.expected)
        return int((self.colors != self.expected_colors).any(axis=1).sum())


def show_clouds(moments: Sequence[Moment], path: Path) -> list[Cloud]:
    """Show depth, camera info and picture of one stamp as points in a recording, and read them back."""
    session = Session()
    topics = {"depth": f"{_DEPTH}/image_raw", "info": f"{_DEPTH}/camera_info", "color": _PICTURE}
    display = session.add("depth_cloud", topics, {"decimation": _STEP, "depth_max_m": _MAX_M})
    session.rewire(display.id, sync=Exact())
    session.limit(display.id, None)
    with closing(open_canvas([str(path)])) as canvas:
        replay((arrival for moment in moments for arrival in _arrivals(moment)), session, canvas)
    recording = read_recording(path)
    points = {s.capture_ns: s.content for s in recording.get((_ENTITY, "Points3D:positions"), [])}
    colors = {s.capture_ns: s.content for s in recording.get((_ENTITY, "Points3D:colors"), [])}
    nothing: NDArray[Any] = np.zeros(0)
    clouds = []
    for moment in moments:
        shown = points.get(moment.stamp_ns, nothing)
        clouds.append(_cloud(moment, shown, colors.get(moment.stamp_ns, nothing)))
    return clouds


def _cloud(moment: Moment, points: Any, colors: Any) -> Cloud:
    packed = np.asarray(colors, dtype=np.uint32)
    channels = np.stack([(packed >> shift) & 255 for shift in (24, 16, 8)], axis=1)
    depth_m = moment.depth_mm[::_STEP, ::_STEP] / 1000.0
    rgb = moment.rgb[::_STEP, ::_STEP]
    info = camera_info(moment.header(CAMERA), SIZE)
    return Cloud(
        moment=moment,
        shown=np.asarray(points, dtype=np.float64).reshape(-1, 3),
        colors=channels.astype(np.uint8),
        expected=back_projected(moment.depth_mm, info, step=_STEP, max_m=_MAX_M),
        expected_colors=rgb[(depth_m > 0) & (depth_m <= _MAX_M)],
    )


def _arrivals(moment: Moment) -> Iterator[Arrival]:
    """Yield a picture's three messages and, among them, a picture of another time, which belongs to no depth."""
    header = moment.header(CAMERA)
    other = moment.header(CAMERA)
    other.stamp.nanosec += 1
    messages = [
        (f"{_DEPTH}/camera_info", camera_info(header, SIZE)),
        (_PICTURE, image_message(moment.rgb, "rgb8", header)),
        (_PICTURE, image_message(moment.rgb[::-1], "rgb8", other)),
        (f"{_DEPTH}/image_raw", image_message(moment.depth_mm, "16UC1", header)),
    ]
    for place, (topic, message) in enumerate(messages):
        yield Arrival(topic, message.__msgtype__, moment.stamp_ns + place, serialize(message))
