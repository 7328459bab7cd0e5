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
    #: Time from the start of the machine to that of the process; distinguishes processes with the same pid.
    started_ns: int


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
    return ProcessStat(parent=int(fields[1]), started_ns=int(fields[19]) * _TICK_NS)


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
        known = {pid for pid, started_ns in self._until_ns if _is_there(pid, started_ns, table)}
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


def _is_there(pid: int, started_ns: int, table: Mapping[int, ProcessStat]) -> bool:
    return pid in table and table[pid].started_ns == started_ns


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
