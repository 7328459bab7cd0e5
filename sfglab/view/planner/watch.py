"""Conflicts, found in a thread of their own once nobody has changed the scene for a moment.

A crowded scene takes seconds; a drag must not. Scenes are values, so nothing is locked while one is checked.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from sfglab.spatial.scene import conflicts

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.spatial.scene import Conflict, Scene


class ConflictWatch:
    """Checks the newest scene that it was shown, and leaves out those between.

    Args:
        found: Told, on the watch's thread, of a scene and what is wrong with it.
        failed: Told, on the watch's thread, why a scene could not be checked.
        quiet_s: How long a scene must have been the newest.
        check: How conflicts are found.
    """

    def __init__(
        self,
        found: Callable[[Scene, tuple[Conflict, ...]], None],
        failed: Callable[[Exception], None],
        *,
        quiet_s: float = 0.25,
        check: Callable[[Scene], tuple[Conflict, ...]] = conflicts,
    ) -> None:
        self._found = found
        self._failed = failed
        self._quiet_s = quiet_s
        self._check = check
        self._wake = threading.Condition()
        self._newest: Scene | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="planner-conflicts", daemon=True)
        self._thread.start()

    def look(self, scene: Scene) -> None:
        """Have a scene checked."""
        with self._wake:
            self._newest = scene
            self._wake.notify()

    def close(self) -> None:
        """End; a check that goes on is let run out, and nobody hears of it."""
        with self._wake:
            self._closed = True
            self._wake.notify()
        self._thread.join(timeout=self._quiet_s)

    def _work(self) -> None:
        while (scene := self._next()) is not None:
            try:
                found = self._check(scene)
            except Exception as error:  # noqa: BLE001 - one scene that cannot be checked must not end the watch
                if not self._closed:
                    self._failed(error)
                continue
            if not self._closed:
                self._found(scene, found)

    def _next(self) -> Scene | None:
        """Return the newest scene once it has been the newest for a while; None at the end."""
        with self._wake:
            while not self._closed:
                scene = self._newest
                self._wake.wait(None if scene is None else self._quiet_s)
                if scene is not None and scene is self._newest and not self._closed:
                    self._newest = None
                    return scene
            return None
