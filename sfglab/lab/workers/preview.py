"""The process behind an explorer's form, ``python -m sfglab.lab.workers.preview TASK``: draws, or makes a run.

A cell that is busy does not starve it, and what it is at dies with it. Orders:
``{"do": "draw", "request": N, "look": ..., "config": {...}}``; only the newest counts, older ones are dropped
between two points. Reports: ``ready``; ``picture`` with the request's number, the PNG in base64 and whether it
is the whole or a coarse one; ``refused`` with the sentence. With `Task.profile` it makes one run instead and
reports ``step`` and ``done``; the latter of a whole run with its figures and claims.
"""

from __future__ import annotations

import asyncio
import base64
import logging
from contextlib import asynccontextmanager
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event
from typing import TYPE_CHECKING, Any

from sfglab.component import Orders, Report, Reporter, run_component
from sfglab.errors import SfglabError
from sfglab.fields import from_json
from sfglab.lab.bench import Options, rows_of
from sfglab.lab.experiments import experiment
from sfglab.lab.explore.explorer import Task
from sfglab.lab.figures import drawn, png_of
from sfglab.lab.ledger import own_ledger
from sfglab.lab.paths import find_project
from sfglab.lab.progress import progress_to

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from matplotlib.figure import Figure

    from sfglab.lab.experiment import Experiment
    from sfglab.lab.runs import C, Run

_log = logging.getLogger(__name__)


class StaleError(SfglabError):
    """A preview that nobody waits for any more."""


@asynccontextmanager
async def preview(
    exp: Experiment[C], look: str, config: C, *, stale: Callable[[], bool] = lambda: False
) -> AsyncIterator[Run[C]]:
    """Run what a look of an experiment needs, into a log that is gone with the preview.

    `stale` is asked between steps whether nobody waits any more.

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
        rows = {
            one.table: await asyncio.to_thread(_rows, exp, one, config, go_on) for one in sweeps
        }
        with progress_to(go_on):
            await exp.write(config, path, rows, options, {})
        yield exp.load(path)


def _rows(
    exp: Experiment[C], one: Any, config: C, go_on: Callable[[], None]
) -> list[tuple[None, Any]]:
    rows: list[tuple[None, Any]] = []
    for point in one.over(config):
        for seed in one.seeds(config):
            go_on()
            made = rows_of(exp.tables[one.table], one.task(point, seed), {"seed": seed}, point)
            rows += [(None, row) for row in made]
    return rows


def draw_look(exp: Experiment[C], look: str, run: Run[C]) -> Figure:
    """Draw a look of a preview."""
    return drawn(exp.looks[look].size, exp.looks[look].draw, run)


async def serve(task: Task, report: Reporter, orders: Orders) -> None:
    """Draw until cancelled, or make one run."""
    exp = experiment(task.experiment)
    if task.profile:
        await _run(exp, task, report)
        return
    report({"is": "ready"})
    ended = Event()
    try:
        while True:
            order = await orders.get()
            while not orders.empty():
                order = orders.get_nowait()
            drawing = _draw(exp, order, report, lambda: ended.is_set() or not orders.empty())
            await asyncio.to_thread(asyncio.run, drawing)
    finally:
        ended.set()  # the thread that draws ends between two points, and takes its folder along


async def _draw(
    exp: Experiment[Any], order: Report, report: Reporter, stale: Callable[[], bool]
) -> None:
    """Report a look's picture; first a coarse one where the look has one and the whole takes longer."""
    request, look = order["request"], exp.looks[order["look"]]
    try:
        config = from_json(exp.config_class, order["config"])
        for changes in (look.coarse, {}) if look.coarse else ({},):
            async with preview(exp, order["look"], replace(config, **changes), stale=stale) as run:
                png = base64.b64encode(png_of(draw_look(exp, order["look"], run))).decode()
            report({"is": "picture", "request": request, "whole": not changes, "png": png})
    except StaleError:
        return
    except SfglabError as error:
        report({"is": "refused", "request": request, "why": str(error)})
    except Exception as error:  # noqa: BLE001 - what cannot be drawn must not end what comes after it
        _log.exception("a look of %s", exp.name)
        report({"is": "refused", "request": request, "why": f"it cannot be drawn: {error!r}"})


async def _run(exp: Experiment[Any], task: Task, report: Reporter) -> None:
    options = Options(explored=True, only=None if task.only is None else frozenset(task.only))
    with progress_to(lambda step: report({"is": "step", **asdict(step)})):
        run = await exp.run(task.profile, path=Path(task.log), options=options, **task.settings)
    result = _result(exp, run) if task.only is None else {}
    report({"is": "done", "log": str(run.log), **result})


def _result(exp: Experiment[Any], run: Run[Any]) -> dict[str, Any]:
    """Return a run's figures and claims as a page shows them, and what could not be drawn."""
    figures: dict[str, str] = {}
    failed: list[str] = []
    for name in exp.drawings_of(run):
        try:
            png = png_of(exp.draw(name, run)[0])
        except Exception as error:  # noqa: BLE001 - a run with few cells lacks what a figure compares
            failed.append(f"figure {name} cannot be drawn from this run: {error!r}")
        else:
            figures[name] = base64.b64encode(png).decode()
    try:
        claims = own_ledger(find_project(), run)._repr_html_()
    except Exception as error:  # noqa: BLE001 - the same of claims
        failed.append(f"its claims cannot be computed: {error!r}")
        claims = ""
    return {"figures": figures, "claims": claims, "failed": failed}


if __name__ == "__main__":
    run_component(Task, serve)
