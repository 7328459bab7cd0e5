"""What a machine is given beside containers: the same for the same fleet, quoted, and accepted by its tools."""

import shutil
import subprocess
from dataclasses import replace

import pytest
from esslingen import FLEET, RELEASE
from hypothesis import given
from hypothesis import strategies as st

from sfglab.deploy.deployment import (
    LAST_EPHEMERAL_FREE_PORT,
    bridge_name,
    deployment_of,
    domain_ports,
)
from sfglab.deploy.errors import DeployError
from sfglab.deploy.host import (
    firewall_left_out,
    firewall_rules,
    host_files,
    plan_time,
    service_unit,
)
from sfglab.fleet.fleet_file import Accelerator, ContainerNetwork

needs_nft = pytest.mark.skipif(not shutil.which("nft"), reason="nft is missing: install nftables")


def deployment(agent="go2", fleet=FLEET, **changes):
    """A deployment of the paper's test bed, with other values of its agent or its host."""
    host = {key: changes.pop(key) for key in ("address", "network") if key in changes}
    spec = fleet.agent(agent)
    mine = replace(spec, **changes, host=replace(spec.host, **host))
    agents = tuple(mine if other is spec else other for other in fleet.agents)
    return deployment_of(replace(fleet, agents=agents), agent, RELEASE, detected=Accelerator.NONE)


def served_by(*servers, fleet=FLEET):
    return replace(fleet, deployment=replace(fleet.deployment, time_servers=servers))


@pytest.mark.parametrize("agent", ["go2", "workstation"])
def test_only_three_files_know_the_agent_and_hooks_are_programs(agent):
    mine = deployment(agent)
    files = host_files(mine)
    others = host_files(deployment("pi1"))
    own = {name for name, file in files.items() if file != others.get(name)}
    assert own == {"hooks/settings.sh", "hooks/firewall.nft", f"systemd/sfglab-{agent}.service"}
    programs = {name for name, file in files.items() if file.mode == 0o755}
    assert programs == {
        f"hooks/{name}.sh" for name in ("initialize", "10-time", "20-firewall", "30-service")
    }
    assert [name for name in files if name.startswith("hooks/custom.d/")] == [
        "hooks/custom.d/README"
    ]


def test_settings_say_to_a_shell_what_the_fleet_file_says(tmp_path):
    hostile = '$(touch broken)\'; touch "broken" `'
    odd = deployment(fleet=served_by("workstation", hostile))
    (tmp_path / "settings.sh").write_text(
        host_files(odd)["hooks/settings.sh"].text, encoding="utf-8"
    )
    says = 'set -u; . ./settings.sh; printf "%s|" "$SFGLAB_AGENT" "$SFGLAB_TIME_SERVERS" "$SFGLAB_SERVES_TIME"'
    done = subprocess.run(
        ["bash", "-c", says], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout == f"go2|workstation.local {hostile}|no|"
    assert [path.name for path in tmp_path.iterdir()] == ["settings.sh"]


@pytest.mark.parametrize(("domain", "first"), [(0, 7400), (1, 7650), (100, 32400)])
def test_ports_are_those_of_the_standards_formula(domain, first):
    assert domain_ports(domain) == (first, min(first + 249, LAST_EPHEMERAL_FREE_PORT))


@given(st.integers(0, 231))
def test_no_port_belongs_to_two_domains(domain):
    first, last = domain_ports(domain)
    assert first <= last < domain_ports(domain + 1)[0]


@given(
    st.lists(
        st.text("abcdefghijklmnop_0123456789", min_size=1, max_size=40), unique=True, max_size=30
    )
)
def test_every_agent_has_a_bridge_of_its_own_that_linux_takes(agents):
    names = [bridge_name(agent) for agent in agents]
    assert len(set(names)) == len(names)
    assert all(len(name) <= 15 and name.startswith("sfg-") for name in names)


@pytest.mark.parametrize(
    ("network", "interfaces"),
    [
        (ContainerNetwork.BRIDGE, ("eth0", "sfg-go2", "sfg-go2")),
        (ContainerNetwork.HOST, ("eth1", "eth1", "")),
    ],
)
def test_agent_and_router_meet_at_a_bridge_or_at_the_files_interface_on_the_hosts_network(
    network, interfaces
):
    plan = deployment(network=network, local_interface="eth1").network
    assert (plan.agent_interface, plan.router_interface, plan.bridge) == interfaces
    assert (plan.local_domain, plan.global_domain, plan.global_interface) == (1, 0, "wlan0")


def test_hosts_are_asked_in_order_and_once_and_agents_of_the_same_machine_do_not_ask_themselves():
    fleet = served_by("ntp.example.org", "workstation", "pi1", "ntp.example.org")
    plan = plan_time(deployment("go2", fleet, address="other@pi1.local"))
    assert plan.servers == ("ntp.example.org", "workstation.local")
    assert plan.serves


@pytest.mark.parametrize("host", [None, replace(FLEET.agent("pi1").host, address="")])
def test_an_agent_without_address_is_refused_as_a_time_server(host):
    agents = (*(a for a in FLEET.agents if a.name != "pi1"), replace(FLEET.agent("pi1"), host=host))
    fleet = served_by("workstation", "pi1", fleet=replace(FLEET, agents=agents))
    with pytest.raises(
        DeployError, match=r"time_servers\[1\]: given 'pi1'.*allowed: an agent that has one"
    ):
        host_files(deployment("go2", fleet))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"global_interface": None}, "names no global interface"),
        (
            {"network": ContainerNetwork.HOST, "local_interface": "wlan0"},
            "own domain is on wlan0 as well",
        ),
        ({"domain": 0}, "own domain is the global one"),
    ],
)
def test_ports_that_cannot_be_told_apart_stay_open_and_the_reason_is_said(changes, reason):
    odd = deployment(**changes)
    assert reason in firewall_left_out(odd)
    assert "dport" not in firewall_rules(odd)
    assert bool(firewall_rules(odd)) is bool(odd.network.bridge)
    assert ("hooks/firewall.nft" in host_files(odd)) is bool(odd.network.bridge)


@pytest.mark.parametrize(
    "name", ["192.168.1.4", "wlan*", 'w" accept', "averylonginterface", "..", ""]
)
def test_a_name_that_is_no_interface_is_refused(name):
    with pytest.raises(
        DeployError, match=r"global_interface: given .*, allowed: the name of a network"
    ):
        firewall_rules(deployment(global_interface=name))


@needs_nft
@pytest.mark.parametrize(
    "changes", [{}, {"network": ContainerNetwork.HOST}, {"global_interface": None}, {"domain": 101}]
)
def test_nft_takes_the_rules(changes, tmp_path):
    path = tmp_path / "rules.nft"
    path.write_text(firewall_rules(deployment(**changes)), encoding="utf-8")
    done = subprocess.run(
        ["nft", "-c", "-f", str(path)], capture_output=True, text=True, check=False
    )
    if "Operation not permitted" in done.stderr:
        pytest.skip("nft -c asks the kernel, which asks for root")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_fleets_name_cannot_write_lines_of_a_unit():
    name = 'a\n[Service]\nExecStart=/bin/evil "%h" \\'
    unit = service_unit(deployment(fleet=replace(FLEET, name=name)))
    assert unit.count("ExecStart=") == service_unit(deployment()).count("ExecStart=") == 1
    assert unit.count("\n") == service_unit(deployment()).count("\n")
