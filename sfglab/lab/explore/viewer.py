"""A log or a domain in a cell: Rerun's viewer with a slider for its steps and a still, or a live panel."""

from __future__ import annotations

import asyncio
from bisect import bisect_left, bisect_right
from collections import defaultdict
from contextlib import AsyncExitStack
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from sfglab.bus import Node
from sfglab.bus.address import BusAddress
from sfglab.component import beside, is_set_before
from sfglab.errors import InvalidValueError
from sfglab.lab.explore.press import Bundle, still_bundle
from sfglab.lab.figures import COLORS, drawn, png_of
from sfglab.lab.testbed import held_domains
from sfglab.record import LogReader
from sfglab.units import NS_PER_S
from sfglab.view.app import ViewOptions, session_for, types_of, view_log
from sfglab.view.arrivals import arrivals_of
from sfglab.view.bridge import Bridge
from sfglab.view.cell import ROUNDED_NS, CellViewer
from sfglab.view.panel import Panel
from sfglab.view.rerunning import RECEIVED, cell_canvas
from sfglab.view.session import Session
from sfglab.view.space import largest_tree
from sfglab.view.stage import wanted_topics
from sfglab.view.widgets import button, widgets

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from matplotlib.figure import Figure

    from sfglab.lab.runs import Run

_PERIOD_S = 0.5  #: Time between two counts of messages, s.
_FIRST_S = 30.0  #: Longest time until the first message, s.


class LogViewer:
    """A log in Rerun's viewer with a slider for its steps, and a plot of the times of messages by topic.

    The log is a run, an MCAP file, or a bag. Poses are drawn in the given frame, or else in the root of the log's
    largest TF tree. The first step is the time at which that tree is complete.

    Raises:
        LogError: There is no such file.
        InvalidValueError: The log has no message that a visualizer shows.
        MissingExtraError: The extra ``view`` is not installed.
    """

    def __init__(self, recording: Run[Any] | Path | str, *, frame: str = "") -> None:
        self._log = Path(recording if isinstance(recording, Path | str) else recording.log)
        with LogReader(self._log) as log:
            self._times_ns = _times_by_topic(log)
            tree = largest_tree(log)
        self._frame = frame or tree.root
        #: Time of each step, ns on the log's clock: the times at which the log has messages.
        self.times_ns = np.unique(np.concatenate([*self._times_ns.values()])).tolist()
        complete = bisect_left(self.times_ns, tree.complete_ns)
        is_early = self._frame == tree.root and complete <= len(self.times_ns) // 2
        kit = widgets()
        #: Slider whose value is the requested step.
        self.slider = kit.IntSlider(
            value=complete if is_early else 0,
            max=len(self.times_ns) - 1,
            description="step",
            readout=False,
            layout={"width": "36em"},
        )
        self.slider.observe(lambda _: self._go(), "value")
        self.said = kit.Label()  #: Label with the step that the viewer shows.
        space = kit.Label()
        if self._frame:
            chosen = "" if frame else ", the root of the largest TF tree"
            space.value = f"space is drawn in {self._frame}{chosen}"
        self.still = png_of(drawn((9.6, 1.0 + 0.26 * len(self._times_ns)), self._draw))
        self.viewer = CellViewer(still=self.still, on_page=self._show, on_time=self._shown)
        self.widget = kit.VBox([kit.HBox([self.slider, self.said]), space, self.viewer.widget])

    def _repr_mimebundle_(self, **_: object) -> Bundle:
        return still_bundle(self.widget, self.still, type(self))

    def _draw(self, figure: Figure) -> None:
        """Draw the times of messages by topic."""
        axes = figure.subplots()
        names = []
        times_s = []
        for topic, times_ns in self._times_ns.items():
            names.append(f"{topic} ({len(times_ns)})")
            times_s.append((np.array(times_ns) - self.times_ns[0]) / NS_PER_S)
        axes.eventplot(times_s, colors=COLORS["proxy"], linelengths=0.7, linewidths=0.8)
        axes.set_yticks(range(len(names)), names)
        axes.set(xlabel="time (s)", title="Times of messages per topic (in brackets: their number)")
        axes.grid(visible=False, axis="y")

    @cached_property
    def recording(self) -> bytes:
        """The log in the format of the viewer, ``.rrd``."""
        with TemporaryDirectory(prefix="sfglab-view-") as folder:
            file = Path(folder) / "cell.rrd"
            view_log(self._log, ViewOptions(to=(str(file),), frame=self._frame))
            return file.read_bytes()

    def _show(self) -> None:
        """Send the recording to a page that has the viewer."""
        count = sum(map(len, self._times_ns.values()))
        self.said.value = f"loading {count:,} messages"
        self.viewer.send(self.recording)
        self._go()

    def _go(self) -> None:
        self.viewer.go_to(RECEIVED, self.times_ns[self.slider.value])

    def _shown(self, at_ns: int) -> None:
        step = max(bisect_right(self.times_ns, at_ns + ROUNDED_NS) - 1, 0)
        at_s = (self.times_ns[step] - self.times_ns[0]) / NS_PER_S
        self.said.value = f"shown: step {step} of {len(self.times_ns) - 1}, {at_s:.3f} s"


def _times_by_topic(log: LogReader) -> dict[str, list[int]]:
    """Return the times of messages of each topic that a visualizer shows."""
    wanted = wanted_topics(session_for(types_of(log), ViewOptions()))
    times_ns = defaultdict(list)
    for arrival in arrivals_of(log, wanted):
        times_ns[arrival.topic].append(arrival.received_ns)
    if not times_ns:
        raise InvalidValueError("log", log.path, "a log with messages that a visualizer shows")
    return dict(sorted(times_ns.items(), reverse=True))


class LiveView:
    """A DDS domain in a cell: the panel of displays, Rerun's viewer below it, and a bridge that runs until closed.

    Each topic that a visualizer supports is shown as soon as it is discovered. One view at a time is open: a
    cell that runs again closes the view before.

        live = await LiveView.open(lambda here: run_camera(CameraConfig(places=((here, topic),))))
        live
    """

    _last: ClassVar[LiveView | None] = None

    def __init__(self, node: Node) -> None:
        self.session = Session()
        canvas, viewer = cell_canvas(node.name)
        self.bridge = Bridge(node, self.session, canvas, follow=("/",))
        self.panel = Panel(
            self.session, lambda: {t: k[0] for t, k in node.graph.topics().items() if k}
        )
        loop = asyncio.get_running_loop()
        self.end = button(
            "End",
            lambda: asyncio.run_coroutine_threadsafe(self.close(), loop),
            "End what runs for this view; the viewer keeps what it has",
        )
        self.widget = widgets().VBox([self.end, self.panel.widget, viewer.widget])
        self._runs = AsyncExitStack()
        self._shows = asyncio.Event()

    @classmethod
    async def open(cls, program: Callable[[BusAddress], Coroutine[Any, Any, None]]) -> Self:
        """Return a view whose bridge runs beside a program, on a domain of its own, after the first message."""
        if cls._last is not None:
            await cls._last.close()
        async with AsyncExitStack() as runs:
            [domain_id] = runs.enter_context(held_domains())
            here = BusAddress(domain_id=domain_id, interface="lo")
            live = cls(await runs.enter_async_context(Node("panel", **here.options())))
            await runs.enter_async_context(live.bridge)
            runs.callback(live.panel.close)
            await runs.enter_async_context(beside(live._count(), program(here)))
            await is_set_before(live._shows, asyncio.get_running_loop().time() + _FIRST_S)
            live._runs = runs.pop_all()
        cls._last = live
        return live

    async def close(self) -> None:
        """End the bridge and the programs; further calls have no effect."""
        self.end.disabled = True
        await self._runs.aclose()

    async def _count(self) -> None:
        while True:
            self.panel.refresh()
            if any(display.slot.shown for display in self.session.displays):
                self._shows.set()
            await asyncio.sleep(_PERIOD_S)

    def _repr_mimebundle_(self, **_: object) -> Bundle:
        size = 9.6, 1.4 + 0.4 * len(self.session.displays)
        return still_bundle(self.widget, png_of(drawn(size, self._draw)), self._draw)

    def _draw(self, figure: Figure) -> None:
        """Draw how many messages each display of a live domain has received and shown."""
        axes = figure.subplots()
        for display in self.session.displays:
            name = f"{display.id}\n{', '.join(display.topics.values())}"
            axes.barh(name, display.slot.received, 0.6, color=COLORS["network"])
            axes.barh(name, display.slot.shown, 0.3, color=COLORS["proxy"])
        axes.set_xlabel("number of messages: received (wide, grey), shown (narrow, blue)")
        axes.set_title("Messages of each display when the cell was run; run it for the live viewer")
