"""Live cells: parts of an experiment that run with processes, each for some repetitions.

Cells of one stage share processes or hosts. The part's journal stores each finished cell, so that an
interrupted run continues after it. A cell whose processes fail is run once more with new ones. If the
processes of a stage fail twice in a row to start, its remaining cells are left out.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

from sfglab.component import beside
from sfglab.lab.experiment import SkippedPartError
from sfglab.lab.hosts import HostsError
from sfglab.lab.runs import FAILED_CELLS
from sfglab.lab.sweep import journal as journaled
from sfglab.processes import ProcessFailedError

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Hashable, Iterable, Mapping, Sequence
    from contextlib import AbstractAsyncContextManager

    from sfglab.lab.bench import Bench
    from sfglab.lab.runs import Run

T = TypeVar("T")
S = TypeVar("S", bound="Hashable")
H = TypeVar("H")
Job = tuple[int, int]  #: Place of a cell, and number of its repetition.

_TRIES = 2  #: Number of attempts at a cell, and at the start of a stage.


async def run_cells(  # noqa: PLR0913 - options
    bench: Bench[Any],
    table: str,
    cells: Mapping[T, int],
    *,
    stage_of: Callable[[T], S],
    start: Callable[[S], AbstractAsyncContextManager[H]],
    play: Callable[[H, T, int], Awaitable[Any]],
    at_once: int = 1,
    by_table: bool = False,
) -> None:
    """Run cells and write their rows into a table, repetition by repetition.

    The metadata with the table's name lists the cells that failed twice, or whose stage failed twice to
    start, with the reason, under `FAILED_CELLS`. A run with such cells counts for no claim.

    Args:
        bench: Context of the run.
        table: Name of the table, and of the journal.
        cells: Number of repetitions by cell. A cell is a frozen dataclass, or a tuple of them.
        stage_of: Returns the stage of a cell.
        start: Provides the processes of a stage.
        play: Runs a cell on these processes for one repetition; returns a row or a tuple of rows.
        at_once: Number of stages that run at the same time.
        by_table: Whether `play` returns a dictionary of rows by table instead.

    Raises:
        SkippedPartError: There is no cell to run.
    """
    if not any(cells.values()):
        raise SkippedPartError("not asked for")
    todo = list(cells)
    jobs = []
    for repeat in range(max(cells.values())):
        jobs += [(place, repeat) for place, cell in enumerate(todo) if repeat < cells[cell]]
    turn = asyncio.Semaphore(at_once)
    run_name = f"{bench.experiment}-{bench.config.profile}"
    journal_path = bench.stack.enter_context(journaled.journals(bench.log.path, run_name))
    identity = journaled.identity_of(run_cells, [bench.config, *todo])
    with journaled.open_journal(journal_path(table), identity) as journal:
        plays = _Plays(cells=todo, finished=journal.finished, advance=bench.advance)

        async def play_stage(stage: S) -> None:
            own = [job for job in jobs if stage_of(todo[job[0]]) == stage]
            while missing := plays.missing(own):
                playing: Job | None = None
                try:
                    async with turn, start(stage) as processes:
                        plays.failures[stage, "start"] = 0
                        for playing in missing:
                            cell, repeat = todo[playing[0]], playing[1]
                            rows = await play(processes, cell, repeat)
                            journal.add(*playing, journaled.text_from_result(rows))
                            place = playing[0] + 1
                            bench.advance(f"cell {place} of {len(todo)}, repetition {repeat}")
                except (ProcessFailedError, HostsError, TimeoutError) as error:
                    if playing is None:
                        plays.failed((stage, "start"), missing, error)
                    else:
                        plays.failed(playing, plays.missing([playing]), error)

        stages = dict.fromkeys(map(stage_of, todo))
        async with beside(*map(play_stage, stages)) as played:
            await asyncio.gather(*played)
        reasons = {plays.text_of(job): error for job, error in plays.given_up.items()}
        for job in jobs:
            result = journal.finished.get(job, ())
            for name, rows in (result if by_table and result else {table: rows_in(result)}).items():
                bench.write_all(name, rows)
    bench.metadata(table, {"hindrance": "", FAILED_CELLS: reasons})


def rows_in(result: Any) -> Sequence[Any]:
    """Return the rows of one repetition, whose result is a row or several."""
    return result if isinstance(result, tuple | list) else (result,)


@dataclass(slots=True, kw_only=True)
class _Plays:
    """Repetitions that are missing, and those that are given up."""

    cells: Sequence[Any]  #: All cells.
    finished: Mapping[Job, Any]  #: Results of finished repetitions, from the journal.
    advance: Callable[[str], None]  #: Function that advances the progress bar.
    #: Numbers of failures: of each repetition, and in a row of the start of each stage.
    failures: Counter[Any] = field(default_factory=Counter)
    #: Error of the last attempt by repetition.
    given_up: dict[Job, str] = field(default_factory=dict)

    def missing(self, jobs: Iterable[Job]) -> list[Job]:
        """Return the repetitions that are neither finished nor given up."""
        return [job for job in jobs if job not in self.finished and job not in self.given_up]

    def failed(self, what: Any, jobs: Iterable[Job], error: Exception) -> None:
        """Count a failure, and give repetitions up after the last attempt."""
        self.failures[what] += 1
        if self.failures[what] < _TRIES:
            return
        for job in jobs:
            self.given_up[job] = str(error)
            self.advance(f"{self.text_of(job)}: failed")

    def text_of(self, job: Job) -> str:
        """Return the cell and the number of a repetition."""
        place, repeat = job
        return f"{self.cells[place]}, repetition {repeat}"


def failed_plays(run: Run[Any], table: str) -> list[str]:
    """Return the cells and repetitions that `run_cells` left out of a table."""
    return [*run.metadata(table).get(FAILED_CELLS, ())]
