"""Meters: what processes and interfaces used, also of processes that ended, and what measuring costs."""

import os
import signal
import sys
import time
from subprocess import PIPE

import pytest
from waiting import program

from sfglab.lab.hosts.host import InterfaceBytes
from sfglab.lab.meters import (
    CpuMeter,
    Window,
    measure,
    process_table,
)

PYTHON = [sys.executable, "-I", "-S", "-c"]
MS = 1_000_000

# Burns CPU time on request and says how much it used between two answers.
BURNER = """
import sys, time
print("ready", flush=True)
for line in sys.stdin:
    start = time.process_time()
    while time.process_time() - start < float(line):
        pass
    print(time.process_time() - start, flush=True)
"""


# Real processes


@pytest.fixture
def burner():
    with program(*PYTHON, BURNER, stdin=PIPE) as process:
        assert process.stdout.readline() == "ready\n"
        yield process


def burn(process, seconds):
    process.stdin.write(f"{seconds}\n")
    process.stdin.flush()
    return process.stdout.readline()


@pytest.mark.live
def test_a_known_cpu_time_is_a_percentage_of_one_core(burner):
    window = Window(cpu={"burner": [burner.pid]}, interfaces={})
    window.sample(0)
    used_s = float(burn(burner, 0.2))
    (row,) = window.sample(1_000_000_000)
    assert row.cpu_percent == pytest.approx(100 * used_s, rel=0.03)


@pytest.mark.live
def test_a_process_that_starts_between_samples_counts_whole_and_an_old_one_from_then_on(burner):
    burn(burner, 0.1)
    pids = []
    meter = CpuMeter(lambda: pids)
    assert meter.sample(process_table()) == 0
    with program(*PYTHON, BURNER, stdin=PIPE) as young:
        young.stdout.readline()
        burn(young, 0.1)
        pids += [burner.pid, young.pid]
        whole_ns = meter.sample(process_table())
        burn(burner, 0.1)
        more_ns = meter.sample(process_table())
    burner.kill()
    burner.wait()
    assert meter.sample(process_table()) == more_ns, "what ended keeps what it used"
    assert 100 * MS <= whole_ns < 200 * MS
    assert whole_ns + 100 * MS <= more_ns < whole_ns + 200 * MS


@pytest.mark.live
def test_grandchildren_and_daemons_are_followed():
    code = """
import os, sys, time
if os.fork() == 0:
    middle = os.getpid()
    if os.fork() == 0:
        print(os.getpid(), middle, flush=True)
        sys.stdin.readline()
        while time.process_time() < 0.1:
            pass
        print("done", flush=True)
        sys.stdin.readline()
        os._exit(0)
os.wait()
time.sleep(1000)  # standard input is the grandchild's alone
"""
    with program(*PYTHON, code, stdin=PIPE, bufsize=1) as process:
        grandchild, middle = map(int, process.stdout.readline().split())
        meter = CpuMeter([process.pid])
        meter.sample(process_table())
        assert {grandchild, middle} < {pid for pid, _ in meter._until_ns}
        os.kill(middle, signal.SIGKILL)
        assert burn(process, "go") == "done\n", "orphaned, hence a daemon"
        total_ns = meter.sample(process_table())
        process.stdin.close()
    assert total_ns >= 90 * MS


@pytest.mark.live
async def test_there_is_a_row_for_each_window_and_label_and_sampling_costs_little(burner):
    costs_s = []
    for _ in range(3):  # One of them can hold a garbage collection of all that the tests keep.
        start_s = time.process_time()
        rows = await measure(1.0, 0.5, cpu={"a": [burner.pid], "b": lambda: [os.getpid()]})
        costs_s.append(time.process_time() - start_s)
        assert [row.label for row in rows] == ["a", "b"] * 2
        assert sum(row.window_s for row in rows[::2]) >= 0.99
        assert all(row.cpu_percent > 0 for row in rows[1::2])
    assert min(costs_s) < 0.05  # quiet, it is less than 0.01


# Interfaces and rows


class Counter:
    """A host whose counters read as listed."""

    def __init__(self, *readings):
        self._readings = iter(readings)

    def interface_bytes(self):
        return InterfaceBytes(*next(self._readings))


def test_a_label_may_have_processes_and_an_interface():
    window = Window(cpu={"edge": [os.getpid()]}, interfaces={"edge": Counter((0,) * 3, (8, 1, 0))})
    window.sample(0)
    (row,) = window.sample(2_000_000_000)
    assert (row.label, row.window_s, row.rx_bps) == ("edge", 2.0, 32)
    assert row.cpu_percent > 0
