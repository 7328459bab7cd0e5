"""The time slider over all waypoints, and playing: as fast as the plan itself, over and over."""

from __future__ import annotations

import threading
import time
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.spatial.scene import ChangeKind, WaypointObject

if TYPE_CHECKING:
    from sfglab.spatial.scene import Change
    from sfglab.view.planner.bench import Bench


_TICK_S = 0.05
_STEP_S = 0.01
_SHORTEST_S = 1.0


class Timeline:
    """The slider and the play button.

    Args:
        bench: What it works with.
        container: A context that widgets are put into.
    """

    def __init__(self, bench: Bench, container: Any) -> None:
        self._bench = bench
        self._stop: threading.Event | None = None
        self._ticker: threading.Thread | None = None
        gui = bench.server.gui
        first, last = self._span()
        with container:
            self._slider = gui.add_slider(
                "time (s)", first, last, _STEP_S, min(max(bench.editor.time_s, first), last)
            )
            self._button = gui.add_button("Play", icon=bench.viser.Icon.PLAYER_PLAY)
        self._slider.on_update(bench.on(bench.editor.set_time, read=lambda e: e.target.value, key="time"))
        self._button.on_click(bench.on(lambda _: self._toggle()))

    def show(self, change: Change) -> None:
        """Show another time, or another span of times."""
        if change.kind is not ChangeKind.TIME and change.kind is not ChangeKind.SELECTION:
            first, last = self._span()
            if (self._slider.min, self._slider.max) != (first, last):
                self._slider.min, self._slider.max = first, last
        shown = min(max(self._bench.editor.time_s, self._slider.min), self._slider.max)
        if abs(self._slider.value - shown) > _STEP_S / 2.0:
            self._slider.value = shown

    def close(self) -> None:
        """Stop playing."""
        if self._stop is not None and self._ticker is not None:
            self._stop.set()
            self._ticker.join()
        self._stop = self._ticker = None

    def _toggle(self) -> None:
        playing = self._stop is not None
        self.close()
        icon = self._bench.viser.Icon
        self._button.label = "Play" if playing else "Pause"
        self._button.icon = icon.PLAYER_PLAY if playing else icon.PLAYER_PAUSE
        if not playing:
            self._stop = threading.Event()
            self._ticker = threading.Thread(
                target=self._play, args=(self._stop,), name="planner-play", daemon=True
            )
            self._ticker.start()

    def _play(self, stop: threading.Event) -> None:
        last = time.monotonic()
        while not stop.wait(_TICK_S):
            now = time.monotonic()
            passed_s, last = now - last, now
            self._bench.desk.submit(partial(self._advance, passed_s), settle=False)

    def _advance(self, passed_s: float) -> None:
        first, end = self._span()
        time_s = self._bench.editor.time_s + passed_s
        self._bench.editor.set_time(time_s if time_s <= end else first)

    def _span(self) -> tuple[float, float]:
        scene = self._bench.editor.scene
        last_ns = max((waypoint.time_ns for waypoint in scene.all_of(WaypointObject)), default=0)
        return (0.0, max(last_ns / 1e9, _SHORTEST_S))
