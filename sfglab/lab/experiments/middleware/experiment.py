"""Configuration and tables of the comparison of DDS and Zenoh between agents."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Annotated, Final

import numpy as np

from sfglab.fields import Bounds, between
from sfglab.lab.bench import TableRow
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.experiments.discovery.experiment import (
    Cell,
    FleetRow,
    HostRow,
    host_names,
)

STANDARD: Final = "standard"  #: Plain ROS 2: all nodes are in one DDS domain.
#: Routers over DDS; agents query each other's descriptions, as in paper A.
ASKING: Final = "asking"
PUBLISHED: Final = "published"  #: Routers over DDS; agents publish their descriptions.
#: Routers over Zenoh, as clients of one hub; its process and host have this name.
HUB: Final = "hub"
PEERS: Final = "peers"  #: Routers over Zenoh, as peers of each other.
WAYS = (STANDARD, ASKING, PUBLISHED, HUB, PEERS)
DATA_WAYS = (STANDARD, PUBLISHED, HUB, PEERS)
"""Ways of data; descriptions do not change the path of data between routers."""
RATES_HZ: Final = {"message": 50.0, "image": 30.0}
"""Rate of each kind of flow: a text of 64 B, and an image of 921,600 B."""
FLOWS = tuple(product(RATES_HZ, DATA_WAYS))
"""Kinds and ways of all flows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """Fleets, flows and times of the run."""

    agents: tuple[Annotated[int, Bounds(2, 16)], ...] = (2, 6)  #: Sizes of fleets of processes.
    talkers: int = between(2, 1)  #: Publishing nodes per agent of these fleets.
    listeners: int = between(2, 1)  #: Subscribing nodes per agent.
    repeats: int = between(1, 1)  #: Number of starts of each of these fleets.
    pace_s: float = 0.5  #: Time from one agent's start to the next one's, s.
    timeout_s: float = 60.0  #: Time after which an incomplete fleet is given up, s.
    #: Sizes of fleets of Zenoh sessions.
    sessions: tuple[Annotated[int, Bounds(2, 1000)], ...] = (10, 100, 1000)
    heartbeats_hz: float = 100.0  #: Heartbeats per second, of all sessions of a fleet together.
    idle_s: float = 3.0  #: Time for which sessions are observed without heartbeats, s.
    flow_repeats: int = between(5, 1)  #: Number of measurements of each flow.
    flow_s: float = 0.7  #: Duration of one such measurement, s.
    seed: int = 0  #: Seed of the order of measurements.


def fleets_of(config: Config) -> list[Cell]:
    """Return the live fleets in the order of the run: in random order by size, the ways of a size one after another."""
    rng = np.random.default_rng(config.seed)
    cells: list[Cell] = []
    for repeat, agents in product(range(config.repeats), rng.permutation(config.agents).tolist()):
        for way in rng.permutation(WAYS).tolist():
            cell = Cell(
                mode=way,
                agents=agents,
                repeat=repeat,
                talkers=config.talkers,
                listeners=config.listeners,
                pace_s=config.pace_s,
            )
            cells.append(cell)
    return cells


exp = Experiment(
    "middleware",
    Config,
    where="A 4.1, 5.3, outlook",
    smoke={
        "agents": (2,),
        "talkers": 1,
        "listeners": 1,
        "pace_s": 0.2,
        "timeout_s": 20.0,
        "sessions": (10,),
        "idle_s": 1.0,
        "flow_repeats": 1,
        "flow_s": 0.3,
    },
    paper={
        "agents": (2, 3, 4, 5, 6),
        "repeats": 20,
        "timeout_s": 300.0,
        "sessions": (10, 30, 100, 300, 1000),
        "idle_s": 30.0,
        "flow_repeats": 40,
        "flow_s": 4.0,
    },
    hosts=lambda config: [*host_names(max(config.agents)), HUB],
    actors=(
        Actor("nodes", "agent_i", "ROS 2 nodes, status provider, discoverer"),
        Actor("router", "agent_i", "joins the agent's DDS domain and the network between agents"),
        Actor("hub", "hub", "Zenoh router, in one of the ways"),
        Actor("peers", "other agents", "the same processes as agent_i"),
    ),
    links=(
        Link("nodes", "router", "topics, services, heartbeats, descriptions"),
        Link("nodes", "peers", "plain ROS 2: all nodes in one domain", boundary="network"),
        Link("router", "peers", "routers over DDS: one global domain", boundary="network"),
        Link("router", "peers", "Zenoh peers", over="Zenoh", boundary="network"),
        Link("router", "hub", "Zenoh clients of the hub", over="Zenoh", boundary="network"),
        Link("hub", "peers", "Zenoh clients of the hub", over="Zenoh", boundary="network"),
    ),
)
exp.table("cell")(FleetRow)
exp.table("host")(HostRow)


@exp.table("sessions")
class SessionsRow(TableRow):
    """A fleet of Zenoh sessions that are clients of one hub."""

    agents: int  #: Number of sessions.
    #: Time from the first start until each session had received a heartbeat of each other one, s.
    known_s: float
    presence_bytes: float  #: Bytes received per session in that time.
    hub_cpu_s: float  #: CPU time of the hub in that time, s.
    descriptions: int  #: Number of descriptions that one session got at once, its own included.
    #: Bytes received per session if each session also gets all descriptions: as measured for one session.
    described_bytes: float
    idle_bps: float  #: Bytes per second received per session without heartbeats.


@exp.table("flow")
class FlowRow(TableRow):
    """One measurement of a flow between two agents."""

    repeat: int  #: Number of the repetition.
    way: str  #: One of `DATA_WAYS`.
    kind: str  #: ``message`` or ``image``.
    sent: int  #: Number of sent messages.
    received: int  #: Number of received messages.
    #: Median latency from publication until the subscriber has the message, ms; the duration if none arrived.
    latency_ms: float
    cpu_ms: float  #: CPU time per sent message of publisher, subscriber, routers and hub, ms.
