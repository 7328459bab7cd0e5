"""The routing experiment: every kind of leak is found in a made log, and a short live run proves itself."""

from __future__ import annotations

import asyncio
import itertools
from dataclasses import replace

import numpy as np
import pytest

from sfglab.bus.api import MessageInfo
from sfglab.fleet.policy import Direction, Policy
from sfglab.lab.checks import CheckRow
from sfglab.lab.experiments import routing
from sfglab.lab.experiments.profiles import ConfigError
from sfglab.lab.experiments.routing.analysis import checks, latencies, load_results, measure_claims
from sfglab.lab.experiments.routing.config import Config
from sfglab.lab.experiments.routing.figure import FORBIDDEN, HEARD, MISSING, SILENT, cells_of
from sfglab.lab.experiments.routing.probes import (
    NEAR_MISSES,
    in_table_1,
    random_dds_names,
    service_names,
    topics,
)
from sfglab.lab.experiments.routing.rows import (
    CallRow,
    EndpointRow,
    HeardRow,
    LatchedRow,
    PartyRow,
)
from sfglab.lab.experiments.routing.stage import parties_of
from sfglab.lab.workers.test_peer import ReceiveStatistics
from sfglab.names import dds_topic
from sfglab.record import LogWriter

TINY = replace(Config.of_profile("smoke"), seconds=1.0, busy=1, random_names=200, call_s=0.3)
PARTIES = (
    PartyRow(party="agent_1", domain=1, host="agent_1"),
    PartyRow(party="agent_2", domain=2, host="agent_2"),
    PartyRow(party="ground_1", domain=0, host="ground_1"),
    PartyRow(party="ground_2", domain=0, host="ground_2"),
)
DOMAINS = {p.party: p.domain for p in PARTIES}


def heard_rows():
    """What a perfect router would give."""
    agents, others = ("agent_1", "agent_2"), ("ground_1", "ground_2")
    for topic in topics(agents, others, busy=1):
        for source in topic.publishers:
            for hearer in topic.subscribers:
                allowed = in_table_1(dds_topic(topic.name)) or DOMAINS[source] == DOMAINS[hearer]
                routers = sum(DOMAINS[p] != 0 for p in (source, hearer))
                yield HeardRow(
                    name=topic.name,
                    dds_topic=dds_topic(topic.name),
                    source=source,
                    hearer=hearer,
                    source_domain=DOMAINS[source],
                    hearer_domain=DOMAINS[hearer],
                    sent=10,
                    received=10 if allowed else 0,
                    repeated=0,
                    disordered=0,
                    restamped=0,
                    missing=0,
                    misnamed=0,
                    age_ms=1.0 + 0.5 * routers if allowed else float("nan"),
                )


def call_rows():
    for server, caller in itertools.permutations(PARTIES, 2):
        for name in service_names(server.party):
            yield CallRow(
                name=name,
                caller=caller.party,
                server=server.party,
                caller_domain=caller.domain,
                server_domain=server.domain,
                answered=name.startswith("/global/") or caller.domain == server.domain,
            )


def made(path, *, heard=lambda r: r, call=lambda r: r, latched=1, endpoints=(("rt/tf", "h/1"),), policy_held=9):
    """A log as a run writes it, with rows changed on the way."""
    tables = {
        "party": PARTIES,
        "heard": [heard(row) for row in heard_rows()],
        "call": [call(row) for row in call_rows()],
        "latched": [LatchedRow(source=s, hearer=h, received=latched) for s in DOMAINS for h in DOMAINS],
        "endpoint": [
            EndpointRow(seen_by="ground_1", dds_topic=t, kind="publisher", router=r) for t, r in endpoints
        ],
        "policy": [CheckRow(check="exact", checked=9, held=policy_held, example="rt/tf")],
    }
    with LogWriter(path) as log:
        log.write_metadata("config", {"experiment": "routing", "agents": 2})
        log.write_metadata("hosts", {"description": "made", "separate": True})
        for name, rows in tables.items():
            for row in rows:
                log.write_row(name, row, log_time_ns=1)
    return path


def broken(path) -> dict[str, str]:
    table = checks(load_results(path))
    wrong = table[table["held"] < table["checked"]]
    return dict(zip(wrong["check"], wrong["example"], strict=True))


def where(row, **values) -> bool:
    return all(getattr(row, key) == value for key, value in values.items())


def test_a_perfect_run_holds_everywhere_and_the_claim_is_one(tmp_path):
    path = made(tmp_path / "m.mcap")
    assert broken(path) == {}
    claim = measure_claims(path)["A-NET-RULES"]
    assert (claim.estimate.value, claim.reason) == (1.0, "")
    assert claim.details["exact checks"] == "9 of 9"


FAULTS = {
    "any other topic is not heard in another domain": {
        "heard": lambda r: (
            replace(r, received=1) if where(r, name="/tf2", source="agent_1", hearer="ground_1") else r
        )
    },
    "a topic of Table 1 is heard in every other domain": {
        "heard": lambda r: (
            replace(r, received=0) if where(r, name="/tf", source="ground_1", hearer="agent_2") else r
        )
    },
    "every topic is heard in its own domain": {
        "heard": lambda r: (
            replace(r, received=0) if where(r, name="/chatter", source="agent_1", hearer="agent_1") else r
        )
    },
    "no sample arrives twice or comes back": {
        "heard": lambda r: (
            replace(r, repeated=1) if where(r, name="/tf", source="agent_1", hearer="agent_1") else r
        )
    },
    "samples of one source keep their order": {
        "heard": lambda r: replace(r, disordered=1) if where(r, name="/tf", source="agent_1") else r
    },
    "samples keep their source time stamps": {
        "heard": lambda r: replace(r, restamped=1) if where(r, name="/tf", source="agent_1") else r
    },
    "transforms bear their agent's prefix, outside it only": {
        "heard": lambda r: replace(r, misnamed=1) if where(r, name="/tf", hearer="ground_2") else r
    },
    "a late joiner hears each static transform once": {"latched": 2},
    "an endpoint seen in the global domain is of Table 1": {"endpoints": (("rt/local/x", "h/1"),)},
    "an endpoint seen in the global domain is a router's": {"endpoints": (("rt/tf", ""),)},
    "any other service does not": {"call": lambda r: replace(r, answered=True)},
    "exact": {"policy_held": 8},
}


@pytest.mark.parametrize("check", FAULTS)
def test_each_fault_breaks_its_check_alone_and_is_named(tmp_path, check):
    path = made(tmp_path / "m.mcap", **FAULTS[check])
    assert set(broken(path)) == {check}
    claim = measure_claims(path)["A-NET-RULES"]
    assert claim.estimate.value < 1
    assert check in claim.reason


def test_a_rule_that_is_closed_at_one_agent_is_missed_there(tmp_path):
    def closed(row):
        silent = row.answered and row.caller == "agent_1" and row.caller_domain != row.server_domain
        return replace(row, answered=False) if silent else row

    found = broken(made(tmp_path / "m.mcap", call=closed))
    assert found["every rule is seen open at every agent, both ways"] == "rq/global/*, agent_1, out"
    assert "a service of Table 1 answers calls from other domains" in found


def test_many_exact_checks_do_not_hide_a_live_one(tmp_path):
    path = made(tmp_path / "m.mcap", endpoints=(("rt/local/x", "h/1"),))
    table = checks(load_results(path)).groupby("how")[["held", "checked"]].sum()
    share = measure_claims(path)["A-NET-RULES"].estimate.value
    assert share == pytest.approx(table.loc["live", "held"] / table.loc["live", "checked"])


def test_a_run_without_anything_seen_in_the_global_domain_has_not_shown_anything(tmp_path):
    assert "an endpoint seen in the global domain is of Table 1" in broken(
        made(tmp_path / "m.mcap", endpoints=(("rt/x", ""),))
    )


def test_latencies_are_told_by_the_routers_between(tmp_path):
    found = latencies(load_results(made(tmp_path / "m.mcap")))
    assert {name: e.value for name, e in found.items()} == pytest.approx(
        {"direct": 1.0, "one router": 1.5, "two routers": 2.0, "one router, /tf": 1.5, "per router": 0.5}
    )


def test_the_figure_shows_what_is_heard_what_leaks_and_what_is_missing(tmp_path):
    def spoiled(row):
        if where(row, name="/tf2", source="agent_1", hearer="agent_2"):
            return replace(row, received=3)
        if where(row, name="/tf", source="agent_1", hearer="agent_2"):
            return replace(row, received=0)
        return row

    path = made(tmp_path / "m.mcap", heard=spoiled)
    cells = {(c.name, c.domain): c for c in cells_of(load_results(path), "agent_1")}
    assert cells["rt/tf", 0].color == HEARD
    assert cells["rt/tf", 2].color == MISSING
    assert cells["rt/tf2", 2].color == FORBIDDEN
    assert cells["rt/tf2", 0].color == SILENT
    assert cells["rt/tf2", 1].color == HEARD
    assert cells["rq/global/<agent>/get_metadataRequest", 0].heard == 1
    drawn = routing.figures(path)
    figure, twin = drawn["routing_border"]
    assert figure.axes
    assert twin["heard"]["agent_1"]["rt/tf2 in D_2"] == 0.3
    assert twin == routing.figures(path)["routing_border"][1]


def test_a_tally_counts_repeated_late_restamped_and_missing_messages():
    tally = ReceiveStatistics()
    for number, stamp_ns in ((3, 30), (4, 40), (7, 70), (5, 50), (7, 71)):
        info = MessageInfo(source_timestamp_ns=10 * number, received_timestamp_ns=100, publisher_gid=b"")
        tally.note(number, stamp_ns, info)
    report = tally.report()
    assert (report["received"], report["repeated"], report["disordered"]) == (5, 1, 1)
    assert (report["restamped"], report["missing"], report["age_ns"]) == (1, 1, 50)
    assert ReceiveStatistics().report()["age_ns"] is None


def test_table_1_in_words_is_the_policy_on_random_names():
    for name in random_dds_names(3000, rng=np.random.default_rng(1)):
        assert all(Policy().crosses(name, way) is in_table_1(name) for way in Direction), name
    assert not any(in_table_1(dds_topic(name)) for name in NEAR_MISSES)


def test_everybody_publishes_and_subscribes_the_shared_names():
    every = list(topics(("agent_1",), ("ground_1",), busy=2))
    shared = [t for t in every if len(t.publishers) == 2]
    assert {t.name for t in shared} >= {"/tf", "/tf_static", *NEAR_MISSES}
    assert all(set(t.subscribers) == {"agent_1", "ground_1"} for t in shared)
    assert sum(t.name.startswith("/local/agent_1/status") for t in every) == 2


def test_profiles_grow_and_an_unknown_one_is_refused():
    smoke, quick, paper = (Config.of_profile(p) for p in ("smoke", "quick", "paper"))
    assert smoke.agents < quick.agents < paper.agents
    assert [p.domain for p in parties_of(smoke)] == [1, 2, 0, 0]
    with pytest.raises(ConfigError, match="smoke, quick, paper"):
        Config.of_profile("long")


@pytest.mark.live
def test_live_routers_let_exactly_table_1_cross(tmp_path):
    path = asyncio.run(routing.run(TINY, tmp_path / "run.mcap"))
    assert broken(path) == {}
    results = load_results(path)
    assert results.heard["missing"].sum() == 0
    assert measure_claims(path)["A-NET-RULES"].estimate.value == 1
    assert {"direct", "two routers", "per router"} <= set(latencies(results))
