"""The module `gateways.experiment` has configuration, tables and parts of the experiment on core and mapping.

The experiment computes both of its parts; no value is measured or sampled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.lab.bench import TableRow
from sfglab.lab.checks import CheckRow
from sfglab.lab.experiment import Experiment, Profiled
from sfglab.lab.paths import find_project
from sfglab.soc import (
    STAGES,
    EdgeKind,
    carriages_per_message,
    crossing_edges,
    load_graph,
    map_communication,
)
from sfglab.soc.exploration import explore
from sfglab.soc.gateway import State
from sfglab.soc.gateway_world import Bound

if TYPE_CHECKING:
    from sfglab.lab.bench import Bench
    from sfglab.soc import CommunicationMapping

SMALL = (
    Bound(),
    Bound(subscribers=2),
    Bound(calls=2),
    Bound(port_messages=1),
    Bound(echoes=False),
)
LARGER = (
    Bound(software=(3,), hardware=(3,)),
    Bound(software=(2, 1), hardware=(1, 1)),
    Bound(software=(4,), hardware=(4,), subscribers=2, calls=2),
)
LARGEST = (
    Bound(software=(2, 1), hardware=(2, 1), subscribers=2),
    Bound(software=(2, 1), hardware=(2, 1), port_messages=2),
)
#: Name of the check that every state of the core occurs.
COVERAGE = "every state of the core occurs"


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The `Config` has the bounds of the exploration, and the graph whose topics the experiment maps."""

    #: Bounds up to which the experiment explores the core.
    bounds: tuple[Bound, ...] = (*SMALL, *LARGER)
    graph_file: str = "graphs/figure_8.yaml"  #: File of the paper's example, in the data folder.
    seed: int = 0  #: Seed that every experiment has; this experiment uses no seed.


exp = Experiment(
    "gateways",
    Config,
    where="C 3, 5",
    smoke={"bounds": SMALL},
    paper={"bounds": (*SMALL, *LARGER, *LARGEST)},
)
exp.table("check")(CheckRow)


@exp.table("exploration")
class ExplorationRow(TableRow):
    """An `ExplorationRow` is one exploration of the core and its surroundings."""

    software: str  #: Number of messages of each software publisher.
    hardware: str  #: Number of messages of each hardware publisher.
    subscribers: int  #: Number of hardware subscribers besides the core.
    calls: int  #: Number of calls to the delegate that may wait.
    echoes: bool  #: Whether both topics return the core's own messages to the core.
    port_messages: int  #: Number of whole messages that the core's port can store.
    worlds: int  #: Number of reachable states of the core with its surroundings.
    violation: str  #: Property that a step violated; empty if no step violated a property.


@exp.table("stage")
class StageRow(TableRow):
    """A `StageRow` is one stage of the mapping in Fig. 8."""

    stage: str  #: One of `STAGES`.
    publications: int  #: Number of publishing edges across the boundary.
    subscriptions: int  #: Number of subscribing edges across the boundary.
    #: Number of transfers over the memory interface, for one message of each topic.
    carriages: float
    mapped: str  #: Topics with the mapping of each topic.
    left: str  #: Edges that cross the boundary.


@exp.part("exploration", total=lambda config: len(config.bounds), timed=False)
def explore_core(bench: Bench[Config]) -> None:
    """Explore the core in every order of events up to each bound."""
    visited: set[State] = set()
    for bound in bench.config.bounds:
        found = explore(bound)
        visited |= found.visited
        row = ExplorationRow(
            software="+".join(map(str, bound.software)),
            hardware="+".join(map(str, bound.hardware)),
            subscribers=bound.subscribers,
            calls=bound.calls,
            echoes=bound.echoes,
            port_messages=bound.port_messages,
            worlds=found.worlds,
            violation=found.counterexample.property if found.counterexample else "",
        )
        bench.write(row)
        bench.advance(f"{found.worlds} reachable worlds")
    for state in State:
        bench.cases[COVERAGE].append((state.name, state in visited))


def mapped_example(config: Config) -> CommunicationMapping:
    """Return the mappings of the paper's example."""
    return map_communication(load_graph(find_project().data / config.graph_file))


@exp.part("mapping", timed=False)
def map_example(bench: Bench[Config]) -> None:
    """Count the edges across the boundary in each stage."""
    stages = mapped_example(bench.config).stages
    for stage, graph in zip(STAGES, stages, strict=True):
        crossing = crossing_edges(graph)
        kinds = [edge.kind for edge in crossing]
        carriages = [carriages_per_message(graph, topic) for topic in graph.topics]
        mapped = [f"{topic.name} {topic.mapping.value}" for topic in graph.topics]
        row = StageRow(
            stage=stage,
            publications=kinds.count(EdgeKind.PUBLISH),
            subscriptions=kinds.count(EdgeKind.SUBSCRIBE),
            carriages=sum(carriages),
            mapped=", ".join(mapped),
            left=", ".join(map(str, crossing)),
        )
        bench.write(row)
