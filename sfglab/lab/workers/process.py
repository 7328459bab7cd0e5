"""A helper process on a test host, seen from the experiment: orders out, reports in."""

from __future__ import annotations

import asyncio
import json
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


LINE_LIMIT_BYTES = 1 << 22


class WorkerError(SfglabError, RuntimeError):
    """A helper process failed, ended or stayed silent."""


class LineProcess:
    """A process that takes orders and gives reports, both JSON lines.

    Args:
        name: What it is called in messages.
        process: The process, with piped standard input and output.
        on_report: Called with every report that nobody waits for by `expect`.
    """

    def __init__(
        self, name: str, process: asyncio.subprocess.Process, on_report: Callable[[dict[str, Any]], None]
    ) -> None:
        self.name = name
        self._process = process
        self._on_report = on_report
        self._reports: asyncio.Queue[dict[str, Any] | None] = asyncio.Queue()
        self._listening = asyncio.create_task(self._listen())

    @classmethod
    async def start(
        cls, name: str, argv: Sequence[str], *, on_report: Callable[[dict[str, Any]], None] = lambda _: None
    ) -> LineProcess:
        """Start a process; its standard error stays ours."""
        process = await asyncio.create_subprocess_exec(
            *argv, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, limit=LINE_LIMIT_BYTES
        )
        return cls(name, process, on_report)

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def order(self, **values: Any) -> None:
        """Give an order."""
        assert self._process.stdin is not None
        if not self._process.stdin.is_closing():
            self._process.stdin.write(json.dumps(values).encode() + b"\n")

    async def expect(self, kind: str, *, timeout_s: float) -> dict[str, Any]:
        """Return the next report of a kind; others before it go to `on_report`.

        Raises:
            WorkerError: The process reports a failure, ends, or does not report in time.
        """
        try:
            async with asyncio.timeout(timeout_s):
                while (report := await self._reports.get()) is not None:
                    if report["is"] == kind:
                        return report
                    if report["is"] == "failed":
                        raise WorkerError(f"{self.name}: {report['why']}")
                    self._on_report(report)
        except TimeoutError:
            raise WorkerError(f"{self.name}: no {kind!r} within {timeout_s:g} s") from None
        raise WorkerError(f"{self.name}: it ended with status {await self._process.wait()}")

    async def close(self, *, grace_s: float = 5.0) -> None:
        """End its input, wait, and use force after a grace."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            await asyncio.wait_for(self._process.wait(), grace_s)
        except TimeoutError:
            self._process.kill()
            await self._process.wait()
        await self._listening
        while not self._reports.empty():
            report = self._reports.get_nowait()
            if report is not None:
                self._on_report(report)

    async def _listen(self) -> None:
        assert self._process.stdout is not None
        while line := await self._process.stdout.readline():
            self._reports.put_nowait(json.loads(line))
        self._reports.put_nowait(None)
