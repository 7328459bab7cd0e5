"""The list of conflicts; a click goes to the time and selects whom it concerns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sfglab.spatial.scene import Change, Conflict
    from sfglab.view.planner.bench import Bench


_MOST = 50
# Sentences, not captions: they wrap.
_STYLE = """<style>
div:has(> * > .sfg-warnings) button { height: auto !important; padding: 0.35em 0.6em; }
div:has(> * > .sfg-warnings) .mantine-Button-label { white-space: normal; text-align: left; line-height: 1.3; }
div:has(> * > .sfg-warnings) .mantine-Button-inner { justify-content: flex-start; }
</style><span class="sfg-warnings"></span>"""


class Warnings:
    """The buttons.

    Args:
        bench: What it works with.
        container: A context that widgets are put into.
    """

    def __init__(self, bench: Bench, container: Any) -> None:
        self._bench = bench
        self._container = container
        self._buttons: list[Any] = []
        self._shown: tuple[Conflict, ...] = ()
        with container:
            bench.server.gui.add_html(_STYLE)
            self._head = bench.server.gui.add_markdown("checking …")

    def show(self, change: Change) -> None:
        """Say that what is listed is of an older scene, where it is."""
        if change.changed or change.added or change.removed:
            self._head.content = "checking …"

    def failed(self) -> None:
        """Say that nobody knows what is wrong with the scene."""
        self._head.content = "**not checked**: see the message"

    def found(self, conflicts: tuple[Conflict, ...]) -> None:
        """Show what is wrong with the scene."""
        many = f"{len(conflicts)} conflict" + ("s" if len(conflicts) != 1 else "")
        more = f", the first {_MOST} are listed" if len(conflicts) > _MOST else ""
        self._head.content = f"**{many}**{more}" if conflicts else "no conflicts"
        shown = conflicts[:_MOST]
        if shown == self._shown:
            return
        for button in self._buttons:
            button.remove()
        with self._container:
            self._buttons = [self._add(conflict) for conflict in shown]
        self._shown = shown

    def _add(self, conflict: Conflict) -> Any:
        timed = conflict.time_s is not None
        button = self._bench.server.gui.add_button(conflict.text, color="red" if timed else "orange")
        button.on_click(self._bench.on(lambda _: self._go(conflict)))
        return button

    def _go(self, conflict: Conflict) -> None:
        editor = self._bench.editor
        if conflict.time_s is not None:
            editor.set_time(conflict.time_s)
        editor.select(*(id_ for id_ in conflict.objects if id_ in editor.scene.objects))
