"""Meters: what processes and interfaces used, also of processes that ended, and what measuring costs."""

import asyncio
import os
import signal
import sys
import time
from subprocess import PIPE

import pytest
from hypothesis import given
from hypothesis import strategies as st
from waiting import program

from sfglab.errors import InvalidValueError
from sfglab.lab.hosts.host import InterfaceBytes, interface_bytes
from sfglab.lab.meters import (
    CpuLedger,
    CpuMeter,
    ProcessStat,
    Window,
    measure,
    process_table,
    tree,
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
# Has children burn CPU time and waits for them.
PARENT = """
import os, sys, time
print("ready", flush=True)
for line in sys.stdin:
    for _ in range(3):
        if os.fork() == 0:
            while time.process_time() < float(line):
                pass
            os._exit(0)
        os.wait()
    print("done", flush=True)
"""


def used(own_ns, parent=0, reaped_ns=0, started_ns=0):
    return ProcessStat(parent=parent, started_ns=started_ns, own_ns=own_ns, reaped_ns=reaped_ns)


FAMILY = {1: used(10), 2: used(20, parent=1), 3: used(30, parent=2)}

LEDGERS = {
    "a sum starts at zero": (
        [{1: used(700, reaped_ns=500)}, {1: used(900, reaped_ns=560)}],
        [0, 260],
    ),
    "an old process that joins counts from when it was first seen": (
        [{1: used(0)}, {1: used(0)}, {1: used(0), 2: used(900)}, {1: used(0), 2: used(950)}],
        [0, 0, 0, 50],
    ),
    "the last reading of an ended child is kept": (
        [{1: used(0), 2: used(0, 1)}, {1: used(0), 2: used(30, 1)}, {1: used(0)}],
        [0, 30, 30],
    ),
    "a whole family that ends keeps its sum": (
        [{pid: used(0, stat.parent) for pid, stat in FAMILY.items()}, FAMILY, {}],
        [0, 60, 60],
    ),
    "a reused pid is another process": (
        [{1: used(0)}, {1: used(50)}, {1: used(7, started_ns=2)}],
        [0, 50, 57],
    ),
    "a sum never falls when ticks round down": (
        [
            {1: used(0), 2: used(0, 1)},
            {1: used(0, reaped_ns=40), 2: used(19, 1)},
            {1: used(0, reaped_ns=50)},
        ],
        [0, 59, 59],
    ),
}


@pytest.mark.parametrize(("steps", "totals"), LEDGERS.values(), ids=LEDGERS)
def test_the_ledger_adds_up_what_a_tree_has_used(steps, totals):
    """Step n happens at n on the processes' clock."""
    ledger = CpuLedger()
    assert [ledger.update(step, clock_ns=number) for number, step in enumerate(steps)] == totals
    assert set(ledger.started_ns) == set(steps[-1])


@given(st.data())
def test_the_ledger_is_exact_for_any_tree_whose_parents_wait(data):
    """Against a kernel in miniature: processes start, work, end and are waited for, at random."""
    parents, own, reaped, started = {1: 0}, {1: 0}, {1: 0}, {1: 0}
    ledger, truth, clock, next_pid = CpuLedger(), 0, 0, 2

    def sample():
        readings = {p: used(own[p], parents[p], reaped[p], started[p]) for p in parents}
        return ledger.update(readings, clock_ns=clock)

    assert sample() == 0
    for action in data.draw(
        st.lists(st.sampled_from(["fork", "work", "end", "sample"]), max_size=60)
    ):
        clock += 1
        pid = data.draw(st.sampled_from(sorted(parents)))
        if action == "fork":
            parents[next_pid], own[next_pid], reaped[next_pid], started[next_pid] = pid, 0, 0, clock
            next_pid += 1
        elif action == "work":
            amount = data.draw(st.integers(1, 1000))
            own[pid] += amount
            truth += amount
        elif action == "end" and pid != 1 and pid not in parents.values():
            reaped[parents[pid]] += own.pop(pid) + reaped.pop(pid)
            del parents[pid]
        elif action == "sample":
            assert sample() == truth
    assert sample() == truth


def test_a_tree_holds_roots_and_all_descendants_that_exist():
    assert tree({1: 0, 2: 1, 3: 2, 4: 1, 9: 0}, [2, 9, 77]) == {2, 3, 9}


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
async def test_a_busy_process_shows_in_the_rows_of_its_label(burner):
    start_s = time.perf_counter()
    burner.stdin.write("0.6\n")
    burner.stdin.flush()
    rows = await measure(0.4, 0.2, cpu={"busy": lambda: [burner.pid]})
    elapsed_s = time.perf_counter() - start_s
    assert [row.label for row in rows] == ["busy", "busy"]
    assert 0.39 <= sum(row.window_s for row in rows) <= elapsed_s
    assert sum(row.cpu_percent / 100 * row.window_s for row in rows) <= elapsed_s
    for row in (
        one for one in rows if one.window_s > 0.05
    ):  # the last is shorter where one before was late
        assert row.cpu_percent > 0, "other processes of this machine may take the rest"
        assert row.rx_bps is None


@pytest.mark.live
def test_a_known_cpu_time_is_measured_below_both_labels_of_a_process(burner):
    window = Window(cpu={"all": [os.getpid()], "burner": [burner.pid]}, interfaces={})
    window.sample(0)
    used_s = float(burn(burner, 0.2))
    both = window.sample(1_000_000_000)
    assert min(row.cpu_percent for row in both) == pytest.approx(100 * used_s, rel=0.03)


@pytest.mark.live
def test_children_that_live_and_die_between_samples_are_counted():
    with program(*PYTHON, PARENT, stdin=PIPE) as parent:
        parent.stdout.readline()
        meter = CpuMeter([parent.pid])
        meter.sample(process_table())
        burn(parent, 0.1)
        total_ns = meter.sample(process_table())
    # The kernel tells of them in ticks of 10 ms.
    assert total_ns == pytest.approx(300 * MS, rel=0.1, abs=20 * MS)


@pytest.mark.live
def test_a_process_that_dies_keeps_what_it_used(burner):
    meter = CpuMeter([burner.pid])
    meter.sample(process_table())
    burn(burner, 0.1)
    alive_ns = meter.sample(process_table())
    burner.kill()
    burner.wait()
    assert meter.sample(process_table()) == alive_ns >= 100 * MS
    assert meter._ledger.started_ns == {}


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
        assert {grandchild, middle} < set(meter._ledger.started_ns)
        os.kill(middle, signal.SIGKILL)
        assert burn(process, "go") == "done\n", "orphaned, hence a daemon"
        total_ns = meter.sample(process_table())
        followed = set(meter._ledger.started_ns)
        process.stdin.close()
    assert grandchild in followed
    assert middle not in followed
    assert total_ns >= 90 * MS


@pytest.mark.live
async def test_sampling_costs_a_few_percent_of_a_core_at_most(burner):
    costs_s = []
    for _ in range(3):  # One of them can hold a garbage collection of all that the tests keep.
        start_s = time.process_time()
        await measure(1.0, 0.5, cpu={"a": [burner.pid], "b": [os.getpid()]})
        costs_s.append(time.process_time() - start_s)
    assert min(costs_s) < 0.05  # quiet, it is less than 0.01


# Interfaces and rows


def test_interface_counters_are_read_from_the_kernels_table():
    table = "Inter-| Receive\n face |bytes\n    lo: 1 2 3 4 5 6 7 8 9 10 11\n"
    table += "  eth0:4711 12 0 0 0 0 0 0 815 34 0 0 0 0 0 0\n"
    carried = InterfaceBytes(rx_bytes=4711, tx_bytes=815, rx_packets=12, tx_packets=34)
    assert interface_bytes(table, "eth0") == carried
    with pytest.raises(LookupError, match="'eth1'"):
        interface_bytes(table, "eth1")


class Counter:
    """A host whose counters read as listed."""

    def __init__(self, *readings):
        self._readings = iter(readings)

    def interface_bytes(self):
        return InterfaceBytes(*next(self._readings))


def test_a_label_may_have_processes_and_an_interface():
    window = Window(
        cpu={"edge": [os.getpid()]}, interfaces={"edge": Counter((0,) * 4, (8, 0, 1, 0))}
    )
    window.sample(0)
    (row,) = window.sample(2_000_000_000)
    assert (row.label, row.window_s, row.rx_bps) == ("edge", 2.0, 32)
    assert row.cpu_percent > 0


@pytest.mark.parametrize(("duration_s", "period_s"), [(1.0, 0.0), (1.0, -1.0), (0.1, 0.2)])
async def test_a_duration_that_holds_no_period_is_refused(duration_s, period_s):
    with pytest.raises(InvalidValueError, match="period_s: given"):
        await measure(duration_s, period_s)


async def test_a_cancelled_measurement_ends_at_once():
    with pytest.raises(TimeoutError):
        await asyncio.wait_for(measure(100.0, 60), 0.05)
