"""One run: explore, bend and map, into one log; nothing depends on the machine's speed."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from sfglab.lab.checks import CheckRow
from sfglab.lab.experiments.gateways.rows import STAGES, ExplorationRow, StageRow
from sfglab.lab.paths import find_project
from sfglab.lab.progress import progress_bar
from sfglab.record import LogWriter, run_context
from sfglab.soc import carriages_per_message, crossing_edges, load_graph, map_communication
from sfglab.soc.gateway import TABLE, Bound, Drive, Input, Move, Row, State, Table, explore

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from sfglab.lab.experiments.gateways.config import Config
    from sfglab.soc.graph import Graph


def run(config: Config, path: Path) -> Path:
    """Explore, bend and map; nothing depends on the machine's speed.

    Args:
        config: How much.
        path: The log.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with LogWriter(path) as log, progress_bar(2 * len(config.bounds) + config.bent, "gateways") as advance:
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": "gateways", **asdict(config)})
        visited: set[State] = set()
        for place, bound in enumerate(config.bounds):
            row, states = _explored(bound, TABLE)
            visited |= states
            log.write_row("exploration", row, log_time_ns=place)
            advance(f"{row.worlds} worlds")
            row, _ = _explored(bound, unclaimed(TABLE))
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


def unclaimed(table: Table) -> Table:
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
