"""Time line of one writer and one reader: samples, heartbeats, ACKNACKs and retransmissions.

It is drawn from the frames that the model of RTPS sent. Each click on a frame and each changed setting starts a
new simulation.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np

from sfglab.fields import Bounds
from sfglab.lab.explore.form import Form
from sfglab.lab.explore.press import Pressed, part
from sfglab.lab.figures import COLORS
from sfglab.qos import QoSProfile
from sfglab.rtps import PRESETS, AirFrame, Flow, FlowOutcome, Frame, Medium, Scenario, trace
from sfglab.units import NS_PER_S
from sfglab.view.widgets import widgets

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

Rate = Annotated[float, Bounds(1, 200, log=True)]
Depth = Annotated[int, Bounds(1, 50)]
LossPercent = Annotated[float, Bounds(0, 50)]
Samples = Annotated[int, Bounds(1, 40)]
Seed = Annotated[int, Bounds(0, 20)]

_FLOW = "a"
_REPAIR = "retransmission"
_KINDS = {
    Frame.DATA: ("sample", COLORS["proxy"]),
    Frame.BURST: (_REPAIR, COLORS["third"]),
    Frame.HEARTBEAT: ("heartbeat", "black"),
    Frame.ACKNACK: ("request (ACKNACK)", COLORS["fourth"]),
    Frame.GAP: ("GAP: sample not kept", COLORS["network"]),
}
"""Name and colour of each kind of frame."""
_TICKS = 14  #: Largest number of ticks.
_TICK_MS = 50  #: Ticks are at multiples of this time, ms.


class Timeline(Pressed):
    """One writer and one reader over time; a click on a frame loses it, a second click delivers it.

    At first, sample 5 is lost.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """

    def __init__(self) -> None:
        #: Whether a clicked frame is lost (True) or delivered (False), by `AirFrame.name`.
        self.lost = {f"{_FLOW}/DATA/5": True}
        self.form = Form(self.simulate, lambda: self.answer(self._simulate))
        self._simulate()
        hint = widgets().HTML("Zoom: Ctrl and wheel. Move: drag. Show all: double click.")
        super().__init__((11.0, 4.2), [self.form.widget, hint])

    def simulate(  # noqa: PLR0913  # one control for each
        self,
        *,
        preset: Literal["fast_dds", "cyclone_dds"] = "fast_dds",
        rate_hz: Rate = 20.0,
        depth: Depth = 8,
        loss_percent: LossPercent = 0.0,
        samples: Samples = 16,
        seed: Seed = 0,
    ) -> None:
        """Simulate one writer, one reader, and the wireless channel between them.

        Args:
            preset: Middleware whose timing is simulated.
            rate_hz: Rate of the samples [Hz].
            depth: Depth of each history, samples.
            loss_percent: Frames that the channel loses beside the clicked ones [%].
            samples: Number of published samples.
            seed: Seed of the losses.
        """
        qos = QoSProfile(depth=depth)
        flow = Flow(name=_FLOW, source="robot", target="station", rate_hz=rate_hz, qos=qos)
        scenario = Scenario(
            flows=(flow,),
            medium=Medium(loss=loss_percent / 100),
            vendor=PRESETS[preset],
            duration_s=(samples - 0.5) / rate_hz,
            drain_s=4.0,  # for a periodic heartbeat of Fast DDS and its retransmissions
        )
        outcome, self.frames = trace(scenario, seed=seed, lost=self.lost)
        self.outcome = outcome.flows[_FLOW]

    def _simulate(self) -> None:
        self.simulate(**self.form.values)

    def take(self, name: str) -> None:
        """Toggle whether the clicked frame is lost, and simulate again."""
        self.lost[name] = not next(frame.lost for frame in self.frames if frame.name == name)
        self._simulate()

    def titles(self) -> dict[str, str]:
        """Return a sentence about each frame."""
        return {frame.name: sentence(frame) for frame in self.frames}

    def draw(self, figure: Figure) -> None:
        """Draw frames between the lines of writer and reader, and the times of samples on both lines.

        Distances are the roots of pauses, so that all frames are visible.
        """
        outcome = self.outcome
        ends = [time for frame in self.frames for time in (frame.began_ns, frame.ended_ns)]
        times_ns = np.unique([0, *ends, *outcome.published_ns, *outcome.received_ns])
        places = np.cumsum(np.sqrt(np.diff(times_ns / NS_PER_S, prepend=0.0)))
        place_of: Callable[[Any], Any] = partial(np.interp, xp=times_ns, fp=places)
        axes = figure.subplots()
        axes.hlines((0, 1), places[0], places[-1], color="black", linewidth=0.8)
        for frame in self.frames:
            _draw_frame(axes, frame, place_of((frame.began_ns, frame.ended_ns)))
        _draw_samples(axes, outcome, place_of)
        ticks = {places[0]: "0"}
        for time_ms in range(0, int(times_ns[-1] / 1e6), _TICK_MS):
            place = float(place_of(1e6 * time_ms))
            if place > max(ticks) + places[-1] / _TICKS:
                ticks[place] = str(time_ms)
        axes.set_xticks([*ticks], ticks.values())
        axes.set_yticks((0, 1), ("reader", "writer"))
        axes.set(ylim=(-0.25, 1.25), xlabel="time (ms)")
        axes.margins(x=0.01)
        axes.grid(visible=False)
        for label, color in _KINDS.values():
            axes.plot([], [], color=color, label=label)
        axes.plot([], [], "x", color=COLORS["standard"], label="lost")
        figure.legend(loc="outside lower center", ncols=6, fontsize=8)
        late = "never"
        if outcome.delivered.any():
            late = f"{outcome.latency_ns.max() / 1e6:.1f} ms after it was written"
        title = f"{outcome.delivered.sum()} of {len(outcome.fate)} samples taken, the latest {late}"
        figure.suptitle(title, fontsize=10)


def sentence(frame: AirFrame) -> str:
    """Return the tooltip of a frame: its content, its fate, and the effect of a click."""
    numbers = ", ".join(map(str, frame.samples))
    content = f"{_REPAIR if frame.repairs else _KINDS[frame.kind][0]} {numbers}"
    if frame.kind is Frame.ACKNACK:
        content = f"has all up to {frame.newest}" + (f", asks for {numbers}" if numbers else "")
    elif frame.newest:
        content += f", and a heartbeat: there is up to {frame.newest}"
    fate = "lost; press to let it pass" if frame.lost else "press to lose it"
    return f"{frame.began_ns / 1e6:.2f} ms: {content}; {fate}"


def _draw_frame(axes: Axes, frame: AirFrame, places: NDArray[np.float64]) -> None:
    """Draw a frame from one line to the other, or half the way if it is lost; a piggybacked heartbeat is a dot."""
    kind = Frame.BURST if frame.repairs else frame.kind
    color = COLORS["standard"] if frame.lost else _KINDS[kind][1]
    start = 0.0 if frame.kind is Frame.ACKNACK else 1.0
    end = 0.5 if frame.lost else 1.0 - start
    cross = "x" if frame.lost else ""
    drawn = axes.plot(places, (start, end), marker=cross, markevery=[1], color=color)
    if frame.newest and frame.kind is not Frame.ACKNACK:
        drawn += axes.plot(places[:1], (start,), "o", color="black", markersize=4)
    # A broad line is easier to click than a thin one.
    drawn += axes.plot(places, (start, 1.0 - start), color="white", alpha=0.01, linewidth=7)
    part(frame.name, *drawn)


def _draw_samples(axes: Axes, outcome: FlowOutcome, place_of: Callable[[Any], Any]) -> None:
    """Write the numbers of samples at the times of writing and taking; a sample in red was never taken."""
    style: dict[str, Any] = {"ha": "center", "fontsize": 7}
    numbers = np.arange(1, len(outcome.fate) + 1)
    had = outcome.delivered
    for number, time_ns in zip(numbers, outcome.published_ns, strict=True):
        color = "black" if had[number - 1] else COLORS["standard"]
        axes.text(place_of(time_ns), 1.06, str(number), va="bottom", color=color, **style)
    for time_ns in np.unique(outcome.received_ns[had]):
        taken = numbers[had & (outcome.received_ns == time_ns)]
        text = str(taken[0])
        if len(taken) > 1:
            text += f"-{taken[-1]}"
        axes.text(place_of(time_ns), -0.06, text, va="top", **style)
