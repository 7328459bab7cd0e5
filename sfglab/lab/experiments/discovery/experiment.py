"""Configuration and tables of the experiment on fleet discovery."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import numpy as np

from sfglab.fields import Bounds, between
from sfglab.lab.bench import TableRow
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled

if TYPE_CHECKING:
    from collections.abc import Iterable

STANDARD: Final = "standard"
#: The paper's method: the start order launches all processes of an agent, and agents query each
#: other's metadata service.
LAUNCHED: Final = "launched"
#: The sfglab variant: all processes are loaded before the order, and agents publish descriptions.
ROUTED: Final = "routed"


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """Live fleets of one kind."""

    mode: Literal["standard", "launched", "routed"]  #: Method of discovery.
    agents: tuple[Annotated[int, Bounds(2)], ...]  #: Sizes of the fleet.
    talkers: int = between(10, 1)  #: Publishing nodes per agent.
    listeners: int = between(10, 1)  #: Subscribing nodes per agent.
    repeats: int = 1  #: Number of starts of each fleet.
    pace_s: float = 0.0  #: Time from one agent's start to the next one's, s; 0: all at once.


_FLEETS = (2, 3, 4, 5, 6)
# Standard fleets of the paper's largest size with so few nodes that two cores suffice: two numbers of
# nodes give the growth, and the third one tests it.
_FEW = tuple(
    Stage(mode=STANDARD, agents=(6,), talkers=n, listeners=n, repeats=3) for n in (1, 2, 3)
)


def _former(agents: Iterable[int], nodes: int, repeats: int) -> dict[str, Any]:
    """Return fleets in the form of the removed fields ``ros2`` and ``simulated``."""
    return {"agents": [*agents], "talkers": nodes, "listeners": nodes, "repeats": repeats}


def _former_ros2() -> list[dict[str, Any]]:
    """Return the removed field ``ros2`` of the log beside ROS 2."""
    fleets = []
    for agents, nodes in ((2, 10), (3, 6), (4, 3), (6, 2)):
        for mode, repeats in (("standard ROS 2", 20), (STANDARD, 20), (ROUTED, 1)):
            fleets.append({"mode": mode, **_former([agents], nodes, repeats)})
    fleets.append({"mode": "standard ROS 2, composed", **_former(_FLEETS, 10, 20)})
    return [{**fleet, "pace_s": 0.0} for fleet in fleets]


def paced(repeats: int, sizes: tuple[int, ...]) -> tuple[Stage, ...]:
    """Return fleets whose agents start one after the other; the largest fleet also starts at two thirds of the pace."""
    largest = sizes[-1:]
    return (
        Stage(mode=LAUNCHED, agents=sizes, repeats=repeats, pace_s=2.5),
        Stage(mode=LAUNCHED, agents=largest, repeats=repeats, pace_s=3.75),
        Stage(mode=ROUTED, agents=sizes, repeats=repeats, pace_s=1.0),
        Stage(mode=ROUTED, agents=largest, repeats=repeats, pace_s=1.5),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """Fleets and times of the run."""

    #: Live fleets. Those of one size with the same nodes follow each other.
    stages: tuple[Stage, ...] = (
        *paced(1, (2, 4, 6)),
        *_FEW,
        Stage(mode=STANDARD, agents=(2, 3, 4, 6)),
        Stage(mode=LAUNCHED, agents=(6,)),
        Stage(mode=ROUTED, agents=(2, 4, 6)),
    )
    #: Time from its start after which an incomplete fleet is given up, s.
    timeout_s: float = 120.0
    #: Use of multicast by DDS between agents: ``default`` is that of ROS 2.
    multicast: str = "default"
    seed: int = 0  #: Seed of the order of cells.


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A live fleet that is started once."""

    mode: str  #: Method of discovery, such as ``standard``.
    agents: int  #: Number of agents.
    talkers: int = 10  #: Publishing nodes per agent.
    listeners: int = 10  #: Subscribing nodes per agent.
    repeat: int  #: Number of the repetition.
    pace_s: float = 0.0  #: Time from one start to the next, s; 0: all at once.


def host_names(count: int) -> list[str]:
    """Return the names of the hosts, which are also the names of their agents."""
    return [f"agent_{number}" for number in range(1, count + 1)]


def cells_of(stages: tuple[Stage, ...], seed: int) -> list[Cell]:
    """Return the cells of stages in the order of the run.

    Fleets of one size with the same nodes start directly after each other, in random order, so that a machine that
    slows down affects all modes. The order of the sizes is also random.
    """
    groups: dict[tuple[int, int, int], list[Cell]] = {}
    for stage in stages:
        nodes = {"talkers": stage.talkers, "listeners": stage.listeners}
        for agents, repeat in product(stage.agents, range(stage.repeats)):
            cell = Cell(mode=stage.mode, agents=agents, repeat=repeat, pace_s=stage.pace_s, **nodes)
            groups.setdefault((agents, stage.talkers, stage.listeners), []).append(cell)
    rng = np.random.default_rng(seed)
    ordered = list(groups.values())
    rng.shuffle(ordered)
    for group in ordered:
        rng.shuffle(group)
    return [cell for group in ordered for cell in group]


exp = Experiment(
    "discovery",
    Config,
    where="A 4.1, 4.2, 5.3",
    smoke={
        "stages": (
            Stage(mode=STANDARD, agents=(2,), talkers=2, listeners=1),
            Stage(mode=ROUTED, agents=(2,), talkers=2, listeners=1),
            Stage(mode=LAUNCHED, agents=(2,), talkers=2, listeners=1, pace_s=0.5),
        ),
        "timeout_s": 20.0,
    },
    paper={
        "stages": (
            *paced(20, _FLEETS),
            *_FEW,
            Stage(mode=STANDARD, agents=_FLEETS, repeats=120),
            Stage(mode=LAUNCHED, agents=_FLEETS, repeats=120),
            Stage(mode=ROUTED, agents=_FLEETS, repeats=120),
            Stage(mode=ROUTED, agents=(2, 4, 6, 8, 12, 16), talkers=1, listeners=1, repeats=10),
        ),
        "timeout_s": 300.0,
    },
    hosts=lambda config: host_names(max((max(one.agents) for one in config.stages), default=0)),
    actors=(
        Actor(
            "nodes",
            host="each agent",
            does="stand-ins with the endpoints of demo_nodes_cpp",
            count="2 to 20",
        ),
        Actor(
            "router",
            host="each agent",
            does="forwards between the agent's domain and the global one",
        ),
        Actor("status provider", host="each agent", does="sends heartbeats, describes the agent"),
        Actor("discoverer", host="each agent", does="discovers the peers"),
        Actor("peers", host="other agents", does="the same processes"),
    ),
    links=(
        Link("nodes", "peers", "plain ROS 2: DDS discovery of all nodes", boundary="network"),
        Link("nodes", "router", "with routers: DDS discovery of the nodes goes no further"),
        Link("status provider", "router", "heartbeats, description"),
        Link("discoverer", "router", "paper's method: queries"),
        Link(
            "router",
            "peers",
            "with routers: routers' DDS discovery, heartbeats, descriptions, queries",
            boundary="network",
        ),
        Link(
            "peers", "router", "heartbeats, descriptions, queries of the peers", boundary="network"
        ),
        Link("router", "discoverer", "peers' heartbeats, descriptions"),
    ),
    removed={
        "ros2": {"paper": _former_ros2()},
        "simulated": {
            "quick": _former((2, 4, 6, 12, 25), 10, 1),
            "paper": _former((*_FLEETS, 10, 20, 50, 100, 200, 500, 1000), 10, 5),
        },
    },
)


@exp.table("cell")
class FleetRow(Cell, TableRow):
    """A live fleet that was started once."""

    cell: int  #: Number of the cell, from 0.
    window_s: float  #: Time from the first start order to the last reading of the meters, s.
    cpu_s: float  #: CPU time of all processes of the fleet in that window, s.


@exp.table("host")
class HostRow(TableRow):
    """An agent of a live fleet."""

    cell: int  #: Number of the cell.
    host: int  #: Number of the agent, from 0.
    #: Time from the last start order until the agent had discovered its peers, s.
    resolved_s: float
    #: Whether the wait for the agent was given up; `resolved_s` is then the duration of the wait.
    censored: bool
    #: Bytes received at the agent's interface from the first start order until it had discovered its peers.
    own_bytes: float
