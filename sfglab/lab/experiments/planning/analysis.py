"""Every check of a run, how far apart its agents were, and the claim A-PLAN: the share of checks that hold."""

from __future__ import annotations

from dataclasses import asdict
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.checks import CheckRow, check_row, share_of_checks
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.planning.experiment import Config, exp
from sfglab.lab.runs import Run, derived
from sfglab.spatial.execution.agent import Tolerances
from sfglab.spatial.scene.files import read_scene
from sfglab.spatial.scene.objects import AgentObject

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from sfglab.spatial.scene.tree import Scene

    Holds = Callable[[Any], bool]

_EXACT_TABLES = ("geometry", "exchange", "editing", "disk")
_GROUPS = {"disk": "editing", "fault": "editing"}
_SUCCEEDED, _CANCELED = "succeeded", "canceled"
_TOLERANCES = Tolerances()

_GRID_S = 0.05


def how_of(run: Run[Config]) -> How:
    """Return how goals were sent: over DDS, or on the simulated bus."""
    return How.LIVE if run.config.live else How.SIMULATED


@derived
def scene_of(run: Run[Config]) -> Scene:
    """Return the scene that was driven."""
    return read_scene(str(run.metadata("scene")["text"]))


@derived
def checks(run: Run[Config]) -> pd.DataFrame:
    """Return every check: group, how it was made, how often, how often it held, and an example.

    The example is one that does not hold, if there is any.
    """
    tables = [run[name].assign(group=_GROUPS.get(name, name)) for name in _EXACT_TABLES]
    tables.append(_table(_of_faults(run["fault"])).assign(group=_GROUPS["fault"]))
    exact = pd.concat(tables, ignore_index=True).assign(how=How.EXACT.value)
    goals = _table(_of_goals(run)).assign(group="execution", how=how_of(run).value)
    columns = ["check", "group", "how", "checked", "held", "example"]
    return pd.concat([exact, goals], ignore_index=True)[columns]


def _table(rows: Iterator[CheckRow]) -> pd.DataFrame:
    return pd.DataFrame([asdict(row) for row in rows])


def _of_faults(faults: pd.DataFrame) -> Iterator[CheckRow]:
    named: tuple[tuple[str, str], ...] = (
        ("a broken file is refused with file and line", "names_the_line"),
        ("a broken file is refused in one sentence", "one_line"),
        ("a broken file stays as it is on disk", "file_kept"),
        ("after a broken file the editor has the scene that it had", "scene_kept"),
    )
    for name, column in named:
        yield check_row(name, [(str(row.fault), bool(getattr(row, column))) for row in faults.itertuples()])


def _of_goals(run: Run[Config]) -> Iterator[CheckRow]:
    goals = list(run["goal"].itertuples())
    said = [g for g in goals if g.feedbacks]
    done = [g for g in goals if g.outcome == _SUCCEEDED]
    stopped = [g for g in goals if g.outcome == _CANCELED]
    ends: tuple[tuple[str, list[Any], Holds], ...] = (
        ("a goal ends as it must", goals, lambda g: g.outcome == g.expected),
        ("what a goal's feedback says is over never goes back", said, lambda g: bool(g.steady)),
        ("after success everything is over", done, lambda g: g.share == 1.0),
        ("after success the agent is at the last pose", done, lambda g: g.left_m <= _TOLERANCES.goal_m),
        (
            "after success the agent is no faster than it may be there",
            done,
            lambda g: g.end_speed_m_s <= _TOLERANCES.goal_m_s,
        ),
        ("a canceled goal ends when the agent stands", stopped, lambda g: g.end_speed_m_s == 0.0),
    )
    for name, rows, holds in ends:
        yield check_row(name, [(f"{g.case}: {g.outcome}", holds(g)) for g in rows])
    yield from _of_tracks(run)


def _of_tracks(run: Run[Config]) -> Iterator[CheckRow]:
    allowed = _TOLERANCES.path_m
    worst = run["track"].groupby("agent")["error_m"].max()
    near = [
        (f"{agent}: {error:.3f} m", allowed is not None and bool(error <= allowed))
        for agent, error in worst.items()
    ]
    yield check_row("an agent is never further from its plan than it may be", near)
    agents = {agent.name: agent for agent in scene_of(run).all_of(AgentObject)}
    pairs = []
    for a, b in combinations(sorted(agents), 2):
        _, _, driven = apart_m(run, a, b)
        needed = agents[a].radius_m + agents[b].radius_m + scene_of(run).margin_m
        pairs.append((f"{a} and {b}: {driven.min():.3f} m", bool(driven.min() >= needed)))
    yield check_row("driven, agents stay as far apart as the scene demands", pairs)


def apart_m(
    run: Run[Config], a: str, b: str
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return times, and how far apart the centres of two agents are then, as planned and as driven.

    Poses of the two came at times of their own; between them they are interpolated.

    Args:
        run: The run.
        a: One agent.
        b: Another.
    """
    tracks = {name: run["track"][run["track"]["agent"] == name] for name in (a, b)}
    start = max(track["t_s"].min() for track in tracks.values())
    end = min(track["t_s"].max() for track in tracks.values())
    times = np.arange(start, end, _GRID_S)
    found = []
    for prefix in ("planned_", ""):
        one, other = (
            np.column_stack([np.interp(times, t["t_s"], t[f"{prefix}{axis}_m"]) for axis in "xyz"])
            for t in tracks.values()
        )
        found.append(np.linalg.norm(one - other, axis=1))
    return times, found[0], found[1]


@exp.claim("A-PLAN", how=how_of)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of checks that hold.

    Of the groups whichever share is lowest: many random cases of one would hide the few of another.
    """
    table = checks(run)
    share = share_of_checks(table, "group")
    contrast, worst = run["contrast"].iloc[0], run["track"].groupby("agent")["error_m"].max()
    details = {
        **{f"{group} checks": held for group, held in share.groups.items()},
        "kinds of checks": str(len(table)),
        "actions": "over DDS, all nodes in one process" if run.config.live else "on the simulated bus",
        **{f"largest error, {agent}": f"{error:.3f} m" for agent, error in worst.items()},
        "loops, had the spline evenly spaced knots": (
            f"{contrast['checked'] - contrast['held']} of {contrast['checked']} curves"
        ),
        "beyond the paper": "splines, its future work; limits, re-timing and clearance",
    }
    return Finding(estimate=share.estimate, details=details, reason=share.reason)
