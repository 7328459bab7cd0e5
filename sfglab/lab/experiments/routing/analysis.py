"""Checks, latencies and the claim A-NET-RULES.

A check is one thing that Table 1 or Eq. 1 of paper A demands of one name and two parties; the claim is the
share of checks that hold. They are black-box measurements: what test peers saw, and when.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.fleet.policy import TABLE_1
from sfglab.lab.checks import CheckRow, check_row, share_of_checks
from sfglab.lab.checks.routing import in_table_1
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.routing.experiment import Config, exp
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, bootstrap, median_of
from sfglab.names import ResourceKind, dds_names

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

GLOBAL = 0


@derived
def heard(run: Run[Config]) -> pd.DataFrame:
    """Return one line a topic, source and hearer.

    ``allowed`` says whether Table 1 names the topic, ``across`` whether the two are in different domains.
    """
    table = run["heard"]
    return table.assign(
        allowed=[in_table_1(name) for name in table["dds_topic"]],
        across=table["source_domain"] != table["hearer_domain"],
    )


@derived
def calls(run: Run[Config]) -> pd.DataFrame:
    """Return one line a service and caller, with ``allowed`` and ``across``."""
    table = run["call"]
    return table.assign(
        allowed=[all(map(in_table_1, _halves(name))) for name in table["name"]],
        across=table["caller_domain"] != table["server_domain"],
    )


def _halves(service: str) -> tuple[str, ...]:
    return dds_names(service, ResourceKind.SERVICE)


@derived
def checks(run: Run[Config]) -> pd.DataFrame:
    """Return every kind of check: how it was made, how often, how often it held, and an example.

    The example is one that does not hold, if there is any.
    """
    live = pd.DataFrame([{"how": How.LIVE.value, **asdict(row)} for row in _live(run)])
    exact = run["policy"].assign(how=How.EXACT.value)
    return pd.concat([live, exact], ignore_index=True)[["check", "how", "checked", "held", "example"]]


def _live(run: Run[Config]) -> Iterator[CheckRow]:
    every, called, seen = heard(run), calls(run), run["endpoint"]
    across, arrived = every[every["across"]], every[every["received"] > 0]
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
    yield _check("every topic is heard in its own domain", every[~every["across"]], lambda r: r.received > 0)
    yield _rules(run)
    yield _check("no sample arrives twice or comes back", arrived, lambda r: not r.repeated)
    yield _check("samples of one source keep their order", arrived, lambda r: not r.disordered)
    yield _check("samples keep their source time stamps", arrived, lambda r: not r.restamped)
    transforms = arrived[arrived["dds_topic"].isin(["rt/tf", "rt/tf_static"])]
    yield _check("transforms bear their agent's prefix, outside it only", transforms, lambda r: not r.misnamed)
    yield _check("a late joiner hears each static transform once", run["latched"], lambda r: r.received == 1)
    yield _check(
        "a service of Table 1 answers calls from other domains",
        called[called["across"] & called["allowed"]],
        lambda r: r.answered,
    )
    yield _check(
        "any other service does not", called[called["across"] & ~called["allowed"]], lambda r: not r.answered
    )


def _check(name: str, rows: pd.DataFrame, holds: Callable[[Any], Any]) -> CheckRow:
    return check_row(name, ((_text(row), bool(holds(row))) for row in rows.itertuples()))


def _text(row: Any) -> str:
    name = getattr(row, "dds_topic", None) or getattr(row, "name", "rt/tf_static")
    first = getattr(row, "source", None) or getattr(row, "caller", None) or getattr(row, "seen_by", "")
    last = getattr(row, "hearer", None) or getattr(row, "server", None) or getattr(row, "kind", "")
    return f"{name}: {first}, {last}"


def _rules(run: Run[Config]) -> CheckRow:
    """Check that every row of Table 1 was seen to be open at every agent, both ways."""
    agents = [str(p.party) for p in run["party"].itertuples() if p.domain != GLOBAL]
    seen = set(_crossings(run))
    wanted = [(rule.pattern, agent, way) for rule in TABLE_1 for agent in agents for way in ("out", "in")]
    cases = ((", ".join(w), w in seen) for w in wanted)
    return check_row("every rule is seen open at every agent, both ways", cases)


def _crossings(run: Run[Config]) -> Iterator[tuple[str, str, str]]:
    """Yield rule, agent and way of everything that was seen to cross."""
    every = heard(run)
    arrived = every[every["across"] & (every["received"] > 0)]
    for row in arrived.itertuples():
        yield from _crossing(str(row.dds_topic), str(row.source), str(row.hearer))
    called = calls(run)
    answered = called[called["across"] & called["answered"]]
    for row in answered.itertuples():
        request, reply = _halves(str(row.name))
        yield from _crossing(request, str(row.caller), str(row.server))
        yield from _crossing(reply, str(row.server), str(row.caller))


def _crossing(dds: str, source: str, hearer: str) -> Iterator[tuple[str, str, str]]:
    for rule in TABLE_1:
        if rule.matches(dds):
            yield rule.pattern, source, "out"
            yield rule.pattern, hearer, "in"


@derived
def latencies(run: Run[Config]) -> dict[str, Estimate]:
    """Return the time from publishing to receiving on topics of Table 1, by what lies between.

    A sample is the median of one topic, source and hearer. ``per router`` is what one router and the hop
    behind it add: half of the way from agent to agent, less the way between two hosts of the global domain.
    Groups without samples are left out.
    """
    every = heard(run)
    chosen = every[every["allowed"] & (every["source"] != every["hearer"]) & (every["received"] > 0)]
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


@exp.claim("A-NET-RULES", how=How.LIVE)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of checks that hold.

    Of live and exact checks, whichever share is lower: there are so many exact ones that they would hide the
    others.
    """
    table, times = checks(run), latencies(run)
    share = share_of_checks(table, "how")
    details = {
        "hosts": str(run.metadata("hosts")["description"]),
        "agents": str(run.config.agents),
        **{f"{group} checks": held for group, held in share.groups.items()},
        **{f"latency, {name}": str(estimate) for name, estimate in times.items()},
        "messages lost once a path was open": str(int(heard(run)["missing"].sum())),
    }
    return Finding(estimate=share.estimate, details=details, reason=share.reason)
