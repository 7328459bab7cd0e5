"""The process of a component, as the component sees it: configuration, orders, reports and end.

A component is started as ``python -m MODULE CONFIG``. CONFIG is its configuration, a dataclass, as JSON. It reads
orders from standard input and writes reports to standard output, one JSON object per line. Each report names its
kind: ``{"is": "ready"}`` once the component serves, ``{"is": "failed", "why": ...}`` before it gives up. The
component ends when its standard input ends, hence with its parent process, and on SIGTERM. A clean-up that hangs
is cut short.
"""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import os
import signal
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterable
from typing import Any, TypeVar

from sfglab.errors import SfglabError
from sfglab.fields import from_json, to_json

C = TypeVar("C")
T = TypeVar("T")
Report = dict[str, Any]  #: An order or a report.
Reporter = Callable[[Report], None]  #: Takes a report.
Orders = asyncio.Queue[Report]  #: Orders of a component.

#: Environment variable that makes a component report watchdog beats.
BEATS_VARIABLE = "SFGLAB_BEATS"
BEAT_PERIOD_S = 1.0  #: Period of watchdog beats, s.
END_LIMIT_S = 10  #: Time limit for the end of a component, s.
LINE_LIMIT_BYTES = 1 << 22  #: Largest order or report, bytes.


def run(main: Coroutine[Any, Any, C]) -> C:
    """Run the main coroutine of a process on uvloop, where a wake-up takes half the CPU time, and return its result."""
    import uvloop

    return uvloop.run(main)


def run_component(
    config_class: type[C],
    serve: Callable[[C, Reporter, Orders], Awaitable[None]],
) -> None:
    """Run a component until its parent orders the end; an error of sfglab ends it with exit status 1.

    The kernel ends a component that is still there `END_LIMIT_S` after the order.

    Args:
        config_class: Class of the configuration in the process's argument.
        serve: Function of the component; it takes configuration, reporter and orders.
    """
    # The parent decides when the component ends; an interrupt from the terminal reaches the parent as well.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    report = claim_standard_output()
    orders = Orders()
    try:
        config = config_from_argument(config_class, sys.argv[1])
        body = serve(config, report, orders)
        # The variable is for this process only, not for its child processes.
        if os.environ.pop(BEATS_VARIABLE, ""):
            body = _beating(body, report)
        run(_until_told(body, orders))
    except SfglabError as error:
        report({"is": "failed", "why": str(error)})
        sys.exit(1)


def argument_of(config: Any) -> str:
    """Return a configuration as the argument of a process: a text unchanged, other values as JSON."""
    return config if isinstance(config, str) else json.dumps(to_json(config))


def config_from_argument(config_class: type[C], argument: str) -> C:
    """Return the configuration in the argument of a process, the inverse of `argument_of`.

    Raises:
        SfglabError: The argument is not JSON, or does not fit the class.
    """
    config: C = from_json(config_class, json.loads(argument))
    return config


def on_stop(call: Callable[[], object]) -> None:
    """Let the running loop call a function on SIGINT (Ctrl-C), SIGTERM and SIGHUP (closed terminal)."""
    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # started with nohup
        numbers.append(signal.SIGHUP)
    for number in numbers:
        asyncio.get_running_loop().add_signal_handler(number, call)


async def run_until_interrupted(body: Coroutine[Any, Any, None]) -> bool:
    """Run a command until it ends, is interrupted or terminated; return whether it was interrupted or terminated."""
    running = asyncio.create_task(body)
    on_stop(running.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await running
    return running.cancelled()


@contextlib.asynccontextmanager
async def beside(*bodies: Coroutine[Any, Any, None]) -> AsyncIterator[list[asyncio.Task[None]]]:
    """Run tasks during a block, and end them with it. The block handles their errors."""
    tasks = [asyncio.create_task(body) for body in bodies]
    try:
        yield tasks
    finally:
        await end_tasks(*tasks)


async def end_tasks(*tasks: asyncio.Task[Any]) -> None:
    """Cancel tasks and return when all have ended, with or without an error."""
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def _beating(body: Awaitable[None], report: Reporter) -> None:
    """Report a watchdog beat every second while a component serves."""

    async def beat() -> None:
        while True:
            report({"is": "alive"})
            await asyncio.sleep(BEAT_PERIOD_S)

    async with beside(beat()):
        await body


def steady_ns() -> int:
    """Return the time of the running loop, ns, for waits: corrections of the host's clock do not change it."""
    return round(asyncio.get_running_loop().time() * 1e9)


async def next_before(items: asyncio.Queue[T], times_ns: Iterable[int | None]) -> T | None:
    """Return the next item of a queue; None if the earliest of the given times passes first.

    Args:
        items: The queue.
        times_ns: Times of the loop's clock (`steady_ns`), ns; None for no time limit.
    """
    due_ns = min((time_ns for time_ns in times_ns if time_ns is not None), default=None)
    try:
        async with asyncio.timeout_at(None if due_ns is None else due_ns / 1e9):
            return await items.get()
    except TimeoutError:
        return None


async def is_set_before(event: asyncio.Event, time_s: float | None) -> bool:
    """Wait for an event until a time of the loop's clock, s; None for no limit. Return whether the event is set."""
    try:
        async with asyncio.timeout_at(time_s):
            await event.wait()
    except TimeoutError:
        return False
    return True


async def _until_told(body: Awaitable[None], orders: Orders) -> None:
    serving = asyncio.ensure_future(body)
    hearing = asyncio.create_task(_hear(orders))

    def end() -> None:
        signal.alarm(END_LIMIT_S)  # the unhandled signal ends the process even while threads wait
        serving.cancel()

    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, end)
    hearing.add_done_callback(lambda _: end())
    try:
        with contextlib.suppress(asyncio.CancelledError):
            await serving
    finally:
        hearing.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await hearing


async def _hear(orders: Orders) -> None:
    """Take orders from standard input until it ends. It also ends when the parent process ends."""
    reader = asyncio.StreamReader(limit=LINE_LIMIT_BYTES)
    loop = asyncio.get_running_loop()
    transport, _ = await loop.connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(reader), sys.stdin
    )
    try:
        while line := await reader.readline():
            orders.put_nowait(json.loads(line))
    finally:
        transport.close()


def claim_standard_output() -> Reporter:
    """Reserve standard output for reports; return the function that writes one. Prints go to standard error."""
    out = os.dup(1)
    os.dup2(2, 1)
    # Unbuffered, so that printed text is not lost when the process is killed.
    sys.stdout = io.TextIOWrapper(io.FileIO(1, "w", closefd=False), write_through=True)

    def report(values: Report) -> None:
        view = memoryview(json.dumps(values).encode() + b"\n")
        with contextlib.suppress(BrokenPipeError):
            while view:
                view = view[os.write(out, view) :]

    return report
