"""The module `cooperation.explorer` shows one simulated lap with the station's values of the robots' beams.

The explorer simulates a lap once per setting and keeps the lap, so a change of the time only draws the picture again.
During the simulation of a lap the figure shows the beginning of the lap.
"""

from __future__ import annotations

import time
from collections.abc import Iterator  # noqa: TC003  # read at run time
from functools import lru_cache
from threading import Lock
from typing import TYPE_CHECKING, Annotated

import numpy as np
import pandas as pd

from sfglab.arp.hallway import AREAS, BEAMS_DEG, LIMIT_S, ROBOTS, SCAN_HZ, Area
from sfglab.arp.hallway.simulation import OPTIMUM, LapSettings, SimulatedLap
from sfglab.arp.robots import METHODS, MethodName
from sfglab.fields import Bounds
from sfglab.lab import pictures
from sfglab.lab.experiments.cooperation.experiment import exp
from sfglab.lab.experiments.cooperation.results import ROBOT_COLORS, ending_text, setting_text
from sfglab.lab.figures import COLORS
from sfglab.rtps import Medium
from sfglab.rtps.vendors import PresetName  # noqa: TC001  # read at run time

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.arp.hallway.simulation import Snapshot

WRONG_M = 0.1
"""Error from which a range at the station counts as wrong; a robot drives 0.022 m in a turn of the LIDAR."""

MaximumRate = Annotated[int, Bounds(100, 1000, log=True)]
HistoryDepth = Annotated[int, Bounds(1, 1000, log=True)]
Percent = Annotated[float, Bounds(0, 5)]
Seconds = Annotated[float, Bounds(0, LIMIT_S)]
Seed = Annotated[int, Bounds(0, 20)]

_BEAMS, _WRONG = "beams as measured", "beams at the station, if wrong"
_COLORS = {
    "walls": "#808080",
    _BEAMS: "#56B4E9",
    _WRONG: COLORS["standard"],
    **ROBOT_COLORS,
}
_SPAN_M = 6.4  # Both axes have this range, so that a square panel has equal scales.
_X = pictures.Axis("x", "m", -0.7, _SPAN_M - 0.7)
_Y = pictures.Axis("y", "m", -1.2, _SPAN_M - 1.2)
_TIME = pictures.Axis("time", "s", 0, LIMIT_S, si=True)
_WRONG_FOR = pictures.Axis("station wrong for", "s", 0, 15)
_CHUNK_S = 1.0  # The explorer checks the clock after each chunk of this simulated time.
_COARSE_S = 0.06  # The first picture has this computing time.
_EVERY = 4  # A line has a point after each such number of LIDAR turns.
_LOCK = Lock()  # The explorer's thread and a notebook's cell may drive the same kept lap.


@exp.explorer
def hallway_lap(  # noqa: PLR0913  # one control for each
    *,
    method: MethodName = "OPT+LC",
    rate_max_hz: MaximumRate = 100,
    depth: HistoryDepth = 10,
    loss_percent: Percent = 1.0,
    preset: PresetName = "fast_dds",
    seed: Seed = 0,
    shown_s: Seconds = 10.0,
) -> Iterator[pictures.Picture | None]:
    """Yield pictures of a lap at a time: one hallway per robot, and the time for which the station is wrong.

    Args:
        method: Balanced QoS (OPT), local cache (LC), cache control (CC), or combinations.
        rate_max_hz: Maximum rate of a topic, Rmax [Hz]. With OPT, Eq. 6 gives a lower rate.
        depth: Depth of the histories (DEPTH). No effect with OPT: Eq. 6 gives the depth.
        loss_percent: Frames that the wireless channel loses [%].
        preset: Middleware whose timing is simulated.
        seed: Seed of physics and channel.
        shown_s: Time that is shown [s].
    """
    settings = LapSettings(
        method=method,
        rate_max_hz=rate_max_hz,
        depth=OPTIMUM if METHODS[method].optimised else depth,
        vendor=preset,
        medium=Medium(loss=loss_percent / 100),
    )
    lap = lap_of(settings, seed)
    if not _drive_on(lap, _COARSE_S):
        yield draw(settings, lap, shown_s)
    while not _drive_on(lap):
        yield None
    yield draw(settings, lap, shown_s)


@lru_cache(maxsize=16)
def lap_of(settings: LapSettings, seed: int) -> SimulatedLap:
    """Return a lap that continues from its last time, so that no part of the lap is simulated twice."""
    return SimulatedLap(settings, seed, record=True)


def _drive_on(lap: SimulatedLap, lasting_s: float = 0.0) -> bool:
    """Simulate further for a computing time, one chunk at least; return whether the lap has ended."""
    end_s = time.monotonic() + lasting_s
    with _LOCK:
        while not lap.drive(lap.time_s + _CHUNK_S):
            if time.monotonic() >= end_s:
                return False
    return True


def draw(settings: LapSettings, lap: SimulatedLap, shown_s: float) -> pictures.Picture:
    """Return the plot of the simulated part of a lap at a time, s."""
    snapshots = lap.snapshots
    place = min(int(shown_s * SCAN_HZ), len(snapshots) - 1)
    shown = snapshots[place]
    poses = [snapshot.poses for snapshot in snapshots[: place + 1 : _EVERY]]
    tracks = np.array([*poses, shown.poses])[:, :, :2]
    panels = []
    for number, area in enumerate(AREAS):
        panels.append(_hallway(area, number, shown, tracks[:, number]))
    ending = f"simulated up to {lap.time_s:.0f} s"
    if lap.verdict is not None:
        result = lap.result()
        ending = ending_text(result.end, result.robot, lap.time_s)
    said = (
        f"{setting_text(settings)}: {ending}. "
        f"At {shown.time_s:.1f} s the station's command is {shown.manoeuvre.value!r}."
    )
    return pictures.Picture(said=said, panels=(*panels, _wrong_panel(snapshots, place)))


def _hallway(
    area: Area, number: int, shown: Snapshot, track: NDArray[np.float64]
) -> pictures.Panel:
    """Return a panel of a robot's hallway, with the robot's track until now and the robot's beams."""
    measured_m, believed_m = shown.measured_m[number], shown.believed_m[number]
    pose = shown.poses[number]
    is_wrong = wrong_beams(measured_m, believed_m)
    walls = [_series("walls", np.vstack((ring, ring[:1]))) for ring in area.rings]
    series = (
        *walls,
        _series(_BEAMS, _star(pose, measured_m)),
        _series(_WRONG, _star(pose, np.where(is_wrong, believed_m, np.inf))),
        _series(area.robot, track),
        _series(area.robot, pose[None, :2], "dot"),
    )
    note = f"{is_wrong.sum()} of {len(BEAMS_DEG)} beams wrong at the station"
    return pictures.Panel(title=area.robot, x=_X, y=_Y, series=series, note=note)


def _series(
    name: str, points: NDArray[np.float64], kind: pictures.Kind = "path"
) -> pictures.Series:
    x, y = points.T.tolist()
    return pictures.Series(name=name, color=_COLORS[name], kind=kind, x=x, y=y)


def _star(pose: NDArray[np.float64], ranges_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return beams as one path, which returns to the robot after each beam and leaves out beams without echo."""
    seen = np.isfinite(ranges_m)
    angles = pose[2] + np.radians(BEAMS_DEG)[seen]
    path = np.repeat(pose[None, :2], 2 * len(angles) + 1, axis=0)
    path[1::2] += ranges_m[seen, None] * np.column_stack((np.cos(angles), np.sin(angles)))
    return path


def wrong_beams(
    measured_m: NDArray[np.float64], believed_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return which ranges at the station differ from the measured ones by more than `WRONG_M`; any equal shapes."""
    # A range is infinite without an echo or a value, and two infinite ranges are equal.
    return ~np.isclose(measured_m, believed_m, rtol=0, atol=WRONG_M)


def wrong_for_s(snapshots: list[Snapshot]) -> NDArray[np.float64]:
    """Return how long the station has been wrong about a beam of each robot, s, shape (turns, robots)."""
    lasting = np.zeros((len(snapshots), len(ROBOTS)))
    for turn, snapshot in enumerate(snapshots[1:], 1):
        is_wrong = wrong_beams(snapshot.measured_m, snapshot.believed_m).any(axis=1)
        lasting[turn] = (lasting[turn - 1] + 1 / SCAN_HZ) * is_wrong
    return lasting


def _wrong_panel(snapshots: list[Snapshot], place: int) -> pictures.Panel:
    """Return a panel of how long the station has been wrong about each robot, with dots at the shown time."""
    times_s = [snapshot.time_s for snapshot in snapshots]
    lasting_s = pd.DataFrame(wrong_for_s(snapshots), index=times_s, columns=ROBOTS)
    drawn = pictures.lines(lasting_s[::_EVERY], _COLORS)
    dots = pictures.lines(lasting_s[place : place + 1], _COLORS, "dot")
    return pictures.Panel(
        title="wrong at the station",
        x=_TIME,
        y=_WRONG_FOR,
        series=(*drawn, *dots),
        note=f"longest: {lasting_s.to_numpy().max():.1f} s",
    )
