"""Real ROS 2 beside us, feature by feature: what the tests in `tests/ros2` find, as a table.

Each of these tests says by its mark which feature it shows. Run here, it gives a row for each distribution.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from sfglab.lab.experiment import Actor, Experiment, Link, Profiled, SkippedPartError
from sfglab.lab.figures import COLORS, note, word_table
from sfglab.lab.ros2 import TESTED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from sfglab.lab.bench import Bench
    from sfglab.lab.runs import Run

TESTS = Path(__file__).parents[3] / "tests" / "ros2"
WORKS, FAILS, CANNOT, UNTESTED = "works", "fails", "cannot work", "untested against the real thing"
_COLORS = {
    WORKS: COLORS["proxy"],
    FAILS: COLORS["standard"],
    CANNOT: "#777777",
    UNTESTED: "#bbbbbb",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """Which tests are run."""

    distributions: tuple[str, ...] = TESTED  #: Beside which the tests are run.
    only: str = ""  #: Expression over tests' names, as pytest's `-k` takes it; empty: all.
    slow: bool = False  #: Whether those run, too, that take more than five seconds.
    seed: int = 0  #: Of nothing that is random; for the record.


exp = Experiment(
    "ros2",
    Config,
    where="beside all papers",
    smoke={"distributions": ("jazzy",), "only": "bytes_behind"},
    paper={"slow": True},
    actors=(
        Actor("node", "this machine or a host", "sfglab's nodes, routers and decoders"),
        Actor("rclpy", "the same, or another host", "a real node on its own Fast DDS"),
    ),
    links=(
        Link("node", "rclpy", "topics, services, actions"),
        Link("rclpy", "node", "the same, the other way"),
    ),
)


@exp.table("test")
@dataclass(frozen=True, slots=True, kw_only=True)
class FeatureRow:
    """A test beside one distribution, for each feature that it shows."""

    feature: str  #: What a user of ROS 2 would look for.
    distribution: str  #: Beside which distribution.
    test: str  #: The test's name.
    outcome: str  #: ``passed``, ``failed`` or ``skipped``.
    condition: str = ""  #: Under which condition it works.
    cannot: str = ""  #: Why it cannot work: the test shows that it does not.
    duration_s: float = 0.0  #: How long it took.


@exp.part("tests", total=lambda config: len(config.distributions))
async def run_tests(bench: Bench[Config]) -> None:
    """Run the tests beside each distribution and write a row for each feature that a test shows."""
    if not TESTS.is_dir():
        raise SkippedPartError("the tests beside ROS 2 are in the repository only (tests/ros2)")
    for name in bench.config.distributions:
        told, config = bench.folder(name) / "features", bench.config
        chosen = [
            "-k",
            f"{name} and ({config.only or name})",
            "-m",
            "ros" if config.slow else "not slow",
        ]
        bench.attach(f"{name}.txt", await _run_pytest(chosen, told), "text/plain")
        lines = told.read_text(encoding="utf-8").splitlines() if told.exists() else ()
        bench.write_all("test", map(json.loads, lines))
        bench.advance(name)


async def _run_pytest(chosen: list[str], told: Path) -> bytes:
    """Run tests; what they show goes into a file. Returns what pytest printed."""
    argv = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "--color=no",
        *chosen,
        str(TESTS),
    ]
    argv += ["--numprocesses=auto", "--dist=worksteal"]
    # What the run of tests that we may be a part of has set is not meant for this one.
    own = {
        k: v
        for k, v in os.environ.items()
        if not k.startswith(("PYTEST_", "SFGLAB_SKIPS", "SFGLAB_ROOT"))
    }
    process = await asyncio.create_subprocess_exec(
        *argv,
        cwd=TESTS.parents[1],
        env=own | {"SFGLAB_FEATURES": str(told)},
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
    )
    try:
        return (await process.communicate())[0]
    finally:
        if process.returncode is None:
            process.terminate()
            await process.wait()


def verdict(rows: pd.DataFrame) -> str:
    """Return what the tests of a feature beside one distribution say in all, as a user reads it."""
    if rows.empty or (rows["outcome"] == "skipped").all():
        return UNTESTED
    if (rows["outcome"] == "failed").any():
        return FAILS
    if why := "; ".join(filter(None, rows["cannot"].unique())):
        return f"{CANNOT}: {why}"
    return WORKS + "".join(f", {text}" for text in rows["condition"].unique() if text)


def compatibility(tests: pd.DataFrame, distributions: Sequence[str] = TESTED) -> pd.DataFrame:
    """Return the table of features (in the order of the tests) by distributions, each with its verdict."""
    names = tests["feature"].drop_duplicates()
    columns = {
        name: [
            verdict(tests[(tests["feature"] == f) & (tests["distribution"] == name)]) for f in names
        ]
        for name in distributions
    }
    return pd.DataFrame({"feature": names.to_list(), **columns})


@exp.figure("ros2_features", size=(10, 10.5))
def draw_features(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw what works beside each distribution of ROS 2, feature by feature."""
    table = compatibility(run["test"], run.config.distributions)
    columns = list(table.columns[1:])

    def colored(said: str) -> tuple[str, str]:
        return said, next(color for start, color in _COLORS.items() if said.startswith(start))

    rows = {line[0]: [*map(colored, line[1:])] for line in table.itertuples(index=False)}
    word_table(figure, [name.capitalize() for name in columns], rows, wrap=52)
    works = table[columns].apply(lambda cells: cells.str.startswith(WORKS)).to_numpy()
    count = f"{works.all(axis=1).sum()} of {len(table)}"
    figure.suptitle(f"{count} features work beside real rclpy of every distribution")
    note(
        figure,
        f"live: {len(run['test'])} outcomes of tests; a feature works where all of its tests pass",
    )
    return {"table": table}
