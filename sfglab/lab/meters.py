"""Meters: CPU time of process trees and bytes at interfaces.

CPU time is read from the processes' own clocks in nanoseconds (clock_getcpuclockid(3)); 100 % is one core.
One sample costs about 12 us for each process on the machine. The kernel charges soft interrupts to the
process that they interrupt. The last reading of a process that ended stays in the sum.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from sfglab.units import BITS_PER_BYTE, NS_PER_S

if TYPE_CHECKING:
    from sfglab.lab.testbed import CountsBytes


class ProcessStat(NamedTuple):
    """Parent and start of one process, from ``/proc/PID/stat`` (proc(5))."""

    parent: int  #: Parent process at the time of reading.
    #: Time from the start of the machine to that of the process, ns; it distinguishes processes with the same pid.
    started_ns: int


def tree(parents: Mapping[int, int], roots: Iterable[int]) -> set[int]:
    """Return the existing root processes and all their descendants, from the parents by process."""
    found: set[int] = set()
    new = parents.keys() & set(roots)
    while new:
        found |= new
        new = {pid for pid, parent in parents.items() if parent in found} - found
    return found


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


def process_table() -> dict[int, ProcessStat]:
    """Read all processes of the machine, for `CpuMeter.sample` of several meters at once."""
    table = {}
    for name in os.listdir("/proc"):  # noqa: PTH208 - hot, and only names are needed
        if not name.isdigit():
            continue
        try:
            # The file is read unbuffered and without pathlib, because this determines the cost of a sample.
            with open(f"/proc/{name}/stat", "rb", buffering=0) as file:  # noqa: PTH123
                line = file.read(2048)
        except (FileNotFoundError, ProcessLookupError):
            continue  # the process ended meanwhile
        # The name may contain blanks and parentheses, so fields are counted from the last one; the parent
        # is field 4.
        fields = line[line.rindex(b")") + 2 :].split()
        started_ns = int(fields[19]) * _TICK_NS
        table[int(name)] = ProcessStat(parent=int(fields[1]), started_ns=started_ns)
    return table


class CpuMeter:
    """CPU time of processes with all their descendants; a function may name the processes at each sample.

    Each process is followed from the first sample that finds it to its end. If it started after the sample
    before, all its CPU time counts, otherwise only later CPU time. A later process with the same pid is
    not included.
    """

    def __init__(self, pids: Pids) -> None:
        self._pids = pids
        self._last_ns: int | None = None  # time of the last sample since the start of the machine
        # Pid and start of each process, with its CPU time before the measurement and until now.
        self._before_ns: dict[tuple[int, int], int] = {}
        self._until_ns: dict[tuple[int, int], int] = {}

    def sample(self, table: Mapping[int, ProcessStat]) -> int:
        """Return the CPU time since the first sample, ns, from a `process_table`."""
        clock_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) // _TICK_NS * _TICK_NS
        known = set()
        for pid, started_ns in self._until_ns:
            if pid in table and table[pid].started_ns == started_ns:
                known.add(pid)
        if callable(self._pids):
            known.update(self._pids())
        elif self._last_ns is None:
            known.update(self._pids)
        for pid in tree({pid: stat.parent for pid, stat in table.items()}, known):
            key = pid, table[pid].started_ns
            with contextlib.suppress(OSError):  # the process ended after the table was read
                own_ns = time.clock_gettime_ns(~pid << 3 | _CPUCLOCK_SCHED)
                is_new = self._last_ns is not None and key[1] >= self._last_ns
                self._before_ns.setdefault(key, 0 if is_new else own_ns)
                self._until_ns[key] = own_ns
        self._last_ns = clock_ns
        return sum(self._until_ns.values()) - sum(self._before_ns.values())


class Window:
    """Several meters, by label, that are read together; each sample closes one window and opens the next."""

    def __init__(self, *, cpu: Mapping[str, Pids], interfaces: Mapping[str, CountsBytes]) -> None:
        self._cpu = {label: CpuMeter(pids) for label, pids in cpu.items()}
        self._interfaces = interfaces
        self._labels = sorted({*cpu, *interfaces})
        #: Time, CPU times and received bytes at the last sample, by label.
        self._last: tuple[int, dict[str, int], dict[str, int]] | None = None

    def sample(self, now_ns: int) -> list[MeterRow]:
        """Read all meters; return a row for each label, in order. The first call returns none: it opens a window."""
        table = process_table()
        cpu_ns = {label: meter.sample(table) for label, meter in self._cpu.items()}
        received = {
            label: host.interface_bytes().rx_bytes for label, host in self._interfaces.items()
        }
        before, self._last = self._last, (now_ns, cpu_ns, received)
        if before is None:
            return []
        then_ns, cpu_ns_then, received_then = before
        window_ns = max(1, now_ns - then_ns)
        window_s = window_ns / NS_PER_S
        rows = []
        for label in self._labels:
            cpu_percent = rx_bps = None
            if label in cpu_ns:
                cpu_percent = 100 * (cpu_ns[label] - cpu_ns_then[label]) / window_ns
            if label in received:
                rx_bps = BITS_PER_BYTE * (received[label] - received_then[label]) / window_s
            row = MeterRow(window_s=window_s, label=label, cpu_percent=cpu_percent, rx_bps=rx_bps)
            rows.append(row)
        return rows


async def measure(
    duration_s: float,
    period_s: float,
    *,
    cpu: Mapping[str, Pids] | None = None,
    interfaces: Mapping[str, CountsBytes] | None = None,
) -> list[MeterRow]:
    """Measure for a duration; return one row for each window of `period_s` and each label."""
    window = Window(cpu=cpu or {}, interfaces=interfaces or {})
    start_ns = time.monotonic_ns()
    window.sample(start_ns)
    rows = []
    for number in range(1, round(duration_s / period_s) + 1):
        due_ns = start_ns + round(number * period_s * NS_PER_S)
        await asyncio.sleep(max(0, due_ns - time.monotonic_ns()) / NS_PER_S)
        rows += window.sample(time.monotonic_ns())
    return rows
