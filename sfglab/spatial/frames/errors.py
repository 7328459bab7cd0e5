"""What can go wrong with frames, each with the data that it is about."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Sequence


class FrameError(SfglabError):
    """A transform that cannot be had, or cannot be taken."""


class FrameInputError(FrameError, ValueError):
    """A name that no frame can have, or a setting that no buffer can.

    Attributes:
        place: Where it stands.
        given: What was given.
    """

    def __init__(self, place: str, given: object, allowed: str) -> None:
        self.place = place
        self.given = given
        super().__init__(f"{place}: given {given!r}, allowed are {allowed}")


class UnknownFrameError(FrameError, LookupError):
    """A frame that nobody has placed and in which nobody has placed anything.

    Attributes:
        frame: As asked for.
        near: Known names that look similar, best first.
    """

    def __init__(self, frame: str, *, near: Sequence[str], known: int) -> None:
        self.frame = frame
        self.near = tuple(near)
        hint = f"did you mean {', '.join(map(repr, near))}?" if near else f"{known} frames are known"
        super().__init__(f"frame {frame!r} is unknown: {hint}")


class NotConnectedError(FrameError, LookupError):
    """Two frames that stand in different trees.

    Attributes:
        target: One frame.
        source: The other one.
        target_root: The root above the first.
        source_root: The root above the other.
    """

    def __init__(self, target: str, source: str, *, target_root: str, source_root: str) -> None:
        self.target = target
        self.source = source
        self.target_root = target_root
        self.source_root = source_root
        super().__init__(
            f"frames {target!r} and {source!r} are not connected: the first stands below the root "
            f"{target_root!r}, the other one below {source_root!r}"
        )


class ExtrapolationError(FrameError, LookupError):
    """A time for which the transforms on the way are not known.

    Attributes:
        frame: The frame on the way whose transform is missing.
        time_ns: The time asked for.
        first_ns: From when that frame's transform is known; None if it never was.
        last_ns: Until when.
    """

    def __init__(  # noqa: PLR0913 - each of them is in the message
        self, target: str, source: str, *, frame: str, time_ns: int, first_ns: int | None, last_ns: int | None
    ) -> None:
        self.frame = frame
        self.time_ns = time_ns
        self.first_ns = first_ns
        self.last_ns = last_ns
        known = "never" if first_ns is None else f"from {first_ns} to {last_ns} ns{self._by_how_much()}"
        super().__init__(
            f"{target!r} from {source!r} at {time_ns} ns: the transform of {frame!r} is known {known}; "
            "wait, ask for a time within, or allow extrapolation"
        )

    def _by_how_much(self) -> str:
        assert self.first_ns is not None
        assert self.last_ns is not None
        off_ns = max(self.first_ns - self.time_ns, self.time_ns - self.last_ns)
        return f" ({off_ns / 1e6:.3f} ms {'before' if self.time_ns < self.first_ns else 'after'} that)"


class FrameLoopError(FrameError, ValueError):
    """A transform that would place a frame below itself.

    Attributes:
        loop: The frames, from the child up to itself again.
    """

    def __init__(self, loop: Sequence[str]) -> None:
        self.loop = tuple(loop)
        super().__init__(f"frame {loop[0]!r} would stand below itself: {' -> '.join(loop)} (child -> parent)")
