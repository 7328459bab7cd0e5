"""Networks of an agent's containers: interfaces that Linux takes, ports of the standard, who stands where."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.deploy.deployment import LAST_EPHEMERAL_FREE_PORT, bridge_name, domain_ports, plan_network
from sfglab.fleet.fleet_file import AgentSpec, ContainerNetwork, Fleet, HostSpec

AGENT = AgentSpec(name="go2", domain=7, global_interface="wlan0", local_interface="lo")
FLEET = Fleet(name="lab", agents=(AGENT,))


@pytest.mark.parametrize(("domain", "first"), [(0, 7400), (1, 7650), (100, 32400)])
def test_ports_are_those_of_the_standards_formula(domain, first):
    assert domain_ports(domain) == (first, min(first + 249, LAST_EPHEMERAL_FREE_PORT))


@given(st.integers(0, 231))
def test_no_port_belongs_to_two_domains(domain):
    first, last = domain_ports(domain)
    assert first <= last < domain_ports(domain + 1)[0]


@given(st.lists(st.text("abcdefghijklmnop_0123456789", min_size=1, max_size=40), unique=True, max_size=30))
def test_every_agent_has_a_bridge_of_its_own_that_linux_takes(agents):
    names = [bridge_name(agent) for agent in agents]
    assert len(set(names)) == len(names)
    assert all(len(name) <= 15 and name.startswith("sfg-") for name in names)


def test_on_a_bridge_agent_and_router_meet_there_whatever_the_file_says_of_the_agents_own_nodes():
    plan = plan_network(FLEET, AGENT, HostSpec())
    assert (plan.agent_interface, plan.router_interface, plan.bridge) == ("eth0", "sfg-go2", "sfg-go2")
    assert (plan.local_domain, plan.global_domain, plan.global_interface) == (7, 0, "wlan0")


def test_on_the_hosts_network_both_use_the_interface_of_the_file():
    agent = replace(AGENT, local_interface="eth1")
    plan = plan_network(FLEET, agent, HostSpec(network=ContainerNetwork.HOST))
    assert (plan.agent_interface, plan.router_interface, plan.bridge) == ("eth1", "eth1", "")
