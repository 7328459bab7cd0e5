"""Files of a machine beside containers: quoted, and accepted by its tools."""

import re
import subprocess
from dataclasses import replace
from itertools import pairwise

import pytest
from esslingen import FLEET, GO2, RELEASE, deployed, fleet_with

from sfglab.deploy.deployment import bridge_name, deployment_of, domain_ports
from sfglab.deploy.errors import DeployError
from sfglab.deploy.host import (
    firewall_left_out,
    firewall_rules,
    host_files,
    plan_time,
    service_unit,
)
from sfglab.fleet.fleet_file import ContainerNetwork

ON_HOST = {"network": ContainerNetwork.HOST}


def test_settings_are_read_by_a_shell_as_the_fleet_file_has_them(tmp_path):
    hostile = '$(touch broken)\'; touch "broken" `'
    settings = host_files(deployed(time_servers=("workstation", hostile)))["hooks/settings.sh"].text
    command = f'set -u; {settings}\nprintf "%s|" "$SFGLAB_AGENT" "$SFGLAB_TIME_SERVERS"'
    assert subprocess.check_output(["bash", "-c", command], cwd=tmp_path, text=True) == (
        f"go2|workstation.local {hostile}|"
    )
    assert list(tmp_path.iterdir()) == []


def test_ports_follow_the_standards_formula_and_belong_to_one_domain():
    ports = [domain_ports(domain) for domain in range(233)]
    assert [ports[domain][0] for domain in (0, 1, 100)] == [7400, 7650, 32400]
    for (first, last), (following, _) in pairwise(ports):
        assert first <= last < following


def test_every_agent_has_a_bridge_of_its_own_that_linux_takes():
    agents = ("go2", "a" * 11, "a" * 12, "a" * 40, "a" * 39 + "b")
    bridges = {bridge_name(agent) for agent in agents}
    assert len(bridges) == len(agents)
    assert all(re.fullmatch("sfg-.{1,11}", name) for name in bridges)


def test_time_servers_are_asked_in_order_and_once_and_agents_of_one_machine_do_not_ask_themselves():
    servers = ("ntp.example.org", "workstation", "pi1", "ntp.example.org")
    odd = deployed(time_servers=servers, host={"address": "other@pi1.local"})
    assert plan_time(odd) == (["ntp.example.org", "workstation.local"], True)


@pytest.mark.parametrize("changes", [{"agent": {"host": None}}, {"host": {"address": ""}}])
def test_an_agent_without_address_is_refused_as_a_time_server(changes):
    fleet = fleet_with("pi1", time_servers=("workstation", "pi1"), **changes)
    with pytest.raises(DeployError, match=r"time_servers\[1\]: given 'pi1'.*allowed: an agent"):
        host_files(deployment_of(fleet, "go2", RELEASE))


@pytest.mark.parametrize(
    ("host", "agent", "reason"),
    [
        ({}, {"global_interface": None}, "names no global interface"),
        (ON_HOST, {"local_interface": "wlan0"}, "own domain is on wlan0 as well"),
        ({}, {"domain": 0}, "own domain is the global one"),
    ],
)
def test_ports_that_cannot_be_told_apart_stay_open_with_a_reason(host, agent, reason):
    odd = deployed(host=host, agent=agent)
    assert reason in firewall_left_out(odd)
    assert "dport" not in firewall_rules(odd)
    assert ("hooks/firewall.nft" in host_files(odd)) is bool(odd.bridge)


@pytest.mark.parametrize("name", ["192.168.1.4", "wlan*", 'w" accept', "averylonginterface", ".."])
def test_a_name_that_is_no_interface_is_refused(name):
    with pytest.raises(DeployError, match=r"global_interface: given .*, allowed: the name of a"):
        firewall_rules(deployed(agent={"global_interface": name}))


def test_a_fleets_name_cannot_write_lines_of_a_unit():
    name = 'a\n[Service]\nExecStart=/bin/evil "%h" \\'
    unit, plain = service_unit(replace(GO2, fleet=replace(FLEET, name=name))), service_unit(GO2)
    for text in ("ExecStart=", "\n"):
        assert unit.count(text) == plain.count(text)
