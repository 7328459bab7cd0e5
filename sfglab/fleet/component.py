"""A component as a process of its own: configuration in, reports out, and how it ends.

Every component of an agent is started as ``python -m sfglab.fleet.<package> CONFIG`` with its configuration as
one JSON argument. It reports JSON values, one a line: ``{"is": "ready"}`` once it serves, ``{"is": "failed",
"why": ...}`` before it gives up, and what its own documentation names. It ends when its standard input ends,
which is when whoever started it is gone, or when it is told to terminate; a clean-up that hangs is cut short,
because nobody may be left to do so.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import sys
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.pipes import claim_standard_output, run, standard_input_lines

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable


Report = dict[str, Any]

END_LIMIT_S = 10
"""How long a component may take to end, in seconds; then the kernel ends it."""


def run_component(
    body: Callable[[Callable[[Report], None]], Awaitable[None]],
    *,
    on_order: Callable[[Report], None] = lambda _: None,
) -> None:
    """Run a component until it is told to end; exit with status 1 and a ``failed`` report when it breaks.

    Args:
        body: Serves until cancelled; is given the function that reports.
        on_order: Called with every line of standard input, which is one JSON object.
    """
    # Whoever started it decides when it ends; an interrupt from the terminal reaches that one as well.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    write = claim_standard_output()

    def report(values: Report) -> None:
        with contextlib.suppress(BrokenPipeError):  # nobody listens any more: standard input ends too
            write(json.dumps(values).encode() + b"\n")

    try:
        run(_until_told(body, report, on_order))
    except SfglabError as error:
        report({"is": "failed", "why": str(error)})
        sys.exit(1)


async def _until_told(
    body: Callable[[Callable[[Report], None]], Awaitable[None]],
    report: Callable[[Report], None],
    on_order: Callable[[Report], None],
) -> None:
    serving = asyncio.ensure_future(body(report))
    hearing = asyncio.create_task(_hear(on_order))

    def end() -> None:
        signal.alarm(END_LIMIT_S)  # unhandled it ends the process, whatever our threads are waiting for
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


async def _hear(on_order: Callable[[Report], None]) -> None:
    async for line in standard_input_lines():
        on_order(json.loads(line))
