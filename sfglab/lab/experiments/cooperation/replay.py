"""A replay of a round: where the robots are, and what the station believes that their LIDARs measure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.hallway import BEAMS_DEG, RADIUS_M, SCAN_HZ, End
from sfglab.arp.hallway.simulation import ROBOTS
from sfglab.errors import InvalidValueError
from sfglab.lab.experiments.cooperation.experiment import Config, driven, settings_of, track_rows
from sfglab.lab.experiments.cooperation.figures import draw_area
from sfglab.lab.explore.press import Pressed, part
from sfglab.lab.figures import COLORS
from sfglab.lab.runs import Run, lines_of
from sfglab.view.widgets import widgets

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

WRONG_M = 0.1
"""By which a beam that the station has is wrong; in a turn of the LIDAR a robot comes a fifth of it ahead."""
_FAR_M = 99.0  # stands for infinite
_TITLES = {robot: f"go where the station is wrong about {robot} for longest" for robot in ROBOTS}
_COLORS = dict(zip(ROBOTS, ("proxy", "third", "fourth"), strict=True))


class Replay(Pressed):
    """A method's first round that failed, its first one if none did, to scrub, with what the station believed.

    Raises:
        InvalidValueError: The run has no round with this method.
        MissingExtraError: The extra ``view`` is not installed.
    """

    def __init__(self, run: Run[Config], method: str = "OPT+LC") -> None:
        rows = run["course"][run["course"]["method"] == method]
        if rows.empty:
            raise InvalidValueError(
                "method", method, ", ".join(dict.fromkeys(run["course"]["method"]))
            )
        failed, kit = rows[rows["end"] != End.SUCCESS.value], widgets()
        first = lines_of(rows if failed.empty else failed)[0]
        self.run, self.row = driven(settings_of(first, run.config), first.seed)
        beliefs = [(turn.measured_m, turn.believed_m) for turn in self.run.snapshots]
        self.late_s = late_s(np.array(beliefs))  #: See `late_s`.
        last = len(self.late_s) - 1
        #: The turn of the LIDARs that is shown; the worst one to begin with.
        self.turn = kit.IntSlider(max=last, description="LIDAR turn", layout={"width": "40em"})
        self.turn.value = int(self.late_s.max(axis=1).argmax())
        play = kit.Play(max=last, interval=500, step=3)
        kit.jslink((play, "value"), (self.turn, "value"))
        above = [kit.HBox([play, self.turn])]
        super().__init__(
            self.draw, size=(10.2, 5.2), press=self._go, titles=_TITLES.copy, above=above
        )
        self.turn.observe(lambda _: self.redraw(), "value")

    def _go(self, robot: str) -> None:
        self.turn.value = int(self.late_s[:, ROBOTS.index(robot)].argmax())

    def draw(self, figure: Figure) -> None:
        """Draw the robots with their true beams and the station's, and for how long it is wrong."""
        panels = figure.subplot_mosaic([[*ROBOTS], ["late"] * len(ROBOTS)], height_ratios=(3, 1))
        turn, late = self.turn.value, panels["late"]
        snapshot = self.run.snapshots[turn]
        for i, track in enumerate(track_rows("", [snapshot])):
            ranges_m = snapshot.measured_m[i], snapshot.believed_m[i]
            _draw_robot(panels[track.robot], track, *ranges_m)
            times = np.arange(len(self.late_s)) / SCAN_HZ
            color = COLORS[_COLORS[track.robot]]
            late.plot(times, self.late_s[:, i], color=color, label=track.robot, linewidth=1)
            worst = int(self.late_s[:, i].argmax())
            part(
                track.robot,
                *late.plot(times[worst], self.late_s[worst, i], "o", color=color, markersize=8),
            )
        late.axvline(turn / SCAN_HZ, color="black", linewidth=1)
        late.set(xlabel="time (s)", ylabel="station wrong\nfor (s)")
        late.legend(fontsize=8, ncols=3, loc="upper left")
        point = (
            f"{self.row.method}, Rmax {self.row.rate_max_hz} Hz: {self.row.end} {self.row.robot}"
        )
        said = f"{turn / SCAN_HZ:.1f} s: the station has released {snapshot.manoeuvre.value!r}"
        figure.suptitle(f"{point}\n{said}", fontsize=10)


def late_s(beliefs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return for how long the station has been wrong about a beam of each robot, shape (turns, robots).

    Args:
        beliefs: Ranges measured and believed, metres, shape (turns, 2, robots, beams).
    """
    ranges = np.minimum(beliefs, _FAR_M)  # infinite: no echo, or nothing heard yet
    wrong = (np.abs(ranges[:, 0] - ranges[:, 1]) > WRONG_M).any(axis=2)
    lasting = np.zeros(wrong.shape)
    for turn in range(1, len(wrong)):
        lasting[turn] = (lasting[turn - 1] + 1 / SCAN_HZ) * wrong[turn]
    return lasting


def _draw_robot(
    axes: Axes, track: Any, measured: NDArray[np.float64], believed: NDArray[np.float64]
) -> None:
    """Draw a robot, its beams as they are in grey, and as the station has them in red where they are wrong."""
    from matplotlib.patches import Circle

    draw_area(axes, track.robot)
    angles = track.heading_rad + np.radians(BEAMS_DEG)
    for angle, true_m, known_m in zip(angles, measured, believed, strict=True):
        shown = [(true_m, COLORS["network"])]
        if abs(min(true_m, _FAR_M) - min(known_m, _FAR_M)) > WRONG_M:
            shown.append((known_m, COLORS["standard"]))
        for range_m, color in shown:
            if np.isfinite(range_m):
                x = track.x_m, track.x_m + range_m * np.cos(angle)
                y = track.y_m, track.y_m + range_m * np.sin(angle)
                axes.plot(x, y, ".-", color=color, linewidth=0.8, markersize=4)
    axes.add_patch(
        Circle((track.x_m, track.y_m), RADIUS_M, color=COLORS[_COLORS[track.robot]], zorder=3)
    )
    ahead = f"ahead {measured[0]:.2f} m; the station has {believed[0]:.2f} m"
    axes.set_title(f"{track.robot}: {ahead}", fontsize=8)
