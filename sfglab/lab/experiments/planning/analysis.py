"""From the log to checks and the claim A-PLAN: the share of checks that hold.

Everything here is computed from the log alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.checks import share_of_checks
from sfglab.lab.claims import How, Measured
from sfglab.record import LogReader
from sfglab.spatial.execution import Tolerances
from sfglab.spatial.scene import AgentObject, read_scene

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from sfglab.spatial.scene import Scene

    Holds = Callable[[Any], bool]


_EXACT_TABLES = ("geometry", "exchange", "editing", "disk")
_GROUPS = {"disk": "editing", "fault": "editing"}
_SUCCEEDED, _CANCELED = "succeeded", "canceled"
_TOLERANCES = Tolerances()

_GRID_S = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """The tables of one run."""

    checks: pd.DataFrame  #: The exact checks, with their group.
    contrast: pd.DataFrame  #: The same check where it must fail now and then.
    faults: pd.DataFrame  #: One line a kind of broken file.
    goals: pd.DataFrame  #: One line a goal.
    tracks: pd.DataFrame  #: Where the scene's agents were.
    samples: pd.DataFrame  #: The drawn example.
    scene: Scene  #: The scene that was driven.
    config: dict[str, Any]  #: The run's configuration.

    @property
    def how(self) -> How:
        """How goals were sent: over DDS, or on the simulated bus."""
        return How.LIVE if self.config["live"] else How.SIMULATED


def load_results(log: Path) -> Results:
    """Read a run's tables.

    Args:
        log: The log.
    """
    with LogReader(log) as reader:
        tables = {name: reader.table(name).drop(columns="log_time_ns") for name in reader.tables}
        exact = [tables[name].assign(group=_GROUPS.get(name, name)) for name in _EXACT_TABLES]
        return Results(
            checks=pd.concat(exact, ignore_index=True),
            contrast=tables["contrast"],
            faults=tables["fault"],
            goals=tables["goal"],
            tracks=tables["track"],
            samples=tables["sample"],
            scene=read_scene(str(reader.metadata("scene")["text"])),
            config=reader.metadata("config"),
        )


def checks(results: Results) -> pd.DataFrame:
    """Return every check: group, how it was made, how often, how often it held, and an example.

    The example is one that does not hold, if there is any.
    """
    exact = results.checks.assign(how=How.EXACT.value)
    faults = pd.DataFrame(_of_faults(results.faults)).assign(group="editing", how=How.EXACT.value)
    goals = pd.DataFrame(_of_goals(results)).assign(group="execution", how=results.how.value)
    columns = ["check", "group", "how", "checked", "held", "example"]
    return pd.concat([exact, faults, goals], ignore_index=True)[columns]


def _of_faults(faults: pd.DataFrame) -> Iterator[dict[str, Any]]:
    named: tuple[tuple[str, str], ...] = (
        ("a broken file is refused with file and line", "names_the_line"),
        ("a broken file is refused in one sentence", "one_line"),
        ("a broken file stays as it is on disk", "file_kept"),
        ("after a broken file the editor has the scene that it had", "scene_kept"),
    )
    for name, column in named:
        yield _check(name, [(str(row.fault), bool(getattr(row, column))) for row in faults.itertuples()])


def _of_goals(results: Results) -> Iterator[dict[str, Any]]:
    goals = list(results.goals.itertuples())
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
        yield _check(name, [(f"{g.case}: {g.outcome}", holds(g)) for g in rows])
    yield from _of_tracks(results)


def _of_tracks(results: Results) -> Iterator[dict[str, Any]]:
    allowed = _TOLERANCES.path_m
    worst = results.tracks.groupby("agent")["error_m"].max()
    near = [
        (f"{agent}: {error:.3f} m", allowed is not None and bool(error <= allowed))
        for agent, error in worst.items()
    ]
    yield _check("an agent is never further from its plan than it may be", near)
    agents = {agent.name: agent for agent in results.scene.all_of(AgentObject)}
    pairs = []
    for a, b in combinations(sorted(agents), 2):
        _, _, driven = apart_m(results, a, b)
        needed = agents[a].radius_m + agents[b].radius_m + results.scene.margin_m
        pairs.append((f"{a} and {b}: {driven.min():.3f} m", bool(driven.min() >= needed)))
    yield _check("driven, agents stay as far apart as the scene demands", pairs)


def _check(name: str, cases: list[tuple[str, bool]]) -> dict[str, Any]:
    failed = [example for example, held in cases if not held]
    # Without anything to look at a check has not held.
    example = (failed or [example for example, _ in cases] or ["nothing to check"])[0]
    checked = max(1, len(cases))
    return {"check": name, "checked": checked, "held": len(cases) - len(failed), "example": example}


def apart_m(
    results: Results, a: str, b: str
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return times, and how far apart the centres of two agents are then, as planned and as driven.

    Poses of the two came at times of their own; between them they are interpolated.

    Args:
        results: The run.
        a: One agent.
        b: Another.
    """
    tracks = {name: results.tracks[results.tracks["agent"] == name] for name in (a, b)}
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


def measure_claims(log: Path) -> dict[str, Measured]:
    """Return our figure for A-PLAN: the share of checks that hold.

    Of the groups whichever share is lowest: many random cases of one would hide the few of another.
    """
    results = load_results(log)
    table = checks(results)
    share = share_of_checks(table, "group")
    contrast, worst = results.contrast.iloc[0], results.tracks.groupby("agent")["error_m"].max()
    details = {
        **{f"{group} checks": held for group, held in share.groups.items()},
        "kinds of checks": str(len(table)),
        "actions": "over DDS, all nodes in one process" if results.config["live"] else "on the simulated bus",
        **{f"largest error, {agent}": f"{error:.3f} m" for agent, error in worst.items()},
        "loops, had the spline evenly spaced knots": (
            f"{contrast['checked'] - contrast['held']} of {contrast['checked']} curves"
        ),
        "beyond the paper": "splines, its future work; limits, re-timing and clearance",
    }
    return {"A-PLAN": Measured(estimate=share.estimate, how=results.how, details=details, reason=share.reason)}
