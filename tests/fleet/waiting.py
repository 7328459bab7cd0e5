"""Waiting for what DDS tells in its own time, such as the graph after the data."""

from __future__ import annotations

import asyncio

DEADLINE_S = 15.0


async def until(predicate) -> None:
    """Wait for a fact that nothing signals, with a deadline."""
    async with asyncio.timeout(DEADLINE_S):
        while not predicate():
            await asyncio.sleep(0.002)
