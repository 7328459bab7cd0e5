"""Compose projects of every agent: least privileges, and no way out of an agent's domain but the router."""

import re

import pytest
import yaml
from esslingen import GO2, deployed, over_zenoh

from sfglab.deploy.compose import compose_files
from sfglab.deploy.errors import DeployError
from sfglab.fleet.fleet_file import Accelerator, ContainerNetwork, RouterSoftware


def projects(deployment):
    """Return the project of an agent, and its overlay for development."""
    files = compose_files(deployment)
    return [yaml.safe_load(files[name].text) for name in ("compose.yaml", "compose.dev.yaml")]


LEAST = {
    "cap_drop": ["ALL"],
    "security_opt": ["no-new-privileges:true"],
    "read_only": True,
    "user": "10001:10001",
}


@pytest.mark.parametrize("router", RouterSoftware)
def test_both_containers_have_no_right_that_they_do_not_need(router):
    project, overlay = projects(deployed(router=router, router_image="r:v3.5.0"))
    assert set(project["services"]) == {"agent", "router"}
    for service in project["services"].values():
        assert service | LEAST == service
        assert not {"privileged", "cap_add", "ports", "pid", "ipc", "uts", "cgroup"} & set(service)
        assert ":" in service["image"]
        for volume in service.get("volumes", ()):
            assert re.fullmatch(r"\./router/.*:ro", volume)
    assert set(overlay["services"]) == {"agent"}
    rights = {"privileged", "cap_add", "network_mode", "ports", "user", "security_opt"}
    assert not rights & set(overlay["services"]["agent"])


def test_an_agent_may_use_the_network_of_the_host_as_its_router_does():
    on_host = deployed(host={"network": ContainerNetwork.HOST})
    assert (on_host.agent_interface, on_host.router_interface) == ("lo", "lo")
    project, _ = projects(on_host)
    for service in project["services"].values():
        assert service["network_mode"] == "host"
    assert "networks" not in project


@pytest.mark.parametrize(
    ("accelerator", "nodes"),
    [(Accelerator.ROCM, ["/dev/kfd", "/dev/dri"]), (Accelerator.NONE, [])],
)
def test_a_container_gets_its_accelerator_and_the_devices_of_the_fleet_file(accelerator, nodes):
    """The others are those of reviewed files."""
    project, _ = projects(deployed(host={"accelerator": accelerator}))
    agent = project["services"]["agent"]
    assert agent["devices"] == [f"{node}:{node}" for node in (*nodes, "/dev/bus/usb")]
    assert not {"runtime", "deploy"} & set(agent)


def test_only_the_router_reads_the_hosts_certificates_and_a_relative_folder_is_refused():
    project, _ = projects(over_zenoh(GO2, certificates="/etc/a: $b"))
    (mount,) = project["services"]["router"]["volumes"]
    assert mount["source"] == mount["target"] == "/etc/a: $$b"
    assert (mount["type"], mount["read_only"]) == ("bind", True)
    assert mount["bind"] == {"create_host_path": False}
    assert "volumes" not in project["services"]["agent"]
    plain, _ = projects(over_zenoh(GO2))
    assert "volumes" not in plain["services"]["router"]
    with pytest.raises(DeployError, match=r"global\.certificates: given 'keys', .* absolute path"):
        compose_files(over_zenoh(GO2, certificates="keys"))
