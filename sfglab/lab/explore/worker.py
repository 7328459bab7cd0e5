"""The worker behind a form: a process that draws looks, and one that makes a whole run.

A cell that is busy does not starve it, and what it is at dies with it. Orders:
``{"do": "draw", "request": N, "look": ..., "config": {...}}``; only the newest counts, older ones are dropped
between two points. Reports: ``ready``; ``picture`` with the request's number, the PNG in base64 and whether it
is the whole or a coarse one; ``refused`` with the sentence. With `Task.run` it makes one run instead and
reports ``step`` and ``done``.
"""

from __future__ import annotations

import asyncio
import base64
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any

from sfglab.component import run_component
from sfglab.errors import SfglabError
from sfglab.fields import from_json
from sfglab.lab.bench import Options
from sfglab.lab.experiments import experiment
from sfglab.lab.explore.preview import StaleError, draw_look, preview
from sfglab.lab.explore.task import Task
from sfglab.lab.figures import png_of
from sfglab.lab.progress import progress_to

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.component import Report
    from sfglab.lab.experiment import Experiment
    from sfglab.lab.progress import Step


async def serve(task: Task, report: Callable[[Report], None], orders: asyncio.Queue[Report]) -> None:
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
            await _answer(exp, order, report, lambda: ended.is_set() or not orders.empty())
    finally:
        ended.set()  # the thread that draws ends between two points, and takes its folder along


async def _answer(
    exp: Experiment[Any], order: Report, report: Callable[[Report], None], stale: Callable[[], bool]
) -> None:
    try:
        await asyncio.to_thread(asyncio.run, _draw(exp, order, report, stale))
    except StaleError:
        return
    except SfglabError as error:
        report({"is": "refused", "request": order["request"], "why": str(error)})


async def _draw(
    exp: Experiment[Any], order: Report, report: Callable[[Report], None], stale: Callable[[], bool]
) -> None:
    """Report a look's picture; first a coarse one where the look has one and the whole takes longer."""
    config = from_json(exp.config_class, order["config"])
    look = exp.looks[order["look"]]
    for changes in (look.coarse, {}) if look.coarse else ({},):
        async with preview(exp, order["look"], replace(config, **changes), stale=stale) as run:
            picture = png_of(draw_look(exp, order["look"], run))
        report(
            {
                "is": "picture",
                "request": order["request"],
                "whole": not changes,
                "png": base64.b64encode(picture).decode(),
            }
        )


async def _run(exp: Experiment[Any], task: Task, report: Callable[[Report], None]) -> None:
    def step(step: Step) -> None:
        report({"is": "step", "what": step.what, "done": step.done, "total": step.total, "left_s": step.left_s})

    options = Options(explored=True, only=None if task.only is None else frozenset(task.only))
    with progress_to(step):
        run = await exp.run(task.profile, path=Path(task.log), options=options, **task.settings)
    report({"is": "done", "log": str(run.log)})


if __name__ == "__main__":
    run_component(Task, serve)
