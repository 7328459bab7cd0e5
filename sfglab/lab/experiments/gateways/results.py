"""The module `gateways.results` has claims and figures on the core and the mapping, and a core that reacts to clicks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.lab.checks import share_of_checks
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.gateways.experiment import COVERAGE, Config, exp, mapped_example
from sfglab.lab.figures import note
from sfglab.lab.paper import paper
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import exactly
from sfglab.soc import STAGES, draw_mapping
from sfglab.soc.gateway import ADDED_STATES, State, transitions
from sfglab.soc.gateway_drawing import draw_core

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from sfglab.lab.explore import Automaton

PAPER_MAPPINGS = {"A gateway", "B hardware", "C gateway", "D software", "E gateway"}
PAPER_EDGES = {"A -> 8", "C -> 6", "9 -> E"}
"""Mappings and edges that the paper's text states for Fig. 8 d."""


@exp.claim("C-FSM", how=How.EXACT)
def core_holds(run: Run[Config]) -> Finding:
    """Return the share of bounds without a violation, or the share of states that occur if this share is lower."""
    holds = run["exploration"]["violation"] == ""
    coverage = share_of_checks(run, COVERAGE)
    share = min(float(holds.mean()), coverage.estimate.value)
    details = {
        "bounds without a violation": f"{holds.sum()} of {len(holds)}",
        "reachable states": str(run["exploration"]["worlds"].sum()),
        "states of the core that occur": coverage.groups[COVERAGE],
    }
    estimate = exactly(share, "share of checks that hold")
    violated = [text for text in run["exploration"]["violation"].unique() if text]
    reason = "; ".join(filter(None, [*violated, coverage.reason]))
    return Finding(estimate=estimate, details=details, reason=reason)


@derived
def edges(run: Run[Config]) -> pd.Series[int]:
    """Return the number of edges across the boundary in each stage."""
    stages = run["stage"].set_index("stage")
    return stages["publications"] + stages["subscriptions"]


@exp.claim("C-MAP", how=How.EXACT)
def edges_left(run: Run[Config]) -> Finding:
    """Return the number of edges that remain with gateways; the other ends are edges and mappings by stage."""
    ends = {}
    for stage in lines_of(run["stage"]):
        ends[f"publishing edges, {stage.stage}"] = float(stage.publications)
        ends[f"subscribing edges, {stage.stage}"] = float(stage.subscriptions)
    last = run["stage"].iloc[-1]
    other_mappings = PAPER_MAPPINGS.difference(last["mapped"].split(", "))
    ends["topics in another set than the text's, of 5"] = float(len(other_mappings))
    other_edges = PAPER_EDGES.symmetric_difference(last["left"].split(", "))
    ends["edges other than A -> 8, C -> 6, 9 -> E that are left"] = float(len(other_edges))
    details = {
        "edges left": last["left"],
        "assumed": "which nodes the edges join, where the text does not state it",
    }
    estimate = exactly(float(edges(run).iloc[-1]), "edges across the boundary")
    return Finding(estimate=estimate, details=details, ends=ends)


@exp.figure("gateway_core", size=(10, 5.4))
def draw_gateway(figure: Figure, run: Run[Config]) -> None:
    """Draw the states of the gateway core (Fig. 4) as boxes and its transitions as arrows, polling in the middle."""
    found = run["exploration"]
    violations = (found["violation"] != "").sum()
    draw_core(figure.subplots())
    figure.suptitle(
        f"The gateway core (Fig. 4) with {len(ADDED_STATES)} added states: "
        f"{violations} violations in {len(found)} explorations"
    )
    note(
        figure,
        "yellow state: uses the delegate over its interface, OSIF; blue: uses the hardware-mapped topic, HMT; "
        "white: compares publisher IDs\n"
        "SMT: software-mapped topic; dashed: added by us; italic: action of the state; own: sent by the core "
        "itself; foreign: sent by a node",
    )


@exp.figure("graph_mapping", size=(10, 5.2))
def draw_stages(figure: Figure, run: Run[Config]) -> None:
    """Draw the example of Fig. 8 in its three stages, from software alone to gateways."""
    draw_mapping(mapped_example(run.config), figure)
    in_software, in_hardware, by_gateways = edges(run)
    stated = [paper("C-MAP", STAGES[0]), paper("C-MAP", STAGES[1]), paper("C-MAP")]
    numbers = ", ".join(f"{value:g}" for value in stated)
    figure.suptitle(
        f"{in_software} edges cross the boundary with all topics in software, {in_hardware} with "
        f"topics in hardware, {by_gateways} with gateways\n(paper: {numbers}; the graph is completed so "
        f"that {stated[0]:g} and {stated[1]:g} come out)"
    )


def press_core() -> Automaton:
    """Return a clickable diagram of the core; a click on a transition applies its input to the transition table.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """
    from sfglab.lab.explore.press import Automaton

    table = {key: (target, ()) for key, target in transitions().items()}
    return Automaton(
        "gateway core",
        table,
        State.START,
        lambda figure: draw_core(figure.subplots()),
        size=(10, 5),
    )
