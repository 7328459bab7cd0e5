"""Undo and redo: the scenes before and after each step. Going back is going back to a value."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sfglab.spatial.scene.tree import Scene

_DEPTH = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """A step that was done."""

    label: str  #: Words for the undo button.
    before: Scene  #: Scene before it.
    after: Scene  #: Scene after it.
    drag: int | None = None  #: Number of the drag that it belongs to; None: a step of its own.


class History:
    """A scene and its last steps, which can be undone."""

    def __init__(self, scene: Scene, *, depth: int = _DEPTH) -> None:
        self.scene = scene  #: Current scene.
        self._done: deque[Step] = deque(maxlen=depth)
        self._undone: list[Step] = []
        self._dropped: list[Step] = []
        #: Id that no object ever had, including those whose addition was undone.
        self.next_id = scene.next_id

    @property
    def undo_label(self) -> str | None:
        """Label of the step that undo takes back; None: there is none."""
        return self._done[-1].label if self._done else None

    @property
    def redo_label(self) -> str | None:
        """Label of the step that redo does again; None: there is none."""
        return self._undone[-1].label if self._undone else None

    def do(self, label: str, after: Scene, *, drag: int | None = None) -> bool:
        """Go on to another scene; return whether it differs. Steps of one drag are joined.

        Undone steps can then no longer be redone, unless a drag ends where it began.
        """
        before = self.scene
        if after == before:
            return False
        if drag is not None and self._done and self._done[-1].drag == drag:
            first = self._done.pop()
            before, label = first.before, first.label
        else:
            self._dropped = self._undone
        if after == before:  # the drag came back to its beginning
            after, self._undone = before, self._dropped
        else:
            self._done.append(Step(label=label, before=before, after=after, drag=drag))
            self._undone = []
        self.scene = after
        self.next_id = max(self.next_id, after.next_id)
        return True

    def undo(self) -> Step | None:
        """Take the last step back; return it, or None if there is none."""
        if not self._done:
            return None
        step = self._done.pop()
        self._undone.append(replace(step, drag=None))
        self.scene = step.before
        return step

    def redo(self) -> Step | None:
        """Do the last undone step again; return it, or None if there is none."""
        if not self._undone:
            return None
        step = self._undone.pop()
        self._done.append(step)
        self.scene = step.after
        return step
