"""Asyncio loop with virtual time and the event list of the world, and errors of a simulation.

When no callback is ready, the clock jumps to the next timer or event. Callbacks that are due at one instant run
in the order of scheduling. Tasks hash by the order of their creation, so that sets of tasks have the same order
in every run. There are neither threads nor sockets, so nothing outside can wake the loop.
"""

from __future__ import annotations

import asyncio
import heapq
from itertools import count
from typing import TYPE_CHECKING, Any, NoReturn

from sfglab.bus.errors import BusError
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterable

_SHOWN_TASKS = 5

#: Start of virtual time: 2026-01-01, Unix time in nanoseconds.
START_NS = 1_767_225_600_000_000_000
NEVER_NS = 2**62  #: Time later than every time of a simulation, ns.
_Event = tuple[int, int, "Callable[..., None]", tuple[Any, ...]]


class DeadlockError(BusError, RuntimeError):
    """All tasks wait and nothing is scheduled, so the simulation can never continue."""

    def __init__(self, time_s: float, tasks: Iterable[asyncio.Task[object]]) -> None:
        said = f"no event is scheduled, so no task can continue; waiting tasks: {_places(tasks)}"
        super().__init__(f"virtual time {time_s:g} s: {said}")


class TimeLimitError(BusError, TimeoutError):
    """The simulation did not end before its limit of virtual time."""

    def __init__(self, limit_s: float, tasks: Iterable[asyncio.Task[object]]) -> None:
        said = f"the simulation did not end within {limit_s:g} s of virtual time; waiting tasks: {_places(tasks)}"
        super().__init__(said)


def _places(tasks: Iterable[asyncio.Task[object]]) -> str:
    """Return the names and places of at most five waiting tasks."""
    first = sorted((task for task in tasks if not task.done()), key=hash)[:_SHOWN_TASKS]
    return "; ".join(f"{task.get_name()}{_place(task.get_coro())}" for task in first)


def _place(coroutine: Any) -> str:
    """Return where a suspended coroutine waits: the innermost function that it awaits."""
    while getattr(inner := getattr(coroutine, "cr_await", None), "cr_frame", None) is not None:
        coroutine = inner
    frame = getattr(coroutine, "cr_frame", None)
    return "" if frame is None else f" in {frame.f_code.co_qualname}, line {frame.f_lineno}"


class VirtualLoop(asyncio.BaseEventLoop):
    """Loop that runs coroutines in virtual time, up to a limit if there is one; `time` starts at 0 s."""

    def __init__(self, limit_s: float | None = None) -> None:
        super().__init__()
        self.now_ns = 0  #: Virtual time since the start, ns.
        self._limit_ns = None if limit_s is None else round(limit_s * NS_PER_S)
        self._schedule: list[_Event] = []
        self._numbers = count()
        self._task_numbers = count()
        # `BaseEventLoop` calls `_selector` to wait, and treats times within `_clock_resolution` as equal.
        self._selector = self
        self._clock_resolution = 1 / NS_PER_S
        self._scheduled: list[asyncio.TimerHandle] = []
        self.set_task_factory(_new_task)  # type: ignore[arg-type]  # called with keywords the stub leaves out

    def time(self) -> float:
        """Return the virtual time since the start, in seconds."""
        return self.now_ns / NS_PER_S

    def at(self, time_ns: int, function: Callable[..., None], *arguments: Any) -> None:
        """Call a function at a virtual time; if that is past, now."""
        time_ns = max(time_ns, self.now_ns)
        heapq.heappush(self._schedule, (time_ns, next(self._numbers), function, arguments))

    def new_task_number(self) -> int:
        """Return the number of the next task, from 0."""
        return next(self._task_numbers)

    def select(self, timeout_s: float | None) -> list[_Event]:
        """Advance the clock to the next timer or event; return the events that are due then.

        Raises:
            DeadlockError: All tasks wait and nothing is scheduled.
        """
        schedule = self._schedule
        if timeout_s is None and not schedule:
            raise DeadlockError(self.time(), asyncio.all_tasks(self))
        next_ns = self.now_ns if timeout_s == 0 else self._next_timer_ns()
        if schedule and schedule[0][0] < next_ns:
            next_ns = schedule[0][0]
        if self._limit_ns is not None and next_ns > self._limit_ns:
            self._give_up()
        self.now_ns = next_ns
        due = []
        while schedule and schedule[0][0] <= next_ns:
            due.append(heapq.heappop(schedule))
        return due

    def _next_timer_ns(self) -> int:
        """Return the first nanosecond not before the next timer, because an early task would wait again."""
        if not self._scheduled:
            return NEVER_NS
        when_s = self._scheduled[0].when()
        when_ns = max(self.now_ns, round(when_s * NS_PER_S))
        return when_ns + (when_ns / NS_PER_S < when_s)

    def _process_events(self, event_list: list[_Event]) -> None:
        for _, _, function, arguments in event_list:
            function(*arguments)

    def _give_up(self) -> None:
        assert self._limit_ns is not None
        limit_s = self._limit_ns / NS_PER_S
        self._limit_ns = None  # the cancellation of the tasks needs the loop
        raise TimeLimitError(limit_s, asyncio.all_tasks(self))

    def run_in_executor(self, *_arguments: Any) -> NoReturn:  # type: ignore[override]
        """Refuse work for a thread, because it would take no virtual time and could not wake the loop.

        Raises:
            BusError: Always.
        """
        what = "a thread (run_in_executor, to_thread)"
        raise BusError(
            f"{what} is not available in a simulated world, which must be reproducible; call the function itself"
        )

    def _write_to_self(self) -> None:
        """Do nothing, because the loop never sleeps."""

    def close(self) -> None:
        """Remove all events and close the loop."""
        self._schedule.clear()
        super().close()


class _Task(asyncio.Task[Any]):
    """Task that hashes by its number instead of its address."""

    number = 0

    def __hash__(self) -> int:
        return self.number


def _new_task(
    loop: asyncio.AbstractEventLoop, coroutine: Coroutine[Any, Any, Any], context: Any = None
) -> asyncio.Task[Any]:
    assert isinstance(loop, VirtualLoop)
    task = _Task.__new__(_Task)
    task.number = loop.new_task_number()  # before `__init__`, which puts the task into a set
    task.__init__(coroutine, loop=loop, context=context)  # type: ignore[misc]
    return task
