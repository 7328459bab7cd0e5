"""The fleets of paper A, section 5.3: which are started live, and which are simulated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sfglab.errors import InvalidValueError
from sfglab.lab.baselines import REAL, declare
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled

STANDARD = "standard"
#: Routed in the paper's way: the start order launches every process of an agent.
LAUNCHED = "launched"
#: In our way: the processes are there, with everything loaded, when the order comes; and agents offer what they
#: are, so that nobody has to be asked.
ROUTED = "routed"
COMPOSED = f"{REAL}, composed"  #: All nodes of an agent in one process, which is one participant.


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """Live fleets of one kind.

    Raises:
        InvalidValueError: There is no such mode, or an agent would have no peer or no node.
    """

    mode: str  #: ``standard``, ``launched``, ``routed``, or of real ROS 2 `REAL` or `COMPOSED`.
    agents: tuple[int, ...]  #: Sizes of the fleet.
    talkers: int = 10  #: Publishing nodes of each agent.
    listeners: int = 10  #: Subscribing nodes of each agent.
    repeats: int = 1  #: How often each fleet is started.
    #: From one agent's start to the next one's, seconds; 0 is all at once.
    pace_s: float = 0.0

    def __post_init__(self) -> None:
        modes = (STANDARD, LAUNCHED, ROUTED, REAL, COMPOSED)
        if self.mode not in modes:
            raise InvalidValueError("mode", self.mode, ", ".join(modes))
        if min(self.agents) < 2 or self.talkers + self.listeners < 1:
            given = f"{min(self.agents)} agents with {self.talkers} + {self.listeners} nodes"
            raise InvalidValueError(
                "stage", given, "fleets from 2 agents with at least one node each"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """Simulated fleets, see `simulated`."""

    agents: tuple[int, ...] = ()  #: Sizes of the fleet.
    talkers: int = 10  #: Publishing nodes of each agent.
    listeners: int = 10  #: Subscribing nodes of each agent.
    repeats: int = 1  #: How many seeds each.


_FLEETS = (2, 3, 4, 5, 6)
# Standard fleets of the paper's largest size with so few nodes that two cores carry them.
_FEW = tuple(
    Stage(mode=STANDARD, agents=(6,), talkers=n, listeners=n, repeats=3) for n in (1, 2, 3)
)
_PACES_S = {LAUNCHED: 2.5, ROUTED: 1.0}


def _beside(repeats: int, *fleets: tuple[int, int]) -> tuple[Stage, ...]:
    """Return fleets of agents with so many nodes of each role: of real ROS 2, and ours of the same."""
    return tuple(
        Stage(mode=mode, agents=(agents,), talkers=nodes, listeners=nodes, repeats=count)
        for agents, nodes in fleets
        for mode, count in ((REAL, repeats), (STANDARD, repeats), (ROUTED, 1))
    )


def _paced(repeats: int, **agents: tuple[int, ...]) -> tuple[Stage, ...]:
    """Return fleets of each mode at a pace that two cores carry; the largest also at two thirds of it."""
    return tuple(
        Stage(mode=mode, agents=sizes, repeats=repeats, pace_s=longer * _PACES_S[mode])
        for mode, all_sizes in agents.items()
        for sizes, longer in ((all_sizes, 1), (all_sizes[-1:], 1.5))
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    #: Live fleets; cells of one size and kind of agents are run side by side.
    stages: tuple[Stage, ...] = (
        *_paced(1, launched=(2, 4, 6), routed=(2, 4, 6)),
        *_FEW,
        Stage(mode=STANDARD, agents=(2, 3, 4, 6)),
        Stage(mode=LAUNCHED, agents=(6,)),
        Stage(mode=ROUTED, agents=(2, 4, 6)),
    )
    #: Fleets of real ROS 2 and ours beside them: at most 40 participants, as the busy cores in the log show
    #: that two carry; composed, the paper's largest.
    ros2: tuple[Stage, ...] = (*_beside(2, (2, 10), (4, 3)), Stage(mode=COMPOSED, agents=(6,)))
    #: Simulated fleets.
    simulated: Scale = Scale(agents=(2, 4, 6, 12, 25, 50, 100, 200, 500, 1000))
    #: When a fleet that is not complete is given up, seconds after its start.
    timeout_s: float = 120.0
    #: How far DDS uses multicast between agents: ``default`` is ROS 2's.
    multicast: str = "default"
    seed: int = 0  #: Seed of the order of cells, and of what is simulated.


@dataclass(frozen=True, slots=True, kw_only=True)
class Fleet:
    """A fleet and its agents' nodes."""

    mode: str  #: ``standard``, ``launched`` or ``routed``.
    agents: int  #: Size of the fleet.
    talkers: int = 10  #: Publishing nodes of each agent.
    listeners: int = 10  #: Subscribing nodes of each agent.


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell(Fleet):
    """A live fleet to be started once."""

    repeat: int  #: Which repetition.
    pace_s: float = 0.0  #: From one start to the next, seconds; 0 is all at once.


def host_names(count: int) -> list[str]:
    """Return the names of the hosts, which are their agents' too."""
    return [f"agent_{number}" for number in range(1, count + 1)]


def cells_of(config: Config, stages: tuple[Stage, ...] | None = None) -> list[Cell]:
    """Return the cells of some stages, else of the configuration's, in the order they are run.

    Fleets of one size with the same nodes follow each other in random order, standard among routed, so that a
    machine that slows down slows both; sizes are shuffled too.
    """
    groups: dict[tuple[int, int, int], list[Cell]] = {}
    for stage in config.stages if stages is None else stages:
        nodes = {"talkers": stage.talkers, "listeners": stage.listeners}
        for agents in stage.agents:
            group = groups.setdefault((agents, stage.talkers, stage.listeners), [])
            group += [
                Cell(mode=stage.mode, agents=agents, repeat=repeat, pace_s=stage.pace_s, **nodes)
                for repeat in range(stage.repeats)
            ]
    rng = np.random.default_rng(config.seed)
    shuffled = [list(groups.values())[i] for i in rng.permutation(len(groups))]
    return [group[i] for group in shuffled for i in rng.permutation(len(group))]


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
        "ros2": _beside(1, (2, 1)),
        "simulated": Scale(agents=(2, 10), talkers=2, listeners=1),
        "timeout_s": 20.0,
    },
    paper={
        "stages": (
            *_paced(20, launched=_FLEETS, routed=_FLEETS),
            *_FEW,
            *(
                Stage(mode=mode, agents=_FLEETS, repeats=120)
                for mode in (STANDARD, LAUNCHED, ROUTED)
            ),
            Stage(mode=ROUTED, agents=(2, 4, 6, 8, 12, 16), talkers=1, listeners=1, repeats=10),
        ),
        "ros2": (
            *_beside(20, (2, 10), (3, 6), (4, 3), (6, 2)),
            Stage(mode=COMPOSED, agents=_FLEETS, repeats=20),
        ),
        "simulated": Scale(agents=(2, 3, 4, 5, 6, 10, 20, 50, 100, 200, 500, 1000), repeats=5),
        "timeout_s": 300.0,
    },
    hosts=lambda c: host_names(
        max((n for stage in c.stages + c.ros2 for n in stage.agents), default=0)
    ),
    actors=(
        Actor("nodes", host="each agent", does="ROS 2 nodes of demo_nodes_cpp", count="2 or 20"),
        Actor("router", host="each agent", does="joins the agent's domain with the global one"),
        Actor("status provider", host="each agent", does="announces the agent"),
        Actor("discoverer", host="each agent", does="finds the peers"),
        Actor("peers", host="other agents", does="the same"),
    ),
    links=(
        Link("nodes", "peers", "standard: DDS discovery of all nodes", boundary="the network"),
        Link("nodes", "router", "routed: DDS discovery, which ends here"),
        Link("status provider", "router", "heartbeats, metadata"),
        Link("router", "discoverer", "peers' heartbeats, metadata"),
        Link("router", "peers", "heartbeats, metadata", boundary="the network"),
    ),
)

declare(exp, "Discovery, agents x nodes: real ROS 2 (rclpy, Fast DDS), its stand-in, and routed")


@exp.table("cell")
class FleetRow(Cell):
    """One fleet, started once."""

    cell: int  #: Counter from 0.
    #: From the last start order until the last agent had resolved all its peers, seconds.
    resolved_s: float
    #: Whether it was given up instead; `resolved_s` is then how long it was waited for.
    censored: bool
    signal_s: float  #: From the first start order to the last, seconds.
    window_s: float  #: From the first start order to the last reading of the meters, seconds.
    nodes_cpu_s: float  #: CPU time of the ROS 2 nodes in that window, seconds.
    components_cpu_s: float  #: CPU time of routers, status providers and discoverers, seconds.
    machine_percent: float  #: Everything else that ran on the machine, per cent of one core.
    steal_percent: float  #: Time the hypervisor took, per cent of one core.


@exp.table("host")
class HostRow:
    """One agent of a fleet."""

    cell: int  #: The cell.
    host: int  #: Which agent, from 0.
    resolved_s: float  #: From the last start order until it had resolved all its peers, seconds.
    #: Whether it was given up instead; `resolved_s` is then how long it was waited for.
    censored: bool
    own_bytes: float  #: Bytes that its interface received from the first start order until then.
    own_packets: float  #: Frames received until then.


@exp.table("simulated")
class SimulatedRow(Fleet):
    """One agent of a simulated fleet."""

    seed: int  #: Seed of the run.
    host: int  #: Which agent, from 0.
    #: From the start until it had resolved all its peers, simulated seconds; NaN of a fleet that is
    #: too large to be simulated.
    resolved_s: float
    rx_bytes: float  #: Bytes that its interface received until then, by a formula.
    censored: bool  #: Whether it was given up instead.
