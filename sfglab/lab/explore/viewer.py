"""A log or a domain in a cell: Rerun's viewer with a slider for its steps and a still, or a live panel."""

from __future__ import annotations

import asyncio
from bisect import bisect_left, bisect_right
from contextlib import AsyncExitStack
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, ClassVar, Self

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
from sfglab.view.session import Display, Session
from sfglab.view.space import Tree, largest_tree
from sfglab.view.stage import wanted_topics
from sfglab.view.widgets import button, widgets

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Mapping, Sequence

    from matplotlib.figure import Figure

    from sfglab.lab.runs import Run

_PERIOD_S = 0.5  #: Time between two counts of messages, s.
_FIRST_S = 30.0  #: Longest time until the first message, s.


class LogViewer:
    """A log in Rerun's viewer with a slider for its steps, and a plot of the times of messages by topic.

    It shows a run, an MCAP file, or a bag that rosbags reads. Poses are drawn in the frame that is given,
    otherwise in the root of the log's largest TF tree. The first step is the one where that tree is complete.

    Raises:
        LogError: There is no such file.
        InvalidValueError: It holds no message that a visualizer shows.
        MissingExtraError: The extra ``view`` is not installed.
    """

    def __init__(self, recording: Run[Any] | Path | str, *, frame: str = "") -> None:
        self._log = Path(recording if isinstance(recording, Path | str) else recording.log)
        with LogReader(self._log) as log:
            self._spoken = _spoken(log)
            tree = largest_tree(log)
        self._frame = frame or tree.root
        #: The time of each step on the log's clock: those at which the log has messages.
        self.times_ns = sorted({t for times in self._spoken.values() for t in times})
        kit = widgets()
        wide = {"width": "36em"}
        #: Slider whose value is the requested step.
        self.slider = kit.IntSlider(
            value=self._step_of(tree) if self._frame == tree.root else 0,
            max=len(self.times_ns) - 1,
            description="step",
            readout=False,
            layout=wide,
        )
        self.slider.observe(lambda change: self._go(change["new"]), "value")
        self.said = kit.Label()  #: Label with the step that the viewer shows.
        chosen = "" if frame or not self._frame else ", the root of the largest TF tree"
        space = kit.Label(f"space is drawn in {self._frame}{chosen}" if self._frame else "")
        self.viewer = CellViewer(still=self.still, on_page=self._show, on_time=self._shown)
        self.widget = kit.VBox([kit.HBox([self.slider, self.said]), space, self.viewer.widget])

    def _repr_mimebundle_(self, **_: object) -> Bundle:
        return still_bundle(self.widget, self.still, type(self))

    @cached_property
    def still(self) -> bytes:
        """Plot of the times of messages by topic, PNG."""
        size = 9.6, 1.0 + 0.26 * len(self._spoken)
        return png_of(drawn(size, _draw_spoken, self._spoken, self.times_ns[0]))

    @cached_property
    def recording(self) -> bytes:
        """The log in the format of the viewer, ``.rrd``."""
        with TemporaryDirectory(prefix="sfglab-view-") as folder:
            file = Path(folder) / "cell.rrd"
            view_log(self._log, ViewOptions(to=(str(file),), frame=self._frame))
            return file.read_bytes()

    def _step_of(self, tree: Tree) -> int:
        """Return the step where a tree is complete; 0 if that is in the second half of the log."""
        step = bisect_left(self.times_ns, tree.complete_ns)
        return step if step <= len(self.times_ns) // 2 else 0

    def _show(self) -> None:
        count = sum(map(len, self._spoken.values()))
        self.said.value = f"loading {count:,} messages"
        self.viewer.send(self.recording)
        self._go(self.slider.value)

    def _go(self, step: int) -> None:
        self.viewer.go_to(RECEIVED, self.times_ns[step])

    def _shown(self, at_ns: int) -> None:
        step = max(bisect_right(self.times_ns, at_ns + ROUNDED_NS) - 1, 0)
        at_s = (self.times_ns[step] - self.times_ns[0]) / NS_PER_S
        self.said.value = f"shown: step {step} of {len(self.times_ns) - 1}, {at_s:.3f} s"


def _spoken(log: LogReader) -> dict[str, list[int]]:
    """Return the times of messages of each topic that a visualizer shows."""
    wanted = wanted_topics(session_for(types_of(log), ViewOptions()))
    spoken: dict[str, list[int]] = {}
    for arrival in arrivals_of(log, wanted):
        spoken.setdefault(arrival.topic, []).append(arrival.received_ns)
    if not spoken:
        raise InvalidValueError("log", log.path, "one with messages that a visualizer shows")
    return dict(sorted(spoken.items(), reverse=True))


def _draw_spoken(figure: Figure, spoken: Mapping[str, Sequence[int]], start_ns: int) -> None:
    axes = figure.subplots()
    times = [[(t - start_ns) / NS_PER_S for t in topic] for topic in spoken.values()]
    axes.eventplot(times, colors=COLORS["proxy"], linelengths=0.7, linewidths=0.8)
    axes.set_yticks(range(len(spoken)), [f"{topic} ({len(t)})" for topic, t in spoken.items()])
    axes.set(xlabel="time (s)", title="What the recording holds: a line for each message")
    axes.grid(visible=False, axis="y")


class LiveView:
    """A DDS domain in a cell: the panel of displays, Rerun's viewer below it, and a bridge that runs until closed.

    Each topic that a visualizer supports is shown as soon as it is discovered. One view at a time is open: a
    cell that runs again closes the view before.

        live = await LiveView.open(lambda here: run_camera(CameraConfig(places=((here, topic),))))
        live
    """

    _last: ClassVar[LiveView | None] = None

    def __init__(self, node: Node) -> None:
        self.session, kit = Session(), widgets()
        canvas, self.viewer = cell_canvas(node.name)
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
        self.widget = kit.VBox([self.end, self.panel.widget, self.viewer.widget])
        self._runs, self._shows = AsyncExitStack(), asyncio.Event()

    @classmethod
    async def open(cls, *programs: Callable[[BusAddress], Coroutine[Any, Any, None]]) -> Self:
        """Return a view whose bridge runs beside programs, on a domain of its own, after the first message."""
        if cls._last is not None:
            await cls._last.close()
        async with AsyncExitStack() as runs:
            [domain_id] = runs.enter_context(held_domains())
            here = BusAddress(domain_id=domain_id, interface="lo")
            live = cls(await runs.enter_async_context(Node("panel", **here.options())))
            await runs.enter_async_context(live.bridge)
            runs.callback(live.panel.close)
            await runs.enter_async_context(
                beside(live._count(), *(program(here) for program in programs))
            )
            if programs:
                await is_set_before(live._shows, asyncio.get_running_loop().time() + _FIRST_S)
            live._runs = runs.pop_all()
        cls._last = live
        return live

    async def close(self) -> None:
        """End the bridge and the programs; harmless when repeated."""
        self.end.disabled = True
        await self._runs.aclose()

    async def _count(self) -> None:
        while True:
            self.panel.refresh()
            if any(display.slot.shown for display in self.session.displays):
                self._shows.set()
            await asyncio.sleep(_PERIOD_S)

    def _repr_mimebundle_(self, **_: object) -> Bundle:
        displays = self.session.displays
        figure = drawn((9.6, 1.4 + 0.4 * len(displays)), _draw_counts, displays)
        return still_bundle(self.widget, png_of(figure), _draw_counts)


def _draw_counts(figure: Figure, displays: Sequence[Display]) -> None:
    """Draw how many messages each display of a live domain has received and shown."""
    axes = figure.subplots()
    names = [f"{display.id}\n{', '.join(display.topics.values())}" for display in displays]
    received = [display.slot.received for display in displays]
    shown = [display.slot.shown for display in displays]
    axes.barh(names, received, 0.6, color=COLORS["network"], label="received")
    axes.barh(names, shown, 0.3, color=COLORS["proxy"], label="shown")
    axes.set(
        xlabel="messages",
        title="Live: what the displays had when this cell was shown; run it to look",
    )
    figure.legend(loc="outside lower center", ncols=2, fontsize=8)
