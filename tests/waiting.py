"""Waiting for what nothing signals, and for processes."""

import asyncio
import sys
from contextlib import asynccontextmanager

import psutil

from sfglab.component import argument_of
from sfglab.processes import LineProcess

DEADLINE_S = 60.0


async def until(predicate) -> None:
    """Wait for a fact that nothing signals, with a deadline."""
    async with asyncio.timeout(DEADLINE_S):
        while not predicate():
            await asyncio.sleep(0.005)


@asynccontextmanager
async def process(module: str, config):
    """Run a component as its process."""
    argv = (sys.executable, "-W", "error", "-m", module, argument_of(config))
    child = await LineProcess.start(module, argv)
    try:
        yield child
    finally:
        await child.close(grace_s=DEADLINE_S)


def lives(pid: int) -> bool:
    """Return whether a process runs; one that has ended and that init has not collected yet does not."""
    try:
        return psutil.Process(pid).status() not in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD)
    except psutil.NoSuchProcess:
        return False
