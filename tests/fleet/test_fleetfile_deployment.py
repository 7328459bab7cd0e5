"""Where a fleet runs, as a fleet file says it: what is read, and what no machine could take."""

from __future__ import annotations

from pathlib import Path

import pytest

from sfglab.documents import DocumentError
from sfglab.fleet.fleet_file import (
    Accelerator,
    Architecture,
    ContainerNetwork,
    DeploymentSpec,
    HostSpec,
    RosDistribution,
    RouterSoftware,
    load_fleet,
    read_fleet,
)

ESSLINGEN = Path(__file__).parents[2] / "data" / "fleets" / "esslingen.yaml"


def fleet_with(host: str = "{}", deployment: str = "{}"):
    return read_fleet(
        f"fleet: My Lab\ndeployment: {deployment}\nagents:\n  go2:\n    domain: 1\n    host: {host}\n"
    )


def test_the_papers_test_bed_names_a_machine_for_every_agent():
    fleet = load_fleet(ESSLINGEN)
    hosts = {agent.name: agent.host for agent in fleet.agents}
    assert [name for name, host in hosts.items() if host is None] == []
    assert hosts["go2"].accelerator is Accelerator.JETSON
    assert hosts["go2"].architecture is Architecture.ARM64
    assert {hosts[f"pi{i}"].accelerator for i in range(1, 7)} == {Accelerator.V4L2}
    assert fleet.deployment.ros is RosDistribution.HUMBLE


def test_an_agent_without_a_machine_and_a_fleet_without_a_deployment_are_fleets_all_the_same():
    fleet = read_fleet("fleet: Lab 7\nagents: {go2: {domain: 1}}")
    assert fleet.agents[0].host is None
    assert fleet.deployment == DeploymentSpec(images="localhost/lab-7")


def test_everything_has_a_default_and_auto_leaves_the_accelerator_to_detection():
    fleet = fleet_with("{accelerator: auto}")
    assert fleet.agents[0].host == HostSpec()
    assert fleet.deployment == DeploymentSpec(images="localhost/my-lab")


def test_all_keys_are_read():
    fleet = fleet_with(
        "{model: M, address: sfg@go2.local, architecture: arm64, accelerator: jetson, network: host, "
        "devices: [/dev/video0], workspace: ws/go2, packages: [libusb-1.0-0, g++], launch: [ros2, a b]}",
        "{images: 'reg.example:5000/lab/go', ros: jazzy, router: dds-router, "
        "router_image: 'ubuntu-ddsrouter:v3.5.0', time_servers: [go2, ptbtime1.ptb.de]}",
    )
    assert fleet.agents[0].host == HostSpec(
        model="M",
        address="sfg@go2.local",
        architecture=Architecture.ARM64,
        accelerator=Accelerator.JETSON,
        network=ContainerNetwork.HOST,
        devices=("/dev/video0",),
        workspace="ws/go2",
        packages=("libusb-1.0-0", "g++"),
        launch=("ros2", "a b"),
    )
    assert fleet.deployment == DeploymentSpec(
        images="reg.example:5000/lab/go",
        ros=RosDistribution.JAZZY,
        router=RouterSoftware.DDS_ROUTER,
        router_image="ubuntu-ddsrouter:v3.5.0",
        time_servers=("go2", "ptbtime1.ptb.de"),
    )


@pytest.mark.parametrize(
    ("host", "key", "allowed"),
    [
        ("{accelerator: jetsn}", "host.accelerator", "did you mean 'jetson'?"),
        ("{acelerator: jetson}", "host.acelerator", "did you mean 'accelerator'?"),
        ("{architecture: x86}", "host.architecture", "amd64 or arm64"),
        ("{devices: [video0]}", "host.devices", "device nodes"),
        ("{devices: [/dev/../etc/shadow]}", "host.devices", "device nodes"),
        ("{packages: ['curl; rm -rf /']}", "host.packages", "Debian packages"),
        ("{workspace: ../elsewhere}", "host.workspace", "a folder beside the fleet file"),
        ("{workspace: /abs}", "host.workspace", "a folder beside the fleet file"),
        ("{address: '-oProxyCommand=x'}", "host.address", "[user@]host"),
        ("{address: 'a b'}", "host.address", "[user@]host"),
        ("{launch: ros2 launch}", "host.launch", "a list of texts"),
        ("jetson", "host", "a mapping"),
    ],
)
def test_a_machine_that_cannot_be_is_refused_with_place_and_what_is_allowed(host, key, allowed):
    with pytest.raises(DocumentError) as error:
        fleet_with(host)
    assert f"agents.go2.{key}" in str(error.value)
    assert allowed in str(error.value)


@pytest.mark.parametrize(
    ("deployment", "key", "allowed"),
    [
        ("{images: Localhost/UPPER}", "images", "a repository of images"),
        ("{images: 'a:1'}", "images", "a repository of images"),
        ("{ros: foxy}", "ros", "none or humble or jazzy"),
        ("{router: zenoh}", "router", "zenoh-bridge"),
        ("{router_image: 'a b'}", "router_image", "an image"),
        ("{time_servers: ['x y']}", "time_servers", "names or addresses"),
        ("{tag: latest}", "tag", "images, ros, router"),
    ],
)
def test_a_deployment_that_cannot_be_is_refused_with_place_and_what_is_allowed(deployment, key, allowed):
    with pytest.raises(DocumentError) as error:
        fleet_with(deployment=deployment)
    assert f"deployment.{key}" in str(error.value)
    assert allowed in str(error.value)
