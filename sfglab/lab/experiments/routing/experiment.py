"""Configuration, tables and the policy's checks of routing.

Every party publishes and subscribes to all names, so that a router that only checks the demand would forward all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.lab.bench import TableRow
from sfglab.lab.checks import CheckRow
from sfglab.lab.checks.routing import checks as policy_checks
from sfglab.lab.checks.routing import in_table_1
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.names import ResourceKind, dds_names

if TYPE_CHECKING:
    from sfglab.lab.bench import Bench

GLOBAL_DOMAIN = 0
OTHERS = ("ground_1", "ground_2")  #: Parties in the global domain.


def domains_of(agents: int) -> dict[str, int]:
    """Return the DDS domain of each party: agents have their own domains, the others are in the global domain."""
    own = {f"agent_{number}": number for number in range(1, agents + 1)}
    return own | dict.fromkeys(OTHERS, GLOBAL_DOMAIN)


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    #: Agents behind a router each; two parties in the global domain come in addition.
    agents: int = 3
    seconds: float = 6.0  #: Minimum time for which all parties publish, s.
    rate_hz: float = 10.0  #: Messages per second of every party on every topic.
    random_names: int = 20_000  #: Random DDS names that the policy is asked about.
    call_s: float = 1.0  #: Timeout of a call to a server that the caller must not reach, s.
    seed: int = 0  #: Seed of the random names.


exp = Experiment(
    "routing",
    Config,
    where="A 4.1",
    smoke={"agents": 2, "seconds": 2.5, "random_names": 500, "call_s": 0.5},
    paper={"agents": 6, "seconds": 20.0, "random_names": 200_000},
    hosts=lambda config: [*domains_of(config.agents)],
    actors=(
        Actor(
            "router",
            "agent_i",
            "joins agent domain D_i and global domain D_0",
            count="one per agent",
        ),
        Actor(
            "agent",
            "agent_i",
            "uses every name, in its domain D_i",
            count="2, 3 or 6",
        ),
        Actor("ground", "ground_i", "uses every name, in D_0 without a router", count="2"),
    ),
    links=(
        Link("agent", "router", "messages of Table 1 only"),
        Link("router", "ground", "these messages, also to other routers", boundary="network"),
        Link("ground", "router", "messages of Table 1 only", boundary="network"),
        Link("router", "agent", "these messages, also from other routers"),
    ),
)
exp.table("policy")(CheckRow)


@exp.table("party")
class PartyRow(TableRow):
    """A process that uses every topic and service, in both roles."""

    party: str  #: Name of the party and of its host.
    domain: int  #: DDS domain of the party; 0 is the global domain.


@exp.table("heard")
class HeardRow(TableRow):
    """Messages under one name that one party received from another."""

    name: str  #: ROS name.
    source: str  #: Party that publishes.
    hearer: str  #: Party that subscribes.
    sent: int  #: Number of messages that the source published.
    received: int  #: Number of messages that arrived.


@exp.table("endpoint")
class EndpointRow(TableRow):
    """An endpoint that a party in the global domain discovered there, and that no party there owns."""

    seen_by: str  #: Party that discovered the endpoint.
    dds_topic: str  #: DDS topic of the endpoint.
    kind: str  #: ``publisher`` or ``subscription``.
    #: Pair of domains of the endpoint's router; empty if the endpoint belongs to no router.
    router: str


@exp.table("call")
class CallRow(TableRow):
    """One call of a service."""

    name: str  #: ROS name.
    caller: str  #: Party that calls.
    server: str  #: Party that serves.
    answered: bool  #: Whether a response of that server arrived.


@exp.part("policy", timed=False)
def check_policy(bench: Bench[Config]) -> None:
    """Check the routing policy alone, without routers."""
    bench.write_all("policy", policy_checks.rows(bench.config.random_names, bench.config.seed))


def on_the_wire(service: str) -> tuple[str, ...]:
    """Return the DDS topics of a service: request and reply."""
    return dds_names(service, ResourceKind.SERVICE)


def may_cross(service: str) -> bool:
    """Return whether Table 1 names both DDS topics of a service."""
    return all(map(in_table_1, on_the_wire(service)))
