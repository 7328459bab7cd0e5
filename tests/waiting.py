"""Waiting for what nothing signals, and for processes."""

import asyncio
import subprocess
import sys
import time
from contextlib import asynccontextmanager, contextmanager

import psutil

from sfglab.component import argument_of
from sfglab.processes import LineProcess

DEADLINE_S = 60.0


async def until(holds, act=lambda: None, *, every_s=0.005) -> None:
    """Act, again and again, until something holds that nothing signals; with a deadline."""
    async with asyncio.timeout(DEADLINE_S):
        while not holds():
            act()
            await asyncio.sleep(every_s)


def wait_until(holds, deadline_s=DEADLINE_S):
    """Return what `holds` returns, as soon as that is truthy; for a test without asyncio."""
    end_s = time.monotonic() + deadline_s
    while not (found := holds()):
        assert time.monotonic() < end_s, "it never came to that"
        time.sleep(0.02)
    return found


@asynccontextmanager
async def process(module: str, config):
    """Run a component as its process."""
    argv = (sys.executable, "-W", "error", "-m", module, argument_of(config))
    child = await LineProcess.start(module, argv)
    try:
        yield child
    finally:
        await child.close(grace_s=DEADLINE_S)


@contextmanager
def program(*argv: str, **options):
    """Run a program whose standard output is read as text, and kill it in any case at the end."""
    with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True, **options) as child:
        try:
            yield child
        finally:
            child.kill()


def lives(pid: int) -> bool:
    """Return whether a process runs; one that has ended and that init has not collected yet does not."""
    try:
        return psutil.Process(pid).status() not in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD)
    except psutil.NoSuchProcess:
        return False
