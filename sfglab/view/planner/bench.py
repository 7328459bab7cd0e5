"""What every part of the editor's window has to hand: viser, its server, the editor and the desk."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Hashable

    from sfglab.spatial.scene import Change, Editor
    from sfglab.view.planner.desk import Desk


class Part(Protocol):
    """A part of the window: it shows what the editor has, and leaves what people want at the desk."""

    def show(self, change: Change) -> None:
        """Show what changed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """What a part works with."""

    viser: Any  #: The library.
    server: Any  #: Its server; what is added to it, every browser shows.
    editor: Editor  #: The scene in work; touched on the desk's thread only.
    desk: Desk  #: The thread.

    def on(
        self,
        job: Callable[[Any], object],
        *,
        read: Callable[[Any], Any] = lambda _: None,
        key: Hashable = None,
    ) -> Callable[[Any], Awaitable[None]]:
        """Return a callback for viser that leaves a job at the desk.

        It is a coroutine: viser awaits those in order, and hands others to a pool that does not keep it.

        Args:
            job: What to do with what was read.
            read: What to read of the event, at once.
            key: As for `Desk.submit`.
        """

        async def called(event: Any) -> None:
            if event.client_id is not None:  # else it is our own assignment
                given = read(event)
                self.desk.submit(lambda: job(given), key=key)

        return called
