"""Live cells: parts of an experiment that run with processes, each for some repetitions.

Cells of one stage share processes or hosts. The part's journal stores each finished cell, so that an
interrupted run continues after it. A cell whose processes fail is run once more with new ones. If the
processes of a stage fail twice in a row to start, its remaining cells are left out.
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
    from collections.abc import Awaitable, Callable, Hashable, Mapping, Sequence
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
    play: Callable[[H, T, int], Awaitable[Mapping[str, Sequence[Any]]]],
    at_once: int = 1,
) -> None:
    """Run cells and write their rows into tables, repetition by repetition.

    The metadata with the table's name lists the cells that failed twice, or whose stage failed twice to
    start, with the reason, under `FAILED_CELLS`. A run with such cells counts for no claim.

    Args:
        bench: Context of the run.
        table: Name of the journal and of the metadata.
        cells: Number of repetitions by cell. A cell is a frozen dataclass, or a tuple of them.
        stage_of: Returns the stage of a cell.
        start: Provides the processes of a stage.
        play: Runs a cell on these processes for one repetition; returns rows by table.
        at_once: Number of stages that run at the same time.

    Raises:
        SkippedPartError: There is no cell to run.
    """
    todo = list(cells)
    jobs = _jobs([*cells.values()])
    turn = asyncio.Semaphore(at_once)
    run_name = f"{bench.experiment}-{bench.config.profile}"
    journal_path = bench.stack.enter_context(journaled.journals(bench.log.path, run_name))
    identity = journaled.identity_of(run_cells, [bench.config, *todo])
    given_up: set[Job] = set()
    reasons: dict[str, str] = {}  # errors of the last attempts
    with journaled.open_journal(journal_path(table), identity) as journal:
        finished = journal.finished

        def missing(jobs: Sequence[Job]) -> list[Job]:
            return [job for job in jobs if job not in finished and job not in given_up]

        async def play_stage(stage: S) -> None:
            own = [job for job in jobs if stage_of(todo[job[0]]) == stage]
            start_failures = 0  # since the last start that succeeded
            play_failures: Counter[Job] = Counter()
            while playable := missing(own):
                playing: Job | None = None
                try:
                    async with turn, start(stage) as processes:
                        start_failures = 0
                        for playing in playable:
                            place, repeat = playing
                            rows = await play(processes, todo[place], repeat)
                            journal.add(place, repeat, journaled.text_from_result(rows))
                            bench.advance(f"cell {place + 1} of {len(todo)}, repetition {repeat}")
                except (ProcessFailedError, HostsError, TimeoutError) as error:
                    if playing is None:
                        start_failures += 1
                        lost = own if start_failures == _TRIES else []
                    else:
                        play_failures[playing] += 1
                        lost = [playing] if play_failures[playing] == _TRIES else []
                    for place, repeat in missing(lost):
                        given_up.add((place, repeat))
                        reasons[f"{todo[place]}, repetition {repeat}"] = str(error)
                        bench.advance(f"cell {place + 1} of {len(todo)}: failed")

        async with beside(*map(play_stage, dict.fromkeys(map(stage_of, todo)))) as played:
            await asyncio.gather(*played)
        for job in jobs:
            for name, rows in finished.get(job, {}).items():
                bench.write_all(name, rows)
    bench.metadata(table, {"hindrance": "", FAILED_CELLS: reasons})


def _jobs(repeats: Sequence[int]) -> list[Job]:
    """Return all repetitions of cells: the first of each cell, then the second ones.

    Raises:
        SkippedPartError: There is none.
    """
    if not any(repeats):
        raise SkippedPartError("not asked for")
    jobs = []
    for repeat in range(max(repeats)):
        jobs += [(place, repeat) for place, count in enumerate(repeats) if repeat < count]
    return jobs


def failed_plays(run: Run[Any], table: str) -> list[str]:
    """Return the cells and repetitions that `run_cells` left out of a table."""
    return [*run.metadata(table).get(FAILED_CELLS, ())]
