"""Simulated fleets: everybody finds everybody, seeds repeat, and traffic grows as the model says."""

from __future__ import annotations

from statistics import mean

import pytest

from sfglab.lab.experiments.discovery import exp
from sfglab.lab.experiments.discovery.experiment import ROUTED, STANDARD, Fleet, Scale
from sfglab.lab.experiments.discovery.simulated import fleets_of, run_fleet, simulate_fleet


def received(fleet):
    return mean(host.rx_bytes for host in run_fleet(fleet).hosts)


def test_every_routed_agent_finds_all_others_and_a_seed_repeats():
    fleet = Fleet(mode=ROUTED, agents=5, talkers=1, listeners=1)
    rows = simulate_fleet(fleet, 0)
    assert [row["host"] for row in rows] == list(range(5))
    assert not any(row["censored"] for row in rows)
    assert all(0.03 < row["resolved_s"] < 5 and row["rx_bytes"] > 1000 for row in rows)
    assert simulate_fleet(fleet, 0) == rows


def test_the_global_domain_gets_two_endpoints_for_each_ordered_pair_of_routed_agents():
    outcome = run_fleet(Fleet(mode=ROUTED, agents=6, talkers=1, listeners=1))
    # Each agent: its heartbeats both ways and its service, and a client of every other agent's.
    assert outcome.announced == pytest.approx(6 * 4 + 2 * 6 * 5, rel=0.2)


def test_standard_traffic_is_proportional_to_the_number_of_other_agents():
    small = {
        agents: received(Fleet(mode=STANDARD, agents=agents, talkers=2, listeners=2)) for agents in (2, 3, 4)
    }
    assert small[4] == pytest.approx(small[2] + 2 * (small[3] - small[2]), rel=0.02)
    large = run_fleet(Fleet(mode=STANDARD, agents=100, talkers=2, listeners=2))
    assert len(large.hosts) == 100
    assert large.hosts[0].rx_bytes == pytest.approx(small[2] + 98 * (small[3] - small[2]), rel=0.02)


def test_a_configuration_names_its_fleets_the_largest_last():
    fleets = fleets_of(exp.config(simulated=Scale(agents=(10, 2), talkers=2, listeners=1)))
    assert [(fleet.mode, fleet.agents) for fleet in fleets] == [
        (mode, agents) for agents in (2, 10) for mode in (STANDARD, ROUTED)
    ]
