"""Time line of one writer and one reader: samples, heartbeats, ACKNACKs and retransmissions.

It is drawn from the frames that the model of RTPS sent. Each click on a frame and each changed setting starts a
new simulation.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sfglab.fields import between
from sfglab.lab.explore.form import Form
from sfglab.lab.explore.press import Pressed, part
from sfglab.lab.figures import COLORS
from sfglab.qos import QoSProfile
from sfglab.rtps import PRESETS, AirFrame, Flow, FlowOutcome, Frame, Medium, Scenario, trace
from sfglab.units import NS_PER_S
from sfglab.view.widgets import widgets

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FLOW = "a"
_REPAIR, _LOST = "repair", "lost"
_KINDS = {
    Frame.DATA: ("sample", COLORS["proxy"]),
    Frame.BURST: (_REPAIR, COLORS["third"]),
    Frame.HEARTBEAT: ("heartbeat", "black"),
    Frame.ACKNACK: ("request (ACKNACK)", COLORS["fourth"]),
    Frame.GAP: ("GAP: sample not kept", COLORS["network"]),
}
"""Name and colour of each kind of frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Exchange:
    """One writer, one reader, and the wireless channel between them."""

    #: Middleware whose timing is simulated.
    vendor: Literal["fast_dds", "cyclone_dds"] = "fast_dds"
    rate_hz: float = between(20.0, 1.0, 200.0, log=True)  #: Rate of the samples [Hz].
    depth: int = between(8, 1, 50)  #: Depth of each history, samples.
    #: Share of frames that the channel loses beside the clicked ones.
    loss: float = between(0.0, 0.0, 0.5)
    samples: int = between(16, 1, 40)  #: Number of published samples.
    seed: int = 0  #: Seed of the losses.

    def scenario(self) -> Scenario:
        """Return the scenario for the model."""
        qos = QoSProfile(depth=self.depth)
        return Scenario(
            flows=(
                Flow(name=_FLOW, source="robot", target="station", rate_hz=self.rate_hz, qos=qos),
            ),
            medium=Medium(loss=self.loss),
            vendor=PRESETS[self.vendor],
            duration_s=(self.samples - 0.5) / self.rate_hz,
            drain_s=4.0,  # for a periodic heartbeat of Fast DDS and its retransmissions
        )


class Timeline(Pressed):
    """One writer and one reader over time; a click on a frame loses it, a second click delivers it.

    At first, the frames in `lost` are lost; their names are those of `AirFrame.name`.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """

    def __init__(self, lost: Sequence[str] = ("a/DATA/5",), **exchange: Any) -> None:
        kit = widgets()
        #: Whether a clicked frame is lost (True) or delivered (False), by name.
        self.lost = dict.fromkeys(lost, True)
        self.form = Form(Exchange(**exchange), lambda: self.answer(self._simulate))
        self._shown = kit.FloatRangeSlider(
            value=(0, 100), description="shown (%)", layout={"width": "40em"}
        )
        self._to_scale = kit.Checkbox(description="time to scale", indent=False)
        self._simulate()
        above = [self.form.widget, kit.HBox([self._shown, self._to_scale])]
        titles = lambda: {frame.name: sentence(frame) for frame in self.frames}  # noqa: E731
        super().__init__(self.draw, size=(11.0, 4.2), press=self._lose, titles=titles, above=above)
        for control in (self._shown, self._to_scale):
            control.observe(lambda _: self.redraw(), "value")

    def _lose(self, name: str) -> None:
        self.lost[name] = not next(frame.lost for frame in self.frames if frame.name == name)
        self._simulate()

    def _simulate(self) -> None:
        config = self.form.config
        outcome, self.frames = trace(config.scenario(), seed=config.seed, lost=self.lost)
        self.outcome = outcome.flows[_FLOW]

    def draw(self, figure: Figure) -> None:
        """Draw frames between the lines of writer and reader, and the times of samples on both lines."""
        axes, place_of = figure.subplots(), self._places()
        for y in (0, 1):
            axes.axhline(y, color="black", linewidth=0.8)
        for frame in self.frames:
            _draw_frame(axes, frame, (place_of(frame.began_ns), place_of(frame.ended_ns)))
        _draw_samples(axes, self.outcome, place_of)
        end = place_of(self.frames[-1].ended_ns)
        span = [end * share / 100 for share in self._shown.value]
        margin = 0.01 * (span[1] - span[0])
        axes.set(xlim=(span[0] - margin, span[1] + margin), ylim=(-0.25, 1.25), xlabel="time (ms)")
        axes.set_yticks((0, 1), ("reader", "writer"))
        self._draw_times(axes, place_of)
        axes.grid(visible=False)
        for label, color in {**dict(_KINDS.values()), _LOST: COLORS["standard"]}.items():
            axes.plot([], [], "x" if label == _LOST else "-", color=color, label=label)
        figure.legend(loc="outside lower center", ncols=6, fontsize=8)
        had, all_ = int(self.outcome.delivered.sum()), len(self.outcome.fate)
        late = (
            f"{self.outcome.latency_ns.max() / 1e6:.1f} ms after it was written" if had else "never"
        )
        figure.suptitle(f"{had} of {all_} samples taken, the latest {late}", fontsize=10)

    def _places(self) -> Callable[[int], float]:
        """Return a function from a time to its position.

        Distances are the roots of pauses, so that all frames are visible, or the pauses to scale.
        """
        outcome = self.outcome
        ends = [time for frame in self.frames for time in (frame.began_ns, frame.ended_ns)]
        times = np.unique([0, *ends, *outcome.published_ns, *outcome.received_ns])
        pauses = np.diff(times / NS_PER_S, prepend=0.0)
        places = np.cumsum(pauses if self._to_scale.value else np.sqrt(pauses))
        return lambda time_ns: float(np.interp(time_ns, times, places))

    def _draw_times(self, axes: Axes, place_of: Callable[[int], float]) -> None:
        """Label the beginnings of frames with their times, as many as there is room for."""
        low, high = axes.get_xlim()
        places, labels = [low], []
        for frame in self.frames:
            place = place_of(frame.began_ns)
            if place - places[-1] > (high - low) / 18 and place < high:
                places.append(place)
                labels.append(f"{frame.began_ns / 1e6:.4g}")
        axes.set_xticks(places[1:], labels)


def sentence(frame: AirFrame) -> str:
    """Return the tooltip of a frame: its content, its fate, and the effect of a click."""
    numbers = ", ".join(map(str, frame.samples))
    said = f"{_REPAIR if frame.repairs else _KINDS[frame.kind][0]} {numbers}"
    if frame.kind is Frame.ACKNACK:
        said = f"has all up to {frame.newest}" + (f", asks for {numbers}" if numbers else "")
    elif frame.newest:
        said += f", and a heartbeat: there is up to {frame.newest}"
    fate = "lost; press to let it pass" if frame.lost else "press to lose it"
    return f"{frame.began_ns / 1e6:.2f} ms: {said}; {fate}"


def _draw_frame(axes: Axes, frame: AirFrame, places: tuple[float, float]) -> None:
    """Draw a frame from one line to the other, or half the way if it is lost; a piggybacked heartbeat is a dot."""
    kind = Frame.BURST if frame.repairs else frame.kind
    color = COLORS["standard"] if frame.lost else _KINDS[kind][1]
    start = 0.0 if frame.kind is Frame.ACKNACK else 1.0
    end = 0.5 if frame.lost else 1.0 - start
    drawn = axes.plot(places, (start, end), color=color, linewidth=1.4)
    if frame.lost:
        drawn += axes.plot(places[1:], (end,), "x", color=color, markersize=7)
    if frame.newest and frame.kind is not Frame.ACKNACK:
        drawn += axes.plot(places[:1], (start,), "o", color="black", markersize=4)
    # A broad line is easier to click than a thin one.
    drawn += axes.plot(places, (start, 1.0 - start), color="white", alpha=0.01, linewidth=7)
    part(frame.name, *drawn)


def _draw_samples(axes: Axes, outcome: FlowOutcome, place_of: Callable[[int], float]) -> None:
    """Write the numbers of samples at the times of writing and taking; a sample in red was never taken."""
    style: dict[str, Any] = {"ha": "center", "fontsize": 7, "clip_on": True}
    taken: dict[int, list[int]] = defaultdict(list)
    for i, had in enumerate(outcome.delivered):
        color = "black" if had else COLORS["standard"]
        axes.text(
            place_of(outcome.published_ns[i]), 1.06, str(i + 1), va="bottom", color=color, **style
        )
        if had:
            taken[outcome.received_ns[i]].append(i + 1)
    for time_ns, numbers in taken.items():
        said = str(numbers[0]) + (f"-{numbers[-1]}" if len(numbers) > 1 else "")
        axes.text(place_of(time_ns), -0.06, said, va="top", **style)
