"""Lines between a process and those it starts: orders on standard input, reports on standard output.

Used by every helper process of sfglab. Knows bytes and lines; refuses to know what they mean.
"""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Coroutine
    from typing import Any


def run(main: Coroutine[Any, Any, None]) -> None:
    """Run a process's main coroutine, on uvloop: a wake-up costs half as much there."""
    import uvloop

    uvloop.run(main)


async def standard_input_lines() -> AsyncIterator[bytes]:
    """Yield the lines of standard input until it ends, which it does when the parent is gone."""
    import asyncio

    reader = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    transport, _ = await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    try:
        while line := await reader.readline():
            yield line
    finally:
        transport.close()


def claim_standard_output() -> Callable[[bytes], None]:
    """Keep standard output for reports; whatever a library prints goes to standard error from now on.

    Returns:
        A function that writes one report.
    """
    reports = os.dup(1)
    os.dup2(2, 1)

    def report(line: bytes) -> None:
        view = memoryview(line)
        while view:
            view = view[os.write(reports, view) :]

    return report
