"""The live half of the transfer experiment: what arrives is what was published, and nothing is left behind."""

import asyncio
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from sfglab.lab.experiments.transfer.experiment import exp
from sfglab.lab.experiments.transfer.live import Crossing, cells_of, crossings
from sfglab.lab.workers.crossing import Round, message_of, random_bytes
from sfglab.processes import ProcessFailedError

pytestmark = pytest.mark.live

BYTES = 10_000
TINY = exp.config("smoke", live_bytes=(BYTES,), live_subscribers=(2,), live_rounds=2)
ORDER = ("reader0", "subscriber", "reader1")
SMT = Round(publisher="software", gateway=False, message_bytes=BYTES, offset=0, order=ORDER, woken=())


def descriptors():
    return len(os.listdir("/proc/self/fd"))  # noqa: PTH208 - what the kernel lists, counted


def shared():
    return {path.name for path in Path("/dev/shm").glob("*sfglab*")}


@pytest.fixture
def nothing_left():
    """No process of ours lives on, and no descriptor or named memory is left."""
    before, children = descriptors(), set(psutil.Process().children())
    yield
    assert set(psutil.Process().children()) <= children
    assert not shared()
    assert descriptors() <= before


async def all_rows(config):
    return [row async for row in crossings(config)]


@pytest.mark.usefixtures("nothing_left")
def test_every_cell_is_measured_both_ways_in_every_repetition():
    rows = asyncio.run(all_rows(TINY))
    seen = [(row["repeat"], row["publisher"], row["transport"]) for row in rows]
    wanted = {(r, p, t) for r in range(2) for p in ("software", "hardware") for t in ("smt", "gateway")}
    assert set(seen) == wanted
    assert len(seen) == len(wanted) == 2 * 2 * len(cells_of(TINY))
    assert all(row["hardware_ns"] > 0 and row["software_ns"] > 0 for row in rows)


@pytest.mark.usefixtures("nothing_left")
def test_a_message_that_is_not_the_published_one_is_noticed():
    async def carry():
        async with Crossing(2, BYTES, seed=0) as crossing:
            await crossing.carry(SMT)
            crossing._data = random_bytes(BYTES, seed=1)
            await crossing.carry(replace(SMT, offset=8))

    with pytest.raises(ProcessFailedError, match="reader0, reader1, subscriber did not get what was published"):
        asyncio.run(carry())


def test_two_rounds_carry_different_words_everywhere():
    data = random_bytes(BYTES, seed=0)
    one, other = (message_of(data, replace(SMT, offset=offset)) for offset in (0, 8))
    words = [view.cast("Q") for view in (one, other)]
    assert all(a != b for a, b in zip(*words, strict=True))


@pytest.mark.usefixtures("nothing_left")
@pytest.mark.parametrize("victim", ["software", "gateway"])
def test_a_killed_process_is_named_and_nothing_is_left(victim):
    async def carry():
        async with Crossing(2, BYTES, seed=0) as crossing:
            crossing[victim].signal(signal.SIGKILL)
            order = {"order": ("subscriber",), "woken": ("reader0", "reader1", "gateway")}
            await crossing.carry(replace(SMT, publisher="hardware", gateway=True, **order))

    with pytest.raises(ProcessFailedError, match=f"{victim} killed by a signal"):
        asyncio.run(carry())


@pytest.mark.usefixtures("nothing_left")
async def test_an_interrupted_run_leaves_nothing():
    rows = crossings(replace(TINY, live_rounds=1000))
    await anext(rows)
    task = asyncio.ensure_future(anext(rows))
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    await rows.aclose()


_PARENT = """
import asyncio, dataclasses, sys
from sfglab.lab.experiments.transfer.live import Crossing

async def main():
    async with Crossing(2, 10_000, seed=0) as crossing:
        crossing["reader0"].order(do="round", publisher="software", gateway=False, message_bytes=8,
                                         offset=0, order=["reader0"], woken=[])
        await crossing["reader0"].expect("armed", timeout_s=60)
        print(*(crossing[name].pid for name in crossing), flush=True)
        await asyncio.sleep(60)

asyncio.run(main())
"""


def test_processes_end_when_their_parent_is_killed_in_the_middle_of_a_message():
    with subprocess.Popen([sys.executable, "-c", _PARENT], stdout=subprocess.PIPE, cwd=Path.cwd()) as parent:
        assert parent.stdout
        pids = [int(pid) for pid in parent.stdout.readline().split()]
        workers = [psutil.Process(pid) for pid in pids]
        parent.kill()
    assert len(workers) == 6
    gone, alive = psutil.wait_procs(workers, timeout=60)
    assert not alive
    assert len(gone) == len(workers)
