"""What can go wrong in a simulation, apart from what can go wrong on any bus."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.bus.errors import BusError

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Iterable


_SHOWN_TASKS = 5


class SimulationError(BusError, RuntimeError):
    """The root of what can go wrong only in a simulation."""


class DeadlockError(SimulationError):
    """Everybody waits and nothing is scheduled, so nothing will ever happen again.

    Attributes:
        time_s: The virtual time, in seconds since the start.
        waiting: Names and places of the tasks that wait, at most five.
    """

    def __init__(self, time_s: float, tasks: Iterable[asyncio.Task[object]]) -> None:
        self.time_s = time_s
        self.waiting = _places(tasks)
        super().__init__(
            f"virtual time {time_s:g} s: nothing is scheduled and nobody is done; waiting are "
            f"{'; '.join(self.waiting)}"
        )


class TimeLimitError(SimulationError, TimeoutError):
    """The simulation was not done at its virtual time limit.

    Attributes:
        limit_s: The limit, in virtual seconds since the start.
        waiting: Names and places of the tasks that wait, at most five.
    """

    def __init__(self, limit_s: float, tasks: Iterable[asyncio.Task[object]]) -> None:
        self.limit_s = limit_s
        self.waiting = _places(tasks)
        super().__init__(f"not done after {limit_s:g} s of virtual time; waiting are {'; '.join(self.waiting)}")


class NotSimulatedError(SimulationError, NotImplementedError):
    """Something that a simulated world does not have.

    Attributes:
        what: The thing.
    """

    def __init__(self, what: str) -> None:
        self.what = what
        super().__init__(f"{what} does not exist in a simulated world: it would not be reproducible")


class WorldError(SimulationError, ValueError):
    """A world, host or link that cannot be as asked."""


def _places(tasks: Iterable[asyncio.Task[object]]) -> tuple[str, ...]:
    first = sorted((task for task in tasks if not task.done()), key=hash)[:_SHOWN_TASKS]
    return tuple(f"{task.get_name()}{_place(task.get_coro())}" for task in first)


def _place(coroutine: Any) -> str:
    """Return where a suspended coroutine waits: the innermost function that it awaits."""
    while getattr(inner := getattr(coroutine, "cr_await", None), "cr_frame", None) is not None:
        coroutine = inner
    frame = getattr(coroutine, "cr_frame", None)
    return "" if frame is None else f" in {frame.f_code.co_qualname}, line {frame.f_lineno}"
