"""What an experiment starts and ends again: whole, or not at all.

Knows when things are ended; refuses to know what they are.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import AsyncExitStack
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from types import TracebackType


class Staged(ABC):
    """An async context manager that starts things on entering and ends them on leaving.

    A subclass starts them in `_start`, and leaves with `_stack` how each is ended, when it has started it. They
    are ended in the reverse order, also when starting fails halfway.
    """

    def __init__(self) -> None:
        self._stack = AsyncExitStack()

    async def __aenter__(self) -> Self:
        try:
            await self._start()
        except BaseException:
            await self._stack.aclose()
            raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._stack.aclose()

    @abstractmethod
    async def _start(self) -> None:
        """Start everything."""
