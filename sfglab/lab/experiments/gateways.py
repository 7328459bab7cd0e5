"""The gateway core explored, and the communication mapping of Fig. 8: paper C, sections 3 and 5.

Exact: every interleaving of core and surroundings up to a bound, the same without the claim of the hardware's
topic and with every arrow bent, and the edges across the boundary of the paper's example in its three stages.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from sfglab.lab.checks import CheckRow
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiment import Experiment, Profiled
from sfglab.lab.figures import note
from sfglab.lab.paths import find_project
from sfglab.lab.runs import Run, lines_of
from sfglab.lab.stats import exactly
from sfglab.soc import carriages_per_message, crossing_edges, load_graph, map_communication
from sfglab.soc.exploration import explore
from sfglab.soc.gateway import (
    TABLE,
    Drive,
    Input,
    Move,
    Row,
    State,
    Table,
    arrows,
    draw_core,
    transitions,
)
from sfglab.soc.gateway_world import Bound, Step, World

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import pandas as pd
    from matplotlib.figure import Figure

    from sfglab.lab.bench import Bench
    from sfglab.lab.explore import Automaton, Parts
    from sfglab.soc.graph import Graph

_SMALL = (
    Bound(),
    Bound(subscribers=2),
    Bound(calls=2),
    Bound(port_messages=1),
    Bound(echoes=False),
)
_LARGER = (
    Bound(software=(3,), hardware=(3,)),
    Bound(software=(2, 1), hardware=(1, 1)),
    Bound(software=(4,), hardware=(4,), subscribers=2, calls=2),
)
_LARGEST = (
    Bound(software=(2, 1), hardware=(2, 1), subscribers=2),
    Bound(software=(2, 1), hardware=(2, 1), port_messages=2),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """How much is explored."""

    #: What is explored with the core's table, and with the one that does not claim.
    bounds: tuple[Bound, ...] = (*_SMALL, *_LARGER)
    bent: bool = True  #: Whether the same is asked of every table with one arrow bent.
    graph_file: str = "graphs/figure_8.yaml"  #: The example, in the data folder.
    seed: int = 0  #: For the other experiments' sake; nothing is drawn here.


exp = Experiment(
    "gateways",
    Config,
    where="C 3, 5",
    smoke={"bounds": _SMALL, "bent": False},
    paper={"bounds": (*_SMALL, *_LARGER, *_LARGEST)},
)
exp.table("check")(CheckRow)

_PAPER_SETS = {"A gateway", "B hardware", "C gateway", "D software", "E gateway"}
_PAPER_EDGES = {"A -> 8", "C -> 6", "9 -> E"}
#: Fig. 8 b, c and d.
STAGES = ("all topics in software", "topics in hardware", "topics in hardware, gateways")


@exp.table("exploration", "unclaimed")
class ExplorationRow:
    """One exploration of the core's table, or of one derived from it."""

    software: str  #: Messages of each software publisher.
    hardware: str  #: Messages of each hardware publisher.
    subscribers: int  #: Hardware subscribers besides the core.
    calls: int  #: Calls to the delegate that may wait.
    echoes: bool  #: Whether both topics return the core's own messages.
    port_messages: int  #: Whole messages that the core's port can store.
    worlds: int  #: Reachable moments.
    steps: int  #: Steps between them.
    depth: int  #: Length of the longest of the shortest ways.
    states: int  #: States of the core that occurred.
    violation: str  #: What was violated; empty: nothing.


@exp.table("stage")
@dataclass(frozen=True, slots=True, kw_only=True)
class StageRow:
    """One stage of the mapping of Fig. 8."""

    stage: str  #: One of `STAGES`.
    publications: int  #: Publishing edges across the boundary.
    subscriptions: int  #: Subscribing edges across the boundary.
    carriages: float  #: How often one message of every topic is carried across, together.
    mapped: str  #: Topics and what they are mapped to.
    left: str  #: The edges that are left across the boundary.


@exp.part("exploration", total=lambda config: 2 * len(config.bounds) + config.bent, timed=False)
def explore_core(bench: Bench[Config]) -> None:
    """Explore the core, the one that does not claim, and the bent ones."""
    visited: set[State] = set()
    for bound in bench.config.bounds:
        row, states = _explored(bound, TABLE)
        visited |= states
        bench.write("exploration", row)
        bench.advance(f"{row['worlds']} worlds")
        bench.write("unclaimed", _explored(bound, unclaimed(TABLE))[0])
        bench.advance("without the claim")
    bench.write("check", _coverage(visited))
    if bench.config.bent:
        bench.write("check", _bent())
        bench.advance("bent arrows")


@exp.part("mapping", timed=False)
def map_example(bench: Bench[Config]) -> None:
    """Map the example of Fig. 8."""
    bench.write_all("stage", _stages(load_graph(find_project().data / bench.config.graph_file)))


def _explored(bound: Bound, table: Table) -> tuple[dict[str, Any], frozenset[State]]:
    found = explore(bound, table)
    row = {
        "software": "+".join(map(str, bound.software)),
        "hardware": "+".join(map(str, bound.hardware)),
        **{
            name: getattr(bound, name)
            for name in ("subscribers", "calls", "echoes", "port_messages")
        },
        **{name: getattr(found, name) for name in ("worlds", "steps", "depth")},
        "states": len(found.visited),
        "violation": found.counterexample.property if found.counterexample else "",
    }
    return row, found.visited


def _coverage(visited: set[State]) -> CheckRow:
    example = ", ".join(state.name for state in State if state not in visited) or "all"
    check = "every state of the core occurs"
    return CheckRow(check=check, checked=len(State), held=len(visited), example=example)


def unclaimed(table: Table) -> Table:
    """Return a table in which every way to the claim of the hardware's topic leads straight to the sending."""
    sends = {
        s: row.moves[Input.GRANTED].to for s, row in table.items() if row.drive is Drive.CLAIM_HMT
    }
    found = {}
    for state, row in table.items():
        moves = {
            given: Move(sends.get(move.to, move.to), move.latch)
            for given, move in row.moves.items()
        }
        found[state] = Row(row.drive, moves)
    return found


def _bent() -> CheckRow:
    """Ask the same of every table with one arrow bent: what passes shows what the exploration cannot see."""
    arrows = [
        (s, row, given, move) for s, row in TABLE.items() for given, move in row.moves.items()
    ]
    bent = [(*arrow, to) for arrow in arrows for to in State if to is not arrow[-1].to]
    passed = []
    for state, row, given, move, to in bent:
        table = {**TABLE, state: Row(row.drive, {**row.moves, given: Move(to, move.latch)})}
        if explore(Bound(), table).counterexample is None:
            passed.append(f"{state.name} -{given.name}-> {to.name}")
    check, held = (
        "of the tables with one arrow bent, those that are caught",
        len(bent) - len(passed),
    )
    return CheckRow(check=check, checked=len(bent), held=held, example="; ".join(passed))


def _stages(graph: Graph) -> Iterator[StageRow]:
    for stage, mapped in zip(STAGES, map_communication(graph).stages, strict=True):
        crossing = crossing_edges(mapped)
        yield StageRow(
            stage=stage,
            publications=len(crossing.publications),
            subscriptions=len(crossing.subscriptions),
            carriages=sum(carriages_per_message(mapped, topic) for topic in mapped.topics),
            mapped=", ".join(f"{topic.name} {topic.mapping.value}" for topic in mapped.topics),
            left=", ".join(map(str, (*crossing.publications, *crossing.subscriptions))),
        )


@exp.claim("C-FSM", how=How.EXACT)
def core_holds(run: Run[Config]) -> Finding:
    """Return the share of bounds and states that hold."""
    explorations, checks = run["exploration"], run["check"]
    coverage = checks.iloc[0]
    held = (explorations["violation"] == "").sum() + coverage["held"]
    details = {
        "bounds explored": str(len(explorations)),
        "worlds": str(int(explorations["worlds"].sum())),
        "states that occur": f"{coverage['held']} of {coverage['checked']}",
    }
    if len(run["unclaimed"]):
        details["beyond the text"] = _why_it_claims(run["unclaimed"])
    if len(checks) > 1:
        details["bent tables that are caught"] = (
            f"{checks.iloc[1]['held']} of {checks.iloc[1]['checked']}"
        )
    share = float(held / (len(explorations) + coverage["checked"]))
    return Finding(estimate=exactly(share, "share of checks that hold"), details=details)


def _why_it_claims(unclaimed: pd.DataFrame) -> str:
    found = unclaimed["violation"][unclaimed["violation"] != ""]
    what = f" ({'; '.join(sorted(set(found)))})" if len(found) else ""
    share = f"{len(found)} of {len(unclaimed)} bounds are violated{what}"
    return f"the core claims the hardware's topic before it sends; without that {share}"


@exp.claim("C-MAP", how=How.EXACT)
def edges_left(run: Run[Config]) -> Finding:
    """Return how many edges are left across the boundary."""
    stages = run["stage"]
    edges = stages["publications"] + stages["subscriptions"]
    last = stages.iloc[-1]
    ends: dict[str, float] = {}
    for row in lines_of(stages):
        ends[f"publishing edges, {row.stage}"] = float(row.publications)
        ends[f"subscribing edges, {row.stage}"] = float(row.subscriptions)
    mapped = set(str(last["mapped"]).split(", "))
    ends["topics in another set than the text's, of 5"] = float(len(mapped ^ _PAPER_SETS) / 2)
    wrong = set(str(last["left"]).split(", ")) ^ _PAPER_EDGES
    ends["edges other than A -> 8, C -> 6, 9 -> E that are left"] = float(len(wrong))
    details = {
        "edges, by stage": " -> ".join(map(str, edges)),
        "carriages of one message a topic": " -> ".join(
            f"{carried:g}" for carried in stages["carriages"]
        ),
        "left": str(stages["left"].iloc[-1]),
        "which nodes the edges join": "is in the text only where it says so; the rest is our reading",
    }
    figure = exactly(float(edges.iloc[-1]), "edges across the boundary")
    return Finding(estimate=figure, details=details, ends=ends)


@exp.figure("gateway_core", size=(10, 5.4))
def draw_gateway(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the gateway core (Fig. 4): its states and transitions, from its table."""
    worlds = int(run["exploration"]["worlds"].sum())
    violations = int((run["exploration"]["violation"] != "").sum())
    draw_core(figure.subplots())
    figure.suptitle(
        f"The gateway core (C, Fig. 4): {violations} violations in {worlds:,} moments explored"
    )
    colors = "yellow: calls and answers of its delegate, blue: uses of the topic; dashed: not in the text"
    note(figure, f"exact; {colors}")
    return {"worlds": worlds, "violations": violations}


@exp.figure("graph_mapping", size=(10, 5.2))
def draw_stages(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the example of Fig. 8 in its three stages, from software alone to gateways."""
    from sfglab.soc.graph_drawing import draw_mapping

    draw_mapping(map_communication(load_graph(find_project().data / run.config.graph_file)), figure)
    edges = run["stage"]["publications"] + run["stage"]["subscriptions"]
    said = f"Gateways leave {edges.iloc[-1]} of {edges.iloc[0]} edges across the boundary"
    figure.suptitle(f"{said} (exact; paper: 10, 8 and 3)")
    return {"stages": run["stage"]}


def press_core(run: Sequence[Step] = ()) -> Automaton:
    """Return the core as a picture to press: an arrow gives its input to the state where the core stands.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """
    from sfglab.lab.explore.press import Automaton

    walked = {"a walk": inputs_of(run)} if run else {}
    return Automaton(
        "gateway core", transitions(), State.START, _draw_to_press, size=(10, 5), runs=walked
    )


def inputs_of(run: Sequence[Step]) -> list[Input]:
    """Return what the core was given in a walk, beats of a transfer left out."""
    states = [State.START, *(step.after.state for step in run if isinstance(step.after, World))]
    given = {(arrow.source, arrow.target): arrow.given for arrow in arrows()}
    return [given[pair] for pair in pairwise(states) if pair in given]


def _draw_to_press(figure: Figure) -> Parts:
    drawn = draw_core(figure.subplots())
    return {
        d if isinstance(d, State) else ((d.source, d.given),): artists
        for d, artists in drawn.items()
    }
