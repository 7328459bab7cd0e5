"""Meters: CPU time of process trees and bytes at interfaces.

CPU time is read from the processes' own clocks in nanoseconds (clock_getcpuclockid(3)); 100 % is one core.
One sample costs about 12 us for each process on the machine. The kernel charges soft interrupts to the
process that they interrupt. The CPU time of a process that ends between two readings is counted. Its last
reading stays in the sum, and the rest is in the time of reaped children that its parent reports (proc(5)).
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from sfglab.errors import InvalidValueError
from sfglab.units import BITS_PER_BYTE, NS_PER_S

if TYPE_CHECKING:
    from sfglab.lab.testbed import CountsBytes


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessStat:
    """CPU time of one process since its start, from ``/proc/PID/stat`` (proc(5)) or a more precise clock."""

    parent: int  #: Parent process at the time of reading.
    #: Time from the start of the machine to that of the process; distinguishes processes with the same pid.
    started_ns: int
    own_ns: int  #: CPU time of all its threads, nanoseconds.
    #: CPU time of its children that ended and were waited for, with their descendants, nanoseconds.
    reaped_ns: int = 0


def tree(parents: Mapping[int, int], roots: Iterable[int]) -> set[int]:
    """Return the existing root processes and all their descendants, from the parents by process."""
    children: dict[int, list[int]] = {}
    for pid, parent in parents.items():
        children.setdefault(parent, []).append(pid)
    found: set[int] = set()
    waiting = [pid for pid in roots if pid in parents]
    while waiting:
        pid = waiting.pop()
        if pid not in found:
            found.add(pid)
            waiting += children.get(pid, ())
    return found


@dataclass(slots=True)
class _Account:
    """Readings of one process, and the last readings of its children that ended."""

    last: ProcessStat
    own_before_ns: int
    reaped_before_ns: int
    ended_children_ns: int = 0
    parent: _Account | None = field(default=None, repr=False)

    @property
    def own_ns(self) -> int:
        return self.last.own_ns - self.own_before_ns

    @property
    def total_ns(self) -> int:
        # Both values count the same children. The first includes those never read, the second those never
        # waited for.
        return self.own_ns + max(
            self.last.reaped_ns - self.reaped_before_ns, self.ended_children_ns
        )

    def depth(self) -> int:
        return 0 if self.parent is None else 1 + self.parent.depth()


class CpuLedger:
    """Sum of the readings of a tree of processes."""

    def __init__(self) -> None:
        self._accounts: dict[int, _Account] = {}
        self._settled_ns = 0
        self._total_ns = 0
        self._last_ns: int | None = None

    @property
    def started_ns(self) -> Mapping[int, int]:
        """Return the start of each living process, including those that their parent left behind (daemons)."""
        return {pid: account.last.started_ns for pid, account in self._accounts.items()}

    def update(self, readings: Mapping[int, ProcessStat], *, clock_ns: int) -> int:
        """Add all processes' readings; return the tree's CPU time since the first ones, ns. It never decreases."""
        started_ns = {pid: reading.started_ns for pid, reading in readings.items()}
        gone = [pid for pid, began_ns in self.started_ns.items() if started_ns.get(pid) != began_ns]
        ended = [self._accounts.pop(pid) for pid in gone]
        for pid, reading in readings.items():
            self._enter(pid, reading)
        # Children come before parents, so that the time of an ended family is passed on to the root step by
        # step.
        for account in sorted(ended, key=_Account.depth, reverse=True):
            if account.parent is None:
                self._settled_ns += account.total_ns
            else:
                account.parent.ended_children_ns += account.total_ns
        for pid, reading in readings.items():
            self._accounts[pid].parent = self._accounts.get(reading.parent)
        living_ns = sum(account.total_ns for account in self._accounts.values())
        # Reaped times have steps of 10 ms and are rounded down. Without this line the sum could decrease by
        # one step.
        self._total_ns = max(self._total_ns, self._settled_ns + living_ns)
        self._last_ns = clock_ns
        return self._total_ns

    def _enter(self, pid: int, reading: ProcessStat) -> None:
        account = self._accounts.get(pid)
        if account is not None:
            account.last = reading
            return
        # If a process started after the last sample, all its CPU time counts, otherwise only later CPU
        # time.
        newborn = self._last_ns is not None and reading.started_ns >= self._last_ns
        own_ns, reaped_ns = (0, 0) if newborn else (reading.own_ns, reading.reaped_ns)
        self._accounts[pid] = _Account(reading, own_before_ns=own_ns, reaped_before_ns=reaped_ns)


#: Processes, or a function that returns the processes at each sample.
Pids = Iterable[int] | Callable[[], Iterable[int]]

_TICK_NS = NS_PER_S // os.sysconf("SC_CLK_TCK")
_CPUCLOCK_SCHED = 2  # linux/posix-timers.h: the precise clock of a process


@dataclass(frozen=True, slots=True, kw_only=True)
class MeterRow:
    """CPU time and traffic of one label during one window; None if they were not measured."""

    window_s: float  #: Length of the window, s.
    label: str  #: Name of the measured processes or interface.
    cpu_percent: float | None  #: CPU time of its processes, %; 100 is one core.
    rx_bps: float | None  #: Bits per second received at its interface.


def _stat_from(line: bytes) -> ProcessStat:
    # The name may contain blanks and parentheses, so fields are counted from the last one; the parent is
    # field 4.
    fields = line[line.rindex(b")") + 2 :].split()
    user, system, reaped_user, reaped_system = (int(field) for field in fields[11:15])
    return ProcessStat(
        parent=int(fields[1]),
        started_ns=int(fields[19]) * _TICK_NS,
        own_ns=(user + system) * _TICK_NS,
        reaped_ns=(reaped_user + reaped_system) * _TICK_NS,
    )


def process_table() -> dict[int, ProcessStat]:
    """Read all processes of the machine, for `CpuMeter.sample` of several meters at once."""
    table = {}
    for name in os.listdir("/proc"):  # noqa: PTH208 - hot, and only names are needed
        if not name.isdigit():
            continue
        try:
            # The file is read unbuffered and without pathlib, because this determines the cost of a sample.
            with open(f"/proc/{name}/stat", "rb", buffering=0) as file:  # noqa: PTH123
                table[int(name)] = _stat_from(file.read(2048))
        except (FileNotFoundError, ProcessLookupError):
            continue  # the process ended meanwhile
    return table


def _read(pid: int, stat: ProcessStat) -> ProcessStat:
    """Return a process's CPU time from its own clock, or in ticks if it ended after the table was read."""
    with contextlib.suppress(OSError):
        return replace(stat, own_ns=time.clock_gettime_ns(~pid << 3 | _CPUCLOCK_SCHED))
    return stat


class CpuMeter:
    """CPU time of processes with all their descendants; a function may name the processes at each sample.

    Each process is followed from the first sample that finds it to its end. A later process with the same
    pid is not included.
    """

    def __init__(self, pids: Pids) -> None:
        self._pids = pids
        self._ledger = CpuLedger()

    def sample(self, table: Mapping[int, ProcessStat]) -> int:
        """Return the CPU time since the first sample, ns, from a `process_table`."""
        clock_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) // _TICK_NS * _TICK_NS
        wanted = {
            pid
            for pid, started_ns in self._ledger.started_ns.items()
            if pid in table and table[pid].started_ns == started_ns
        }
        if callable(self._pids):
            wanted.update(self._pids())
        else:
            wanted.update(self._pids)
            self._pids = ()  # from now on the ledger knows them
        found = tree({pid: stat.parent for pid, stat in table.items()}, wanted)
        readings = {pid: _read(pid, table[pid]) for pid in found}
        return self._ledger.update(readings, clock_ns=clock_ns)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reading:
    """Readings of all meters at one end of a window."""

    t_ns: int
    cpu_ns: Mapping[str, int]
    received_bytes: Mapping[str, int]


class Window:
    """Several meters, by label, that are read together; each sample closes one window and opens the next."""

    def __init__(self, *, cpu: Mapping[str, Pids], interfaces: Mapping[str, CountsBytes]) -> None:
        self._cpu = {label: CpuMeter(pids) for label, pids in cpu.items()}
        self._interfaces = interfaces
        self._before: _Reading | None = None

    def sample(self, now_ns: int) -> list[MeterRow]:
        """Read all meters; return a row for each label, in order. The first call returns none: it opens a window."""
        table = process_table()
        now = _Reading(
            t_ns=now_ns,
            cpu_ns={label: meter.sample(table) for label, meter in self._cpu.items()},
            received_bytes={
                label: host.interface_bytes().rx_bytes for label, host in self._interfaces.items()
            },
        )
        before, self._before = self._before, now
        if before is None:
            return []
        return [_row(label, before, now) for label in sorted({*self._cpu, *self._interfaces})]


def _row(label: str, before: _Reading, after: _Reading) -> MeterRow:
    """Turn the readings at both ends of a window into one label's row."""
    window_ns = max(1, after.t_ns - before.t_ns)
    window_s = window_ns / NS_PER_S
    cpu_percent = rx_bps = None
    if label in after.cpu_ns:
        used_ns = after.cpu_ns[label] - before.cpu_ns[label]
        cpu_percent = 100 * used_ns / window_ns
    if label in after.received_bytes:
        received_bytes = after.received_bytes[label] - before.received_bytes[label]
        rx_bps = BITS_PER_BYTE * received_bytes / window_s
    return MeterRow(window_s=window_s, label=label, cpu_percent=cpu_percent, rx_bps=rx_bps)


async def measure(
    duration_s: float,
    period_s: float,
    *,
    cpu: Mapping[str, Pids] | None = None,
    interfaces: Mapping[str, CountsBytes] | None = None,
) -> list[MeterRow]:
    """Measure for a duration; return one row for each window of `period_s` and each label.

    Raises `InvalidValueError` if the duration is shorter than one period.
    """
    if not 0 < period_s <= duration_s:
        raise InvalidValueError("period_s", period_s, f"above 0, up to duration_s ({duration_s})")
    window = Window(cpu=cpu or {}, interfaces=interfaces or {})
    start_ns = time.monotonic_ns()
    window.sample(start_ns)
    rows = []
    for number in range(1, round(duration_s / period_s) + 1):
        due_ns = start_ns + round(number * period_s * NS_PER_S)
        await asyncio.sleep(max(0, due_ns - time.monotonic_ns()) / NS_PER_S)
        rows += window.sample(time.monotonic_ns())
    return rows
