"""A log or a domain in a cell: Rerun's viewer, paused, with a slider for its steps; live with the panel above.

The slider needs no mouse, and the sentence beside it says which step the viewer itself shows. What is committed
is a still: which topic spoke when. Refuses to know messages.
"""

from __future__ import annotations

import asyncio
from bisect import bisect_right
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Self

from sfglab.errors import InvalidValueError
from sfglab.lab.explore.press import still_bundle
from sfglab.lab.figures import COLORS, house_style, png_of
from sfglab.units import NS_PER_S
from sfglab.view.app import ViewOptions, session_for, view_log
from sfglab.view.arrivals import open_log
from sfglab.view.bridge import Bridge
from sfglab.view.cell import CellViewer
from sfglab.view.panel import Panel
from sfglab.view.rerunning import NOTEBOOK, RECEIVED, open_canvas
from sfglab.view.session import Session
from sfglab.view.stage import wanted_topics
from sfglab.view.widgets import widgets

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from sfglab.bus import Node
    from sfglab.lab.runs import Run

_PERIOD_S = 0.5
_ROUNDED_NS = 256
"""The viewer tells its time as a float: nanoseconds since 1970 are multiples of 256 there."""


def viewer(recording: Run[Any] | Path | str, *, frame: str = "") -> LogViewer:
    """Show a run or a log, also one of your own, in Rerun's viewer in the cell.

    Args:
        recording: A run, an MCAP file, or a bag that rosbags reads.
        frame: The frame in which space is drawn; empty: the viewer's choice.

    Raises:
        LogError: There is no such file.
        InvalidValueError: It holds no message that a visualizer shows.
        MissingExtraError: The extra ``view`` is not installed.
    """
    return LogViewer(Path(recording if isinstance(recording, Path | str) else recording.log), frame)


class LogViewer:
    """What `viewer` shows: a slider of steps, each a time at which the log has messages, above the viewer.

    Attributes:
        times_ns: The time of each step, on the log's clock.
        slider: Its value is the step that is asked for.
        said: Its value says which step the viewer shows.
    """

    def __init__(self, log: Path, frame: str) -> None:
        self._log, self._frame = log, frame
        self._spoken = _spoken(log)
        self.times_ns = sorted({t for times in self._spoken.values() for t in times})
        kit = widgets()
        wide = {"width": "36em"}
        self.slider = kit.IntSlider(max=len(self.times_ns) - 1, description="step", readout=False, layout=wide)
        self.slider.observe(lambda change: self._go(change["new"]), "value")
        self.said = kit.Label()
        self.viewer = CellViewer(still=self.still, on_page=self._show, on_time=self._shown)
        self.widget = kit.VBox([kit.HBox([self.slider, self.said]), self.viewer.widget])

    def _repr_mimebundle_(self, **_: object) -> dict[str, Any]:
        return still_bundle(self.widget, self.still)

    @cached_property
    def still(self) -> bytes:
        """Which topic has messages when, PNG."""
        return png_of(_timeline(self._spoken, self.times_ns[0]))

    @cached_property
    def recording(self) -> bytes:
        """The log as the viewer has it, ``.rrd``."""
        with TemporaryDirectory(prefix="sfglab-view-") as folder:
            file = Path(folder) / "cell.rrd"
            view_log(self._log, ViewOptions(to=(str(file),), frame=self._frame))
            return file.read_bytes()

    def _show(self) -> None:
        self.viewer.send(self.recording)
        self._go(self.slider.value)

    def _go(self, step: int) -> None:
        self.viewer.go_to(RECEIVED, self.times_ns[step])

    def _shown(self, at_ns: int) -> None:
        step = max(bisect_right(self.times_ns, at_ns + _ROUNDED_NS) - 1, 0)
        at_s = (self.times_ns[step] - self.times_ns[0]) / NS_PER_S
        self.said.value = f"shown: step {step} of {len(self.times_ns) - 1}, {at_s:.3f} s"


def _spoken(log: Path) -> dict[str, list[int]]:
    """Return when each topic that can be shown has messages."""
    with open_log(log) as opened:
        wanted = wanted_topics(session_for(opened.topics, ViewOptions()))
        spoken: dict[str, list[int]] = {}
        for arrival in opened.arrivals(wanted):
            spoken.setdefault(arrival.topic, []).append(arrival.received_ns)
    if not spoken:
        raise InvalidValueError("log", log, "one with messages that a visualizer shows")
    return dict(sorted(spoken.items(), reverse=True))


def _timeline(spoken: Mapping[str, Sequence[int]], start_ns: int) -> Any:
    from matplotlib.figure import Figure

    with house_style():
        figure = Figure(figsize=(9.6, 1.0 + 0.26 * len(spoken)))
        axes = figure.subplots()
        times = [[(t - start_ns) / NS_PER_S for t in topic] for topic in spoken.values()]
        axes.eventplot(times, colors=COLORS["proxy"], linelengths=0.7, linewidths=0.8)
        axes.set_yticks(range(len(spoken)), [f"{topic} ({len(t)})" for topic, t in spoken.items()])
        axes.set(xlabel="time (s)", title="What the recording holds: a line for each message")
        axes.grid(visible=False, axis="y")
    return figure


class LiveView:
    """The bus in a cell: the panel above, the viewer below, a running bridge between them, until closed.

    Every topic that a visualizer offers itself for is shown as soon as it is heard of.

        live = await LiveView.open(node)
        live

    Args:
        node: On the domain to look at; it stays open.
    """

    def __init__(self, node: Node) -> None:
        self.session = Session()
        canvas = open_canvas([NOTEBOOK], title=node.name)
        self.viewer = canvas.in_cell()
        self.bridge = Bridge(node, self.session, canvas, follow=("/",))
        self.panel = Panel(self.session, lambda: {t: k[0] for t, k in node.graph.topics().items() if k})
        self.widget = widgets().VBox([self.panel.widget, self.viewer.widget])
        self._counting: asyncio.Task[None] | None = None

    @classmethod
    async def open(cls, node: Node) -> Self:
        """Return one whose bridge runs.

        Raises:
            MissingExtraError: The extra ``view`` is not installed.
        """
        live = cls(node)
        await live.bridge.__aenter__()
        live._counting = asyncio.create_task(live._count())
        return live

    async def close(self) -> None:
        """End the bridge; harmless when repeated."""
        if self._counting is not None:
            self._counting.cancel()
        self.panel.close()
        await self.bridge.close()

    async def _count(self) -> None:
        while True:
            await asyncio.sleep(_PERIOD_S)
            self.panel.refresh()

    def _repr_mimebundle_(self, **_: object) -> dict[str, Any]:
        said = "<p>Live: the panel, and what the bus says in the viewer, where a kernel runs.</p>"
        return still_bundle(self.widget, b"") | {"text/html": said}
