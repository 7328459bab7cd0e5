"""The gateway core explored, and the communication mapping of Fig. 8: paper C, sections 3 and 5.

Exact: every interleaving of core and surroundings up to a bound, the same with a core that does not claim the
hardware's topic and with every arrow of the core's table bent, and the edges across the boundary of the paper's
example in its three stages.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from sfglab.lab.checks import CheckRow
from sfglab.lab.claims import How, Measured
from sfglab.lab.experiments.profiles import ConfigError, of_profile
from sfglab.lab.figures import house_style
from sfglab.lab.paths import find_project
from sfglab.lab.progress import progress_bar
from sfglab.lab.stats import Estimate
from sfglab.record import LogReader, LogWriter, run_context
from sfglab.soc import carriages_per_message, crossing_edges, load_graph, map_communication
from sfglab.soc.gateway import TABLE, Bound, Drive, Input, Move, Row, State, Table, explore

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import pandas as pd
    from matplotlib.figure import Figure

    from sfglab.soc.graph import Graph

__all__ = [
    "NAME",
    "Config",
    "ConfigError",
    "ExplorationRow",
    "Results",
    "StageRow",
    "figure_core",
    "figure_mapping",
    "figures",
    "load_results",
    "measure_claims",
    "run",
]

NAME = "gateways"

STAGES = ("all topics in software", "topics in hardware", "topics in hardware, gateways")
"""Fig. 8 b, c and d."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """How much is explored.

    Attributes:
        profile: Name of the profile it came from.
        bounds: What is explored with the core's table, and with the one that does not claim.
        bent: Whether the same is asked of every table with one arrow bent.
        graph_file: The example, in the data folder.
        seed: For the other experiments' sake; nothing is drawn here.
    """

    profile: str
    bounds: tuple[Bound, ...]
    bent: bool = True
    graph_file: str = "graphs/figure_8.yaml"
    seed: int = 0

    @classmethod
    def of_profile(cls, profile: str, *, seed: int = 0) -> Config:
        """Return the configuration of a profile.

        Args:
            profile: ``smoke``, ``quick`` or ``paper``.
            seed: Not used.

        Raises:
            ConfigError: There is no such profile.
        """
        return of_profile(_PROFILES, profile, seed=seed)


_SMALL = (Bound(), Bound(subscribers=2), Bound(calls=2), Bound(port_messages=1), Bound(echoes=False))
_LARGER = (
    Bound(software=(3,), hardware=(3,)),
    Bound(software=(2, 1), hardware=(1, 1)),
    Bound(software=(4,), hardware=(4,), subscribers=2, calls=2),
)
_LARGEST = (
    Bound(software=(2, 1), hardware=(2, 1), subscribers=2),
    Bound(software=(2, 1), hardware=(2, 1), port_messages=2),
)
_PROFILES = {
    "smoke": Config(profile="smoke", bounds=_SMALL, bent=False),
    "quick": Config(profile="quick", bounds=(*_SMALL, *_LARGER)),
    "paper": Config(profile="paper", bounds=(*_SMALL, *_LARGER, *_LARGEST)),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ExplorationRow:
    """One exploration of the core's table, or of one derived from it.

    Attributes:
        software: Messages of each software publisher.
        hardware: Messages of each hardware publisher.
        subscribers: Hardware subscribers besides the core.
        calls: Calls to the delegate that may wait.
        echoes: Whether both topics return the core's own messages.
        port_messages: Whole messages that the core's port can store.
        worlds: Reachable moments.
        steps: Steps between them.
        depth: Length of the longest of the shortest ways.
        states: States of the core that occurred.
        violation: What was violated; empty: nothing.
    """

    software: str
    hardware: str
    subscribers: int
    calls: int
    echoes: bool
    port_messages: int
    worlds: int
    steps: int
    depth: int
    states: int
    violation: str


@dataclass(frozen=True, slots=True, kw_only=True)
class StageRow:
    """One stage of the mapping of Fig. 8.

    Attributes:
        stage: One of `STAGES`.
        publications: Publishing edges across the boundary.
        subscriptions: Subscribing edges across the boundary.
        carriages: How often one message of every topic is carried across, together.
        mapped: Topics and what they are mapped to.
        left: The edges that are left across the boundary.
    """

    stage: str
    publications: int
    subscriptions: int
    carriages: float
    mapped: str
    left: str


def run(config: Config, path: Path) -> Path:
    """Explore, bend and map; nothing depends on the machine's speed.

    Args:
        config: How much.
        path: The log.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with LogWriter(path) as log, progress_bar(2 * len(config.bounds) + config.bent, NAME) as advance:
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": NAME, **asdict(config)})
        visited: set[State] = set()
        for place, bound in enumerate(config.bounds):
            row, states = _explored(bound, TABLE)
            visited |= states
            log.write_row("exploration", row, log_time_ns=place)
            advance(f"{row.worlds} worlds")
            row, _ = _explored(bound, _unclaimed(TABLE))
            log.write_row("unclaimed", row, log_time_ns=place)
            advance("without the claim")
        checks = [_coverage(visited)]
        if config.bent:
            checks.append(_bent())
            advance("bent arrows")
        for place, check in enumerate(checks):
            log.write_row("check", check, log_time_ns=place)
        graph = load_graph(find_project().data / config.graph_file)
        for place, stage in enumerate(_stages(graph)):
            log.write_row("stage", stage, log_time_ns=place)
    return path


def _explored(bound: Bound, table: Table) -> tuple[ExplorationRow, frozenset[State]]:
    found = explore(bound, table)
    row = ExplorationRow(
        software="+".join(map(str, bound.software)),
        hardware="+".join(map(str, bound.hardware)),
        subscribers=bound.subscribers,
        calls=bound.calls,
        echoes=bound.echoes,
        port_messages=bound.port_messages,
        worlds=found.worlds,
        steps=found.steps,
        depth=found.depth,
        states=len(found.visited),
        violation=found.counterexample.property if found.counterexample else "",
    )
    return row, found.visited


def _coverage(visited: set[State]) -> CheckRow:
    missing = [state.name for state in State if state not in visited]
    return CheckRow(
        check="every state of the core occurs",
        checked=len(State),
        held=len(visited),
        example=", ".join(missing) or "all",
    )


def _unclaimed(table: Table) -> Table:
    """Return a table in which every way to the claim of the hardware's topic leads straight to the sending."""
    sends = {s: row.moves[Input.GRANTED].to for s, row in table.items() if row.drive is Drive.CLAIM_HMT}
    return {
        state: Row(
            row.drive, {i: Move(sends.get(move.to, move.to), move.latch) for i, move in row.moves.items()}
        )
        for state, row in table.items()
    }


def _bent_tables() -> Iterator[tuple[str, Table]]:
    for state, row in TABLE.items():
        for given, move in row.moves.items():
            for to in State:
                if to is not move.to:
                    moves = {**row.moves, given: Move(to, move.latch)}
                    yield f"{state.name} -{given.name}-> {to.name}", {**TABLE, state: Row(row.drive, moves)}


def _bent() -> CheckRow:
    """Ask the same of every table with one arrow bent: what passes shows what the exploration cannot see."""
    passed, tried = [], 0
    for name, table in _bent_tables():
        tried += 1
        if explore(Bound(), table).counterexample is None:
            passed.append(name)
    return CheckRow(
        check="of the tables with one arrow bent, those that are caught",
        checked=tried,
        held=tried - len(passed),
        example="; ".join(passed),
    )


def _stages(graph: Graph) -> Iterator[StageRow]:
    for stage, mapped in zip(STAGES, map_communication(graph).stages, strict=True):
        crossing = crossing_edges(mapped)
        edges = (*crossing.publications, *crossing.subscriptions)
        yield StageRow(
            stage=stage,
            publications=len(crossing.publications),
            subscriptions=len(crossing.subscriptions),
            carriages=sum(carriages_per_message(mapped, topic) for topic in mapped.topics),
            mapped=", ".join(f"{topic.name} {topic.mapping.value}" for topic in mapped.topics),
            left=", ".join(map(str, edges)),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """The tables of one run.

    Attributes:
        explorations: One line a bound.
        unclaimed: The same of a core that does not claim the hardware's topic; none in logs of before.
        checks: Coverage, and bent arrows.
        stages: The stages of Fig. 8.
        config: The run's configuration.
    """

    explorations: pd.DataFrame
    unclaimed: pd.DataFrame
    checks: pd.DataFrame
    stages: pd.DataFrame
    config: dict[str, Any]


def load_results(log: Path) -> Results:
    """Read a run's tables.

    Args:
        log: The log.
    """
    with LogReader(log) as reader:
        tables = {name: reader.table(name).drop(columns="log_time_ns") for name in reader.tables}
        return Results(
            explorations=tables["exploration"],
            unclaimed=tables.get("unclaimed", tables["exploration"].iloc[:0]),
            checks=tables["check"],
            stages=tables["stage"],
            config=reader.metadata("config"),
        )


def measure_claims(log: Path) -> dict[str, Measured]:
    """Return our figures for the claims that this experiment answers, by claim id."""
    results = load_results(log)
    return {"C-FSM": _core_claim(results), "C-MAP": _mapping_claim(results)}


def _core_claim(results: Results) -> Measured:
    explorations, coverage = results.explorations, results.checks.iloc[0]
    held = (explorations["violation"] == "").sum() + coverage["held"]
    share = float(held / (len(explorations) + coverage["checked"]))
    details = {
        "bounds explored": str(len(explorations)),
        "worlds": str(int(explorations["worlds"].sum())),
        "states that occur": f"{coverage['held']} of {coverage['checked']}",
    }
    if len(results.unclaimed):
        details["beyond the text"] = _why_it_claims(results.unclaimed)
    if len(results.checks) > 1:
        bent = results.checks.iloc[1]
        details["bent tables that are caught"] = f"{bent['held']} of {bent['checked']}"
    estimate = Estimate(value=share, low=share, high=share, unit="share of checks that hold")
    return Measured(estimate=estimate, how=How.EXACT, details=details)


def _why_it_claims(unclaimed: pd.DataFrame) -> str:
    found = unclaimed["violation"][unclaimed["violation"] != ""]
    what = f" ({'; '.join(sorted(set(found)))})" if len(found) else ""
    share = f"{len(found)} of {len(unclaimed)} bounds are violated{what}"
    return f"the core claims the hardware's topic before it sends; without that {share}"


def _mapping_claim(results: Results) -> Measured:
    stages = results.stages
    edges = stages["publications"] + stages["subscriptions"]
    details = {
        "edges, by stage": " -> ".join(map(str, edges)),
        "carriages of one message a topic": " -> ".join(f"{carried:g}" for carried in stages["carriages"]),
        "left": str(stages["left"].iloc[-1]),
        "which nodes the edges join": "is in the text only where it says so; the rest is our reading",
    }
    value = float(edges.iloc[-1])
    estimate = Estimate(value=value, low=value, high=value, unit="edges across the boundary")
    return Measured(estimate=estimate, how=How.EXACT, details=details)


def figure_core(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw the core from its table."""
    from matplotlib.figure import Figure

    from sfglab.soc.gateway.drawing import draw_core

    worlds = int(results.explorations["worlds"].sum())
    with house_style():
        figure = Figure(figsize=(14, 5.4))
        draw_core(figure.subplots())
        figure.suptitle(f"The gateway core (paper C, Fig. 4), from its table: {worlds} moments explored")
    return figure, {"worlds": worlds, "violations": int((results.explorations["violation"] != "").sum())}


def figure_mapping(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw the example of Fig. 8 in its three stages; the log only says which run it belongs to."""
    from matplotlib.figure import Figure

    from sfglab.soc.graph_drawing import draw_mapping

    graph = load_graph(find_project().data / str(results.config["graph_file"]))
    with house_style():
        figure = Figure(figsize=(14, 5.2))
        draw_mapping(map_communication(graph), figure)
    return figure, {"stages": results.stages.to_dict(orient="list")}


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw every figure of a run.

    Args:
        log: The run's log.

    Returns:
        Figure and the numbers that it shows, by the figure's name.
    """
    results = load_results(log)
    return {"gateway_core": figure_core(results), "graph_mapping": figure_mapping(results)}
