"""From the log to checks, latencies and the claim A-NET-RULES.

Everything here is computed from the log alone. A check is one thing that Table 1 or Eq. 1 of paper A demands
of one name and two parties; the claim is the share of checks that hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.fleet.policy import TABLE_1
from sfglab.lab.checks import share_of_checks
from sfglab.lab.claims import How, Measured
from sfglab.lab.experiments.routing.probes import in_table_1
from sfglab.lab.stats import Estimate, bootstrap, median_of
from sfglab.names import ResourceKind, dds_names
from sfglab.record import LogReader

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


GLOBAL = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """The tables of one run."""

    parties: pd.DataFrame  #: One line a party.
    #: One line a topic, source and hearer; ``allowed`` says whether Table 1 names the topic, ``across`` whether
    #: the two are in different domains.
    heard: pd.DataFrame
    endpoints: pd.DataFrame  #: What was seen in the global domain beside the parties' own endpoints.
    calls: pd.DataFrame  #: One line a service and caller, with ``allowed`` and ``across``.
    latched: pd.DataFrame  #: What late joiners heard of static transforms.
    policy: pd.DataFrame  #: The policy's own checks.
    config: dict[str, Any]  #: The run's configuration.
    hosts: dict[str, Any]  #: What the hosts were.


def load_results(log: Path) -> Results:
    """Read a run's tables.

    Args:
        log: The log.
    """
    with LogReader(log) as reader:
        heard, calls = reader.table("heard"), reader.table("call")
        heard["allowed"] = [in_table_1(name) for name in heard["dds_topic"]]
        heard["across"] = heard["source_domain"] != heard["hearer_domain"]
        calls["allowed"] = [all(map(in_table_1, _halves(name))) for name in calls["name"]]
        calls["across"] = calls["caller_domain"] != calls["server_domain"]
        return Results(
            parties=reader.table("party"),
            heard=heard,
            endpoints=reader.table("endpoint"),
            calls=calls,
            latched=reader.table("latched"),
            policy=reader.table("policy"),
            config=reader.metadata("config"),
            hosts=reader.metadata("hosts"),
        )


def _halves(service: str) -> tuple[str, ...]:
    return dds_names(service, ResourceKind.SERVICE)


def checks(results: Results) -> pd.DataFrame:
    """Return every kind of check: how it was made, how often, how often it held, and an example.

    The example is one that does not hold, if there is any.
    """
    live = pd.DataFrame([{"how": How.LIVE.value, **row} for row in _live(results)])
    exact = results.policy[["check", "checked", "held", "example"]].assign(how=How.EXACT.value)
    return pd.concat([live, exact], ignore_index=True)[["check", "how", "checked", "held", "example"]]


def _live(results: Results) -> Iterator[dict[str, Any]]:
    heard, calls, seen = results.heard, results.calls, results.endpoints
    across, arrived = heard[heard["across"]], heard[heard["received"] > 0]
    yield _check("an endpoint seen in the global domain is of Table 1", seen, lambda r: in_table_1(r.dds_topic))
    yield _check("an endpoint seen in the global domain is a router's", seen, lambda r: bool(r.router))
    yield _check(
        "a topic of Table 1 is heard in every other domain",
        across[across["allowed"]],
        lambda r: r.received > 0,
    )
    yield _check(
        "any other topic is not heard in another domain", across[~across["allowed"]], lambda r: not r.received
    )
    yield _check("every topic is heard in its own domain", heard[~heard["across"]], lambda r: r.received > 0)
    yield _rules(results)
    yield _check("no sample arrives twice or comes back", arrived, lambda r: not r.repeated)
    yield _check("samples of one source keep their order", arrived, lambda r: not r.disordered)
    yield _check("samples keep their source time stamps", arrived, lambda r: not r.restamped)
    transforms = arrived[arrived["dds_topic"].isin(["rt/tf", "rt/tf_static"])]
    yield _check("transforms bear their agent's prefix, outside it only", transforms, lambda r: not r.misnamed)
    yield _check("a late joiner hears each static transform once", results.latched, lambda r: r.received == 1)
    yield _check(
        "a service of Table 1 answers calls from other domains",
        calls[calls["across"] & calls["allowed"]],
        lambda r: r.answered,
    )
    yield _check(
        "any other service does not", calls[calls["across"] & ~calls["allowed"]], lambda r: not r.answered
    )


def _check(name: str, rows: pd.DataFrame, holds: Callable[[Any], Any]) -> dict[str, Any]:
    every = list(rows.itertuples())
    failed = [row for row in every if not holds(row)]
    example = _text((failed or every)[0]) if every else "nothing to check"
    # Without anything to look at a check has not held.
    checked = max(1, len(every))
    return {"check": name, "checked": checked, "held": len(every) - len(failed), "example": example}


def _text(row: Any) -> str:
    name = getattr(row, "dds_topic", None) or getattr(row, "name", "rt/tf_static")
    first = getattr(row, "source", None) or getattr(row, "caller", None) or getattr(row, "seen_by", "")
    last = getattr(row, "hearer", None) or getattr(row, "server", None) or getattr(row, "kind", "")
    return f"{name}: {first}, {last}"


def _rules(results: Results) -> dict[str, Any]:
    """Check that every row of Table 1 was seen to be open at every agent, both ways."""
    agents = [str(p.party) for p in results.parties.itertuples() if p.domain != GLOBAL]
    seen = set(_crossings(results))
    wanted = [(rule.pattern, agent, way) for rule in TABLE_1 for agent in agents for way in ("out", "in")]
    missing = [w for w in wanted if w not in seen]
    return {
        "check": "every rule is seen open at every agent, both ways",
        "checked": len(wanted),
        "held": len(wanted) - len(missing),
        "example": ", ".join((missing or wanted)[0]),
    }


def _crossings(results: Results) -> Iterator[tuple[str, str, str]]:
    """Yield rule, agent and way of everything that was seen to cross."""
    arrived = results.heard[results.heard["across"] & (results.heard["received"] > 0)]
    for row in arrived.itertuples():
        yield from _crossing(str(row.dds_topic), str(row.source), str(row.hearer))
    answered = results.calls[results.calls["across"] & results.calls["answered"]]
    for row in answered.itertuples():
        request, reply = _halves(str(row.name))
        yield from _crossing(request, str(row.caller), str(row.server))
        yield from _crossing(reply, str(row.server), str(row.caller))


def _crossing(dds: str, source: str, hearer: str) -> Iterator[tuple[str, str, str]]:
    for rule in TABLE_1:
        if rule.matches(dds):
            yield rule.pattern, source, "out"
            yield rule.pattern, hearer, "in"


def latencies(results: Results) -> dict[str, Estimate]:
    """Return the time from publishing to receiving on topics of Table 1, by what lies between.

    A sample is the median of one topic, source and hearer. ``per router`` is what one router and the hop
    behind it add: half of the way from agent to agent, less the way between two hosts of the global domain.
    Groups without samples are left out.
    """
    heard = results.heard
    chosen = heard[heard["allowed"] & (heard["source"] != heard["hearer"]) & (heard["received"] > 0)]
    routers = sum((chosen[side] != GLOBAL).astype(int) for side in ("source_domain", "hearer_domain"))
    renamed = chosen["dds_topic"] == "rt/tf"
    plain = ~renamed & (chosen["dds_topic"] != "rt/tf_static")
    groups = {
        "direct": plain & (routers == 0),
        "one router": plain & (routers == 1),
        "two routers": plain & (routers == 2),
        "one router, /tf": renamed & (routers == 1),
    }
    samples = {name: chosen[rows]["age_ms"].to_numpy(dtype=np.float64) for name, rows in groups.items()}
    found = {name: median_of(ages, unit="ms") for name, ages in samples.items() if len(ages)}
    if {"direct", "two routers"} <= set(found):
        found["per router"] = bootstrap(
            [samples["direct"], samples["two routers"]],
            lambda drawn: float(np.median(drawn[1]) - np.median(drawn[0])) / 2,
            unit="ms",
        )
    return found


def measure_claims(log: Path) -> dict[str, Measured]:
    """Return our figure for A-NET-RULES: the share of checks that hold.

    Of live and exact checks, whichever share is lower: there are so many exact ones that they would hide the
    others.
    """
    results = load_results(log)
    table, times = checks(results), latencies(results)
    share = share_of_checks(table, "how")
    details = {
        "hosts": str(results.hosts["description"]),
        "agents": str(results.config["agents"]),
        **{f"{group} checks": held for group, held in share.groups.items()},
        **{f"latency, {name}": str(estimate) for name, estimate in times.items()},
        "messages lost once a path was open": str(int(results.heard["missing"].sum())),
    }
    return {
        "A-NET-RULES": Measured(estimate=share.estimate, how=How.LIVE, details=details, reason=share.reason)
    }
