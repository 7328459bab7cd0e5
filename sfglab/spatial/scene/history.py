"""Undo and redo.

Every step keeps the scene before and after it. Scenes share what does not change, so a step costs little, and
undoing is going back to a value: a removed subtree returns with its ids, its order and all that referred to it.
Refuses to know what an edit does.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sfglab.spatial.scene.commands import Command
    from sfglab.spatial.scene.tree import Scene


_DEPTH = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """An edit that was done."""

    label: str  #: What it did.
    before: Scene  #: The scene before it.
    after: Scene  #: The scene after it.
    drag: str | None = None  #: The drag that it belongs to; None for an edit of its own.


class History:
    """A scene and the way it came about.

    Args:
        scene: Where to begin.
        depth: How many steps can be undone; older ones are forgotten.

    Attributes:
        scene: As it is now.
    """

    def __init__(self, scene: Scene, *, depth: int = _DEPTH) -> None:
        self.scene = scene
        self._done: deque[Step] = deque(maxlen=depth)
        self._undone: list[Step] = []
        self._dropped: list[Step] = []
        self._next_id = scene.next_id

    @property
    def next_id(self) -> int:
        """An id that no object ever had here, also none whose addition was undone."""
        return self._next_id

    @property
    def undo_label(self) -> str | None:
        """What undo would take back, None where there is nothing."""
        return self._done[-1].label if self._done else None

    @property
    def redo_label(self) -> str | None:
        """What redo would do again, None where there is nothing."""
        return self._undone[-1].label if self._undone else None

    def do(self, command: Command, *, drag: str | None = None) -> bool:
        """Do an edit; what was undone can then no longer be redone, unless a drag ends where it began.

        Args:
            command: The edit.
            drag: A name that is new for every drag; edits of one drag become one step.

        Returns:
            Whether anything changed. An edit that changes nothing leaves no step.

        Raises:
            SceneError: It is not allowed; nothing changed.
        """
        before, after = self.scene, command.apply(self.scene)
        if after == before:
            return False
        label = command.label
        if drag is not None and self._done and self._done[-1].drag == drag:
            first = self._done.pop()
            before, label = first.before, first.label
        else:
            self._dropped = self._undone
        if after == before:  # a drag came back to where it began, as if it had never been
            after, self._undone = before, self._dropped
        else:
            self._done.append(Step(label=label, before=before, after=after, drag=drag))
            self._undone = []
        self.scene = after
        self._next_id = max(self._next_id, after.next_id)
        return True

    def undo(self) -> Step | None:
        """Take the last step back; return it, or None where there is nothing."""
        if not self._done:
            return None
        step = self._done.pop()
        self._undone.append(replace(step, drag=None))  # what is done again belongs to no drag
        self.scene = step.before
        return step

    def redo(self) -> Step | None:
        """Do the last undone step again; return it, or None where there is nothing."""
        if not self._undone:
            return None
        step = self._undone.pop()
        self._done.append(step)
        self.scene = step.after
        return step
