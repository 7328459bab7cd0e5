"""CPU time of a tree of processes that come and go, as bookkeeping over readings.

A process that ends between two readings is not lost: its last reading stays in the sum, and what its parent
reports as reaped (utime and stime of waited-for children, proc(5)) covers what was never read. Knows numbers;
refuses to know where readings come from: `meters` takes them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessReading:
    """What one process has used since its start."""

    pid: int  #: The process.
    parent: int  #: Its parent at the time of reading.
    #: When it started, on a clock that all readings share; tells it from a later owner of the pid.
    started_ns: int
    own_ns: int  #: CPU time of all its threads, in nanoseconds.
    #: CPU time of its children that ended and were waited for, with their own such children.
    reaped_ns: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class CpuSample:
    """CPU time of a tree since the first sample."""

    t_ns: int  #: When it was taken.
    cpu_ns_total: int  #: CPU time of all processes, alive or ended, in nanoseconds; never falls.
    per_pid: Mapping[int, int]  #: The part of each living process itself, in nanoseconds.
    ended: int  #: Processes that were seen before and ended since the previous sample.


def tree(parents: Mapping[int, int], roots: Iterable[int]) -> set[int]:
    """Return all processes that descend from some roots, the roots that exist included.

    Args:
        parents: The parent of each process.
        roots: Where to start.
    """
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
    """What is known of one process, and the last readings of its children that ended."""

    last: ProcessReading
    own_before_ns: int
    reaped_before_ns: int
    ended_children_ns: int = 0
    parent: _Account | None = field(default=None, repr=False)

    @property
    def own_ns(self) -> int:
        return self.last.own_ns - self.own_before_ns

    @property
    def total_ns(self) -> int:
        # Both count the same children: the first also those never read, the second also those never waited for.
        return self.own_ns + max(self.last.reaped_ns - self.reaped_before_ns, self.ended_children_ns)

    def depth(self) -> int:
        return 0 if self.parent is None else 1 + self.parent.depth()


class CpuLedger:
    """Adds up readings of a tree of processes."""

    def __init__(self) -> None:
        self._accounts: dict[int, _Account] = {}
        self._settled_ns = 0
        self._total_ns = 0
        self._last_ns: int | None = None

    @property
    def started_ns(self) -> Mapping[int, int]:
        """Return the start of each living process; one that its parent left behind (a daemon) still belongs."""
        return {pid: account.last.started_ns for pid, account in self._accounts.items()}

    def update(self, t_ns: int, readings: Mapping[int, ProcessReading], *, clock_ns: int) -> CpuSample:
        """Enter the readings of all processes of the tree.

        Args:
            t_ns: Stamp of the sample.
            readings: One for each living process; who is missing has ended.
            clock_ns: The time of reading on the clock of `ProcessReading.started_ns`.

        Returns:
            The sums so far.
        """
        gone = [
            pid
            for pid, account in self._accounts.items()
            if pid not in readings or readings[pid].started_ns != account.last.started_ns
        ]
        ended = [self._accounts.pop(pid) for pid in gone]
        for reading in readings.values():
            self._enter(reading)
        # Children before parents, so that a family that ended as a whole is handed up step by step.
        for account in sorted(ended, key=_Account.depth, reverse=True):
            self._settle(account)
        for pid, reading in readings.items():
            self._accounts[pid].parent = self._accounts.get(reading.parent)
        living_ns = sum(account.total_ns for account in self._accounts.values())
        # Reaped times come in ticks of 10 ms, rounded down: without this the sum could fall by one.
        self._total_ns = max(self._total_ns, self._settled_ns + living_ns)
        self._last_ns = clock_ns
        own = {pid: account.own_ns for pid, account in sorted(self._accounts.items())}
        return CpuSample(t_ns=t_ns, cpu_ns_total=self._total_ns, per_pid=own, ended=len(ended))

    def _enter(self, reading: ProcessReading) -> None:
        account = self._accounts.get(reading.pid)
        if account is not None:
            account.last = reading
            return
        # Who started after the last sample did all its work since; of others only what follows counts.
        newborn = self._last_ns is not None and reading.started_ns >= self._last_ns
        self._accounts[reading.pid] = _Account(
            last=reading,
            own_before_ns=0 if newborn else reading.own_ns,
            reaped_before_ns=0 if newborn else reading.reaped_ns,
        )

    def _settle(self, account: _Account) -> None:
        if account.parent is None:
            self._settled_ns += account.total_ns
        else:
            account.parent.ended_children_ns += account.total_ns
