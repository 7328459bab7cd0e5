"""Previews: a run of what a look needs, here and now, dropped as soon as nobody waits for it any more.

Runs the experiment's own tasks and parts, into a log that is gone with the preview.
"""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.lab.bench import Options, rows_of
from sfglab.lab.figures import house_style
from sfglab.lab.progress import progress_to

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from matplotlib.figure import Figure

    from sfglab.lab.experiment import Experiment
    from sfglab.lab.runs import C, Run


class StaleError(SfglabError):
    """A preview that nobody waits for any more."""


@asynccontextmanager
async def preview(
    exp: Experiment[C], look: str, config: C, *, stale: Callable[[], bool] = lambda: False
) -> AsyncIterator[Run[C]]:
    """Run what a look of an experiment needs; `stale` is asked between steps whether nobody waits any more.

    Raises:
        StaleError: Nobody does.
        SfglabError: What a task or part raises.
    """

    def go_on(_: object = None) -> None:
        if stale():
            raise StaleError(f"{exp.name}: a newer request is there")

    options = Options(explored=True, only=frozenset(exp.looks[look].needs))
    with TemporaryDirectory(prefix="sfglab-look-") as folder:
        path = Path(folder) / "look.mcap"
        sweeps = [one for one in exp.sweeps if options.wants(one.table)]
        # In a thread, because a task may run a loop of its own.
        rows = {one.table: await asyncio.to_thread(_rows, exp, one, config, go_on) for one in sweeps}
        with progress_to(go_on):
            await exp.write(config, path, rows, options, {})
        yield exp.load(path)


def _rows(exp: Experiment[C], one: Any, config: C, go_on: Callable[[], None]) -> list[tuple[None, Any]]:
    rows: list[tuple[None, Any]] = []
    for point in one.over(config):
        for seed in one.seeds(config):
            go_on()
            made = rows_of(exp.tables[one.table], one.task(point, seed), {"seed": seed}, point)
            rows += [(None, row) for row in made]
    return rows


def draw_look(exp: Experiment[C], look: str, run: Run[C]) -> Figure:
    """Draw a look of a preview."""
    from matplotlib.figure import Figure

    with house_style():
        figure = Figure(figsize=exp.looks[look].size)
        exp.looks[look].draw(figure, run)
        return figure
