"""How often a visualizer may show something.

Pure: the caller passes its clock. Viewers keep what they are sent, and pictures also in graphics memory that no
limit of the viewer covers, so a rate belongs on the sender's side.
"""

from __future__ import annotations

from sfglab.view.errors import SettingError

_NS_PER_S = 1_000_000_000


class RateBudget:
    """Lets at most `max_hz` events a second pass, evenly.

    Events that come in step with the budget pass although they jitter: half a period that an event was late is
    credited to the next one.

    Args:
        max_hz: Events a second; None lets everything pass.

    Attributes:
        dropped: Events that did not pass.
    """

    def __init__(self, max_hz: float | None) -> None:
        self.dropped = 0
        self._max_hz: float | None = None
        self._next_ns: int | None = None
        self.max_hz = max_hz

    @property
    def max_hz(self) -> float | None:
        """Events a second; None lets everything pass. May be changed at any time."""
        return self._max_hz

    @max_hz.setter
    def max_hz(self, value: float | None) -> None:
        if value is not None and not 0 < value < float("inf"):
            raise SettingError("max_hz", given=value, allowed="positive numbers, or None for no limit")
        self._max_hz, self._next_ns = value, None

    def allows(self, now_ns: int) -> bool:
        """Return whether an event may pass now; if not, it is counted as dropped.

        Args:
            now_ns: The caller's clock in nanoseconds; when it runs backwards, counting starts anew.
        """
        if self._max_hz is None:
            return True
        period_ns = round(_NS_PER_S / self._max_hz)
        due_ns = self._next_ns
        if due_ns is None or now_ns < due_ns - 2 * period_ns:
            due_ns = now_ns
        elif now_ns < due_ns - period_ns // 4:
            self.dropped += 1
            return False
        self._next_ns = max(due_ns, now_ns - period_ns // 2) + period_ns
        return True
