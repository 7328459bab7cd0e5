"""What consumers that come late still hear: the last events, so the news of every agent must be among them.

Pure: counts events; refuses to know what they say.
"""

from __future__ import annotations

from collections import deque


class History:
    """The agents of the last events.

    Args:
        depth: How many events are kept for consumers that come late. With more agents than that, what is
            repeated pushes out what has to be repeated.
    """

    def __init__(self, depth: int) -> None:
        self._window: deque[str] = deque(maxlen=depth)
        self._events_of: dict[str, int] = {}

    def published(self, agent: str) -> str | None:
        """Take note of one more event.

        Args:
            agent: Whom it is about.

        Returns:
            The agent whose last event has just been pushed out, and has to be repeated if it is there.
        """
        pushed_out = self._window[0] if len(self._window) == self._window.maxlen else None
        self._window.append(agent)
        self._events_of[agent] = self._events_of.get(agent, 0) + 1
        if pushed_out is None:
            return None
        self._events_of[pushed_out] -= 1
        if self._events_of[pushed_out]:
            return None
        del self._events_of[pushed_out]
        return pushed_out
