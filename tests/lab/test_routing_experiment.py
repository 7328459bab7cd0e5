"""The routing experiment: every kind of leak is found in a made log."""

import itertools

import numpy as np
import pytest
from made_logs import broken, made_run

from sfglab.lab.checks.routing import NEAR_MISSES, in_table_1, random_dds_names
from sfglab.lab.experiments.routing import checks, exp
from sfglab.lab.experiments.routing.experiment import domains_of
from sfglab.lab.experiments.routing.live import service_names, topics
from sfglab.lab.experiments.routing.results import FORBIDDEN, HEARD, MISSING, SILENT, reached
from sfglab.names import dds_topic

DOMAINS = domains_of(2)


def heard_rows():
    """Yield the rows of a perfect router."""
    for topic in topics([*DOMAINS]):
        for source, hearer in itertools.product(topic.publishers, DOMAINS):
            allowed = in_table_1(dds_topic(topic.name)) or DOMAINS[source] == DOMAINS[hearer]
            row = {"name": topic.name, "source": source, "hearer": hearer, "sent": 10}
            yield {**row, "received": 10 if allowed else 0}


def call_rows():
    for server, caller in itertools.permutations(DOMAINS, 2):
        for name in service_names(server):
            answered = name.startswith("/global/") or DOMAINS[caller] == DOMAINS[server]
            yield {"name": name, "caller": caller, "server": server, "answered": answered}


def made(
    path,
    *,
    heard=lambda r: r,
    call=lambda r: r,
    endpoints=(("rt/tf", "h/1"),),
    policy_held=9,
):
    """A log as a run writes it, with rows changed on the way."""
    tables = {
        "party": [{"party": party, "domain": domain} for party, domain in DOMAINS.items()],
        "heard": map(heard, heard_rows()),
        "call": map(call, call_rows()),
        "endpoint": [
            {"seen_by": "ground_1", "dds_topic": t, "kind": "publisher", "router": r}
            for t, r in endpoints
        ],
        "policy": [{"check": "exact", "checked": 9, "held": policy_held}],
    }
    return made_run(exp, path, tables, config=exp.config("smoke"))


def spoiled(places, **changes):
    """Change the rows that are at a place."""
    return lambda row: {**row, **changes} if places.items() <= row.items() else row


def test_a_perfect_run_holds_everywhere_and_the_claim_is_one(tmp_path):
    run = made(tmp_path / "m.mcap")
    assert broken(checks(run)) == {}
    claim = exp.measure(run)["A-NET-RULES"]
    assert (claim.estimate.value, claim.reason) == (1.0, "")
    assert claim.details["exact checks"] == "9 of 9"


FAULTS = {
    "any other topic is not heard in another domain": {
        "heard": spoiled({"name": "/tf2", "source": "agent_1", "hearer": "ground_1"}, received=1)
    },
    "a topic of Table 1 is heard in every other domain": {
        "heard": spoiled({"name": "/tf", "source": "ground_1", "hearer": "agent_2"}, received=0)
    },
    "every topic is heard in its own domain": {
        "heard": spoiled({"name": "/chatter", "source": "agent_1", "hearer": "agent_1"}, received=0)
    },
    "an endpoint seen in the global domain is of Table 1": {"endpoints": (("rt/local/x", "h/1"),)},
    "an endpoint seen in the global domain is a router's": {"endpoints": (("rt/tf", ""),)},
    "any other service does not": {"call": spoiled({}, answered=True)},
    "exact": {"policy_held": 8},
}


@pytest.mark.parametrize("check", FAULTS)
def test_each_fault_breaks_its_check_alone_is_named_and_not_hidden_by_exact_or_live_ones(
    tmp_path, check
):
    run = made(tmp_path / "m.mcap", **FAULTS[check])
    assert set(broken(checks(run))) == {check}
    claim = exp.measure(run)["A-NET-RULES"]
    assert claim.estimate.value < 1
    assert check in claim.reason
    sums = checks(run).groupby("how")[["held", "checked"]].sum()
    assert claim.estimate.value == pytest.approx((sums["held"] / sums["checked"]).min())


def test_a_rule_that_is_closed_at_one_agent_is_missed_there(tmp_path):
    call = spoiled({"caller": "agent_1"}, answered=False)
    found = broken(checks(made(tmp_path / "m.mcap", call=call)))
    assert found["every rule is seen open at every agent, both ways"] == "rq/global/*, agent_1, out"
    assert "a service of Table 1 answers calls from other domains" in found


def test_a_run_without_anything_seen_in_the_global_domain_has_not_shown_anything(tmp_path):
    run = made(tmp_path / "m.mcap", endpoints=(("rt/x", ""),))
    assert "an endpoint seen in the global domain is of Table 1" in broken(checks(run))


def test_what_is_heard_what_leaks_and_what_is_missing_is_told_apart(tmp_path):
    here = {"source": "agent_1", "hearer": "agent_2"}
    leaks = spoiled({"name": "/tf2", **here}, received=3)
    silent = spoiled({"name": "/tf", **here}, received=0)
    run = made(tmp_path / "m.mcap", heard=lambda row: leaks(silent(row)))
    cells = reached(run, "agent_1").set_index(["name", "domain"])
    tf = cells.loc["rt/tf", "outcome"]
    assert (tf[0], tf[2]) == (HEARD, MISSING)
    tf2 = cells.loc["rt/tf2", "outcome"]
    assert (tf2[0], tf2[1], tf2[2]) == (SILENT, HEARD, FORBIDDEN)


def test_near_misses_are_not_of_table_1_and_some_random_names_are():
    assert not any(in_table_1(dds_topic(name)) for name in NEAR_MISSES)
    assert any(in_table_1(name) for name in random_dds_names(300, rng=np.random.default_rng(1)))


def test_everybody_publishes_the_shared_names():
    shared = {topic.name for topic in topics(("agent_1", "ground_1")) if len(topic.publishers) == 2}
    assert shared >= {"/tf", "/tf_static", *NEAR_MISSES}
