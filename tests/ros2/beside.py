"""What tests beside real ROS 2 ask of it."""

from __future__ import annotations

import asyncio

ANSWER_S = 60


async def asked(process, do, answer, **values):
    """Give a peer an order and return its report."""
    process.order(do=do, **values)
    return await process.expect(answer, timeout_s=ANSWER_S)


async def until(true):
    """Ask until it is true."""
    async with asyncio.timeout(ANSWER_S):
        while not await true():
            await asyncio.sleep(0.1)
