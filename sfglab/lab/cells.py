"""Live cells: parts of an experiment that are played with processes, each for some repetitions.

Cells of one stage share processes or hosts. A finished cell is in the part's journal at once, so that an
interrupted run continues behind it. A cell whose processes fail is played once more with new ones.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import TYPE_CHECKING, Any, TypeVar

from sfglab.component import beside
from sfglab.lab.experiment import SkippedPartError
from sfglab.lab.hosts import HostsError
from sfglab.lab.runs import FAILED_CELLS
from sfglab.lab.sweep import journal as journaled
from sfglab.processes import ProcessFailedError

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Hashable, Mapping
    from contextlib import AbstractAsyncContextManager

    from sfglab.lab.bench import Bench

T = TypeVar("T")
S = TypeVar("S", bound="Hashable")
H = TypeVar("H")

_TRIES = 2  #: Number of attempts at a cell.


async def run_cells(  # noqa: PLR0913 - options
    bench: Bench[Any],
    table: str,
    cells: Mapping[T, int],
    *,
    stage_of: Callable[[T], S],
    start: Callable[[S], AbstractAsyncContextManager[H]],
    play: Callable[[H, T, int], Awaitable[Any]],
    at_once: int,
) -> None:
    """Play cells and write their rows into a table, repetition by repetition.

    The metadata of the table's name lists under `FAILED_CELLS` the cells that failed twice, with the
    reason. A run with such cells counts for no claim.

    Args:
        bench: Context of the run.
        table: Name of the table, and of the journal.
        cells: Number of repetitions by cell. A cell is a frozen dataclass.
        stage_of: Returns the stage of a cell.
        start: Provides the processes of a stage.
        play: Plays a cell on them for one repetition; returns a row or a tuple of rows.
        at_once: Number of stages that are played at the same time.

    Raises:
        SkippedPartError: There is no cell to play.
    """
    if not any(cells.values()):
        raise SkippedPartError("not asked for")
    todo = list(cells)
    jobs = []
    for repeat in range(max(cells.values())):
        jobs += [(place, repeat) for place, cell in enumerate(todo) if repeat < cells[cell]]
    failed: Counter[tuple[int, int]] = Counter()
    reasons: dict[str, str] = {}
    turn = asyncio.Semaphore(at_once)
    run_name = f"{bench.experiment}-{bench.config.profile}"
    journal_path = bench.stack.enter_context(journaled.journals(bench.log.path, run_name))
    identity = journaled.identity_of(run_cells, [bench.config, *todo])
    with journaled.open_journal(journal_path(table), identity) as journal:

        async def play_stage(stage: S) -> None:
            own = [job for job in jobs if stage_of(todo[job[0]]) == stage]
            while missing := [
                job for job in own if job not in journal.finished and failed[job] < _TRIES
            ]:
                job = missing[0]
                try:
                    async with turn, start(stage) as processes:
                        for job in missing:
                            cell, repeat = todo[job[0]], job[1]
                            rows = await play(processes, cell, repeat)
                            journal.add(*job, journaled.text_from_result(rows))
                            bench.advance(f"cell {job[0] + 1} of {len(todo)}, repetition {repeat}")
                except (ProcessFailedError, HostsError, TimeoutError) as error:
                    failed[job] += 1
                    reasons[f"{todo[job[0]]}, repetition {job[1]}"] = str(error)

        stages = dict.fromkeys(map(stage_of, todo))
        async with beside(*map(play_stage, stages)) as played:
            await asyncio.gather(*played)
        for job in jobs:
            rows = journal.finished.get(job, ())
            bench.write_all(table, rows if isinstance(rows, tuple | list) else (rows,))
    bench.metadata(table, {"hindrance": "", FAILED_CELLS: reasons})
