"""Runs of routing: the policy's checks, then who hears what of whom, and what is seen in the global domain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import entries
from sfglab.fleet.router.plan import ROUTER_KEY
from sfglab.lab.checks import CheckRow
from sfglab.lab.checks.routing import checks as policy_checks
from sfglab.lab.checks.routing import in_table_1
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.experiments.routing.stage import (
    ANSWER_S,
    GLOBAL_DOMAIN,
    PartyRow,
    Stage,
    parties_of,
    service_names,
)
from sfglab.names import ResourceKind, dds_names, dds_topic
from sfglab.units import NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.lab.bench import Bench

LATE_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    agents: int = 3  #: Agents behind a router each; two parties in the global domain come in addition.
    seconds: float = 6.0  #: How long everybody talks at least, seconds.
    rate_hz: float = 10.0  #: Messages a second of every party on every topic.
    busy: int = 20  #: Further local topics of every agent.
    random_names: int = 20_000  #: Random DDS names that the policy is asked about.
    call_s: float = 1.0  #: How long a caller waits for a server that it must not reach, seconds.
    seed: int = 0  #: Seed of the random names.


exp = Experiment(
    "routing",
    Config,
    where="A 4.1",
    smoke={"agents": 2, "seconds": 2.5, "busy": 3, "random_names": 500, "call_s": 0.5},
    paper={"agents": 6, "seconds": 20.0, "busy": 50, "random_names": 200_000},
    hosts=lambda config: [party.host for party in parties_of(config.agents)],
    actors=(
        Actor("router", "agent_i", "at the border of D_i and D_0", count="one an agent"),
        Actor("agent", "agent_i", "publishes, subscribes, serves and calls every name", count="2 to 6"),
        Actor("ground", "ground_i", "the same in the global domain", count="2"),
    ),
    links=(
        Link("agent", "router", "all names"),
        Link("router", "agent", "what Table 1 names"),
        Link("router", "ground", "what Table 1 names", boundary="the border"),
        Link("ground", "router", "all names", boundary="the border"),
    ),
)
exp.table("policy")(CheckRow)
exp.table("party")(PartyRow)


@exp.table("heard")
class HeardRow:
    """What one party heard of another under one name."""

    name: str  #: ROS name.
    dds_topic: str  #: The same on the wire.
    source: str  #: Who published.
    hearer: str  #: Who subscribed.
    source_domain: int  #: Where the source is.
    hearer_domain: int  #: Where the hearer is.
    sent: int  #: Messages that the source published.
    received: int  #: Messages that arrived, repeated ones counted again.
    repeated: int  #: Messages that arrived more than once.
    disordered: int  #: Messages that arrived after a later one.
    restamped: int  #: Messages whose source time stamp is not the publisher's.
    missing: int  #: Messages missing between the first and the last that arrived.
    misnamed: int  #: Transforms whose frame does not bear its source's prefix.
    age_ms: float  #: Median time from publishing to receiving, milliseconds; NaN when nothing arrived.


@exp.table("endpoint")
class EndpointRow:
    """An endpoint that somebody in the global domain saw there and that is no party's own."""

    seen_by: str  #: Who saw it.
    dds_topic: str  #: Its topic on the wire.
    kind: str  #: ``publisher`` or ``subscription``.
    router: str  #: Which pair of domains its router serves; empty when it is no router's.


@exp.table("call")
class CallRow:
    """One call of a service."""

    name: str  #: ROS name.
    caller: str  #: Who called.
    server: str  #: Who serves.
    caller_domain: int  #: Where the caller is.
    server_domain: int  #: Where the server is.
    answered: bool  #: Whether an answer of that server came.


@exp.table("latched")
class LatchedRow:
    """What a party that subscribed static transforms late heard of one that had published them once."""

    source: str  #: Who published.
    hearer: str  #: Who came late.
    received: int  #: Messages that arrived.


@exp.part("policy", timed=False)
def check_policy(bench: Bench[Config]) -> None:
    """Check the policy by itself."""
    bench.write_all("policy", policy_checks.rows(bench.config.random_names, bench.config.seed))


@exp.part("fleet", total=3)
async def observe(bench: Bench[Config]) -> None:
    """Let everybody talk, join late, call, and tell."""
    config = bench.config
    async with Stage(config, bench.testbed) as stage:
        bench.write_all("party", stage.parties)
        sent = await stage.talk(config.seconds)
        bench.advance("talked")
        late = await stage.ask_all("late", do="late", expected=len(stage.parties), timeout_s=LATE_S)
        calls = await _call(stage, config.call_s)
        bench.advance("called")
        told = await stage.ask_all("told", do="tell")
        bench.write_all("call", calls)
        bench.write_all("latched", _latched_rows(stage, late))
        bench.write_all("heard", _heard_rows(stage, sent, told))
        bench.write_all("endpoint", _endpoint_rows(stage, told))
        bench.advance("told")


def halves(service: str) -> tuple[str, ...]:
    """Return the names of a service's request and reply on the wire."""
    return dds_names(service, ResourceKind.SERVICE)


def may_cross(service: str) -> bool:
    """Return whether Table 1 names both halves of a service."""
    return all(map(in_table_1, halves(service)))


async def _call(stage: Stage, call_s: float) -> list[dict[str, Any]]:
    """Let everybody call everybody else's services: first those that must answer, however late."""
    servers = {name: party for party in stage.parties for name in service_names(party.party)}
    answers: dict[str, dict[str, str]] = {party.party: {} for party in stage.parties}
    for must, timeout_s in ((True, ANSWER_S / 2), (False, call_s)):
        names = [name for name in servers if may_cross(name) is must]
        reports = await stage.ask_all("called", do="call", names=names, timeout_s=timeout_s)
        for caller, report in reports.items():
            answers[caller] |= zip(names, report["answers"], strict=True)
    return [
        {
            "name": name,
            "caller": caller.party,
            "server": server.party,
            "caller_domain": caller.domain,
            "server_domain": server.domain,
            "answered": answers[caller.party][name] == server.party,
        }
        for caller in stage.parties
        for name, server in servers.items()
        if caller != server
    ]


def _latched_rows(stage: Stage, late: dict[str, dict[str, Any]]) -> Iterator[dict[str, Any]]:
    for hearer, report in late.items():
        for party in stage.parties:
            received = report["received"].get(party.party, 0)
            yield {"source": party.party, "hearer": hearer, "received": received}


def _heard_rows(
    stage: Stage, sent: dict[str, int], told: dict[str, dict[str, Any]]
) -> Iterator[dict[str, Any]]:
    parties = {party.party: party for party in stage.parties}
    heard = {
        (hearer, entry["name"], entry["source"]): entry
        for hearer, report in told.items()
        for entry in report["heard"]
    }
    for topic in stage.topics:
        for source in topic.publishers:
            for hearer in topic.subscribers:
                entry = heard.get((hearer, topic.name, source), {})
                count = 1 if topic.latched else sent[source]
                yield _heard_row(topic.name, parties[source], parties[hearer], count, entry)


def _heard_row(
    name: str, source: PartyRow, hearer: PartyRow, sent: int, entry: dict[str, Any]
) -> dict[str, Any]:
    age_ns = entry.get("age_ns")
    counts = ("received", "repeated", "disordered", "restamped", "missing", "misnamed")
    return {
        "name": name,
        "dds_topic": dds_topic(name),
        "source": source.party,
        "hearer": hearer.party,
        "source_domain": source.domain,
        "hearer_domain": hearer.domain,
        "sent": sent,
        "age_ms": float("nan") if age_ns is None else age_ns / NS_PER_MS,
        **{key: entry.get(key, 0) for key in counts},
    }


def _endpoint_rows(stage: Stage, told: dict[str, dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield what parties in the global domain saw there beside each other's endpoints."""
    others = [party.party for party in stage.parties if party.domain == GLOBAL_DOMAIN]
    own = {told[party]["participant"] for party in others}
    for party in others:
        for dds, kind, owner, tag in told[party]["endpoints"]:
            if owner not in own:
                router = entries(tag.encode()).get(ROUTER_KEY, "")
                yield {"seen_by": party, "dds_topic": dds, "kind": kind, "router": router}
