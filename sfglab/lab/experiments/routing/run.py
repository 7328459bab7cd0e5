"""Run the routing experiment into one log: who heard what of whom, and what was seen in the global domain."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from sfglab.bus.api import entries
from sfglab.fleet.policy import Crossing, Direction, Policy, Side
from sfglab.fleet.router.plan import ROUTER_KEY
from sfglab.lab.checks import CheckRow
from sfglab.lab.experiments.routing.probes import (
    in_table_1,
    near_miss_dds_names,
    random_dds_names,
    service_names,
)
from sfglab.lab.experiments.routing.rows import CallRow, EndpointRow, HeardRow, LatchedRow
from sfglab.lab.experiments.routing.stage import GLOBAL_DOMAIN, Stage, parties_of
from sfglab.lab.progress import progress_bar
from sfglab.lab.testbed import Testbed
from sfglab.names import all_standard_fqns, dds_topic
from sfglab.record import LogWriter, run_context

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

    from sfglab.lab.experiments.routing.config import Config
    from sfglab.lab.experiments.routing.rows import PartyRow
    from sfglab.names import RosFqn


AGENT = "go2"
_Name = TypeVar("_Name", str, "RosFqn")
LATE_S = 5.0


async def run(config: Config, path: Path, *, separate: bool | None = None) -> Path:
    """Run the experiment.

    Args:
        config: What to run.
        path: The log.
        separate: False insists on one host; None takes separate hosts where the machine can.

    Returns:
        The log's path.

    Raises:
        ProcessFailedError: A process of the experiment failed; what was measured before is in the log.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    hosts = [party.host for party in parties_of(config)]
    with (
        Testbed(*hosts, separate=separate) as testbed,
        LogWriter(path) as log,
        progress_bar(4, "routing") as advance,
    ):
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": "routing", **asdict(config)})
        log.write_metadata("hosts", {"description": testbed.description, "separate": testbed.separate})
        _write(log, "policy", policy_rows(config))
        advance("policy")
        async with Stage(config, testbed) as stage:
            await _observe(config, stage, log, advance)
    return path


async def _observe(config: Config, stage: Stage, log: LogWriter, advance: Callable[[str], None]) -> None:
    _write(log, "party", stage.parties)
    sent = await stage.talk(config.seconds)
    advance("talked")
    late = await stage.ask("late", do="late", expected=len(stage.parties), timeout_s=LATE_S)
    calls = await _call(config, stage)
    advance("called")
    told = await stage.ask("told", do="tell")
    _write(log, "call", calls)
    _write(log, "latched", _latched_rows(stage, late))
    _write(log, "heard", _heard_rows(stage, sent, told))
    _write(log, "endpoint", _endpoint_rows(stage, told))
    advance("told")


def _write(log: LogWriter, table: str, rows: Iterable[Any]) -> None:
    for row in rows:
        log.write_row(table, row, log_time_ns=time.time_ns())


async def _call(config: Config, stage: Stage) -> list[CallRow]:
    """Let everybody call everybody else's services at once."""
    servers = {name: party for party in stage.parties for name in service_names(party.party)}
    names = list(servers)
    answers = await stage.ask("called", do="call", names=names, timeout_s=config.call_s)
    return [
        CallRow(
            name=name,
            caller=caller.party,
            server=server.party,
            caller_domain=caller.domain,
            server_domain=server.domain,
            answered=answer == server.party,
        )
        for caller in stage.parties
        for (name, server), answer in zip(servers.items(), answers[caller.party]["answers"], strict=True)
        if caller != server
    ]


def _latched_rows(stage: Stage, late: dict[str, dict[str, Any]]) -> Iterator[LatchedRow]:
    for hearer, report in late.items():
        for party in stage.parties:
            received = report["received"].get(party.party, 0)
            yield LatchedRow(source=party.party, hearer=hearer, received=received)


def _heard_rows(stage: Stage, sent: dict[str, int], told: dict[str, dict[str, Any]]) -> Iterator[HeardRow]:
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


def _heard_row(name: str, source: PartyRow, hearer: PartyRow, sent: int, entry: dict[str, Any]) -> HeardRow:
    age_ns = entry.get("age_ns")
    counts = ("received", "repeated", "disordered", "restamped", "missing", "misnamed")
    return HeardRow(
        name=name,
        dds_topic=dds_topic(name),
        source=source.party,
        hearer=hearer.party,
        source_domain=source.domain,
        hearer_domain=hearer.domain,
        sent=sent,
        age_ms=float("nan") if age_ns is None else age_ns / 1e6,
        **{key: entry.get(key, 0) for key in counts},
    )


def _endpoint_rows(stage: Stage, told: dict[str, dict[str, Any]]) -> Iterator[EndpointRow]:
    """Yield what parties in the global domain saw there beside each other's endpoints."""
    others = [party.party for party in stage.parties if party.domain == GLOBAL_DOMAIN]
    own = {told[party]["participant"] for party in others}
    for party in others:
        for dds, kind, owner, tag in told[party]["endpoints"]:
            if owner not in own:
                router = entries(tag.encode()).get(ROUTER_KEY, "")
                yield EndpointRow(seen_by=party, dds_topic=dds, kind=kind, router=router)


def policy_rows(config: Config) -> list[CheckRow]:
    """Return the policy's own checks, exact and without anything running."""
    rng = np.random.default_rng(config.seed)
    fqns = list(all_standard_fqns(AGENT))
    standard = [name for fqn in fqns for name in fqn.dds_names]
    drawn = list(random_dds_names(config.random_names, rng=rng))
    every = [*standard, *near_miss_dds_names(), *drawn]
    return [
        _check_row("a name crosses exactly if Table 1 names it, both ways", every, _as_table_1),
        _check_row("a message is heard in the domains that Eq. 1 says", every, _as_eq_1),
        _check_row("near misses of Table 1 stay", list(near_miss_dds_names()), _stays),
        _check_row("a standard name crosses whole if it is global, else not at all", fqns, _crosses_by_scope),
    ]


def _check_row(check: str, names: list[_Name], holds: Callable[[_Name], bool]) -> CheckRow:
    failed = [name for name in names if not holds(name)]
    example = str((failed or names)[0])
    return CheckRow(check=check, checked=len(names), held=len(names) - len(failed), example=example)


def _as_table_1(name: str) -> bool:
    return all(Policy().crosses(name, way) is in_table_1(name) for way in Direction)


def _as_eq_1(name: str) -> bool:
    both = frozenset(Side)
    return all(
        Policy().domains(name, side) == (both if in_table_1(name) else frozenset({side})) for side in Side
    )


def _stays(name: str) -> bool:
    return not any(Policy().crosses(name, way) for way in Direction)


def _crosses_by_scope(fqn: RosFqn) -> bool:
    expected = Crossing.WHOLE if fqn.is_global else Crossing.NONE
    return all(Policy().crossing(str(fqn), fqn.kind, way) is expected for way in Direction)
