"""What a fleet file may say that makes no sense to deploy; looks at nothing but folders beside the file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.fleet.border import Finding, Severity
from sfglab.fleet.fleet_file import Accelerator, ContainerNetwork, RosDistribution, RouterSoftware

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from sfglab.documents import Place
    from sfglab.fleet.fleet_file import AgentSpec, Fleet, HostSpec


_OWN_CONTROLLERS = "robots whose own controllers speak DDS"


def check_rules(fleet: Fleet, folder: Path) -> tuple[Finding, ...]:
    """Return what makes no sense to deploy.

    Args:
        fleet: The fleet.
        folder: Where its file stands; workspaces are named relative to it.
    """
    return (
        *(finding for rule in RULES for finding in rule(fleet)),
        *_workspaces(fleet, folder),
    )


def _hosts(fleet: Fleet) -> Iterator[tuple[AgentSpec, HostSpec]]:
    yield from ((agent, agent.host) for agent in fleet.agents if agent.host is not None)


def _error(code: str, place: Place, what: str, why: str, remedy: str) -> Finding:
    return Finding(severity=Severity.ERROR, code=code, place=place, what=what, why=why, remedy=remedy)


def _machines_named(fleet: Fleet) -> Iterator[Finding]:
    """Find agents that run nowhere."""
    for agent in fleet.agents:
        if agent.host is None:
            yield _error(
                "no-host",
                agent.place,
                f"nothing says which machine {agent.name} runs on",
                "its files depend on architecture, accelerator and network of the machine",
                "give it a section host:, at least host: {accelerator: auto}",
            )


def _one_machine_one_kind(fleet: Fleet) -> Iterator[Finding]:
    """Find machines that are said to be two things at once."""
    first: dict[str, tuple[AgentSpec, HostSpec]] = {}
    for agent, host in _hosts(fleet):
        address = host.address.rpartition("@")[2]
        other, known = first.setdefault(address, (agent, host))
        kinds = [(h.architecture.value, h.accelerator) for h in (known, host)]
        if kinds[0] != kinds[1]:
            yield _error(
                "machine-twice",
                host.place,
                f"{agent.name} and {other.name} run on {address or 'this machine'}, with different hardware",
                "one machine has one architecture, and images for one accelerator do not run on another",
                "correct the address, or say the same of both",
            )


def _interfaces_named(fleet: Fleet) -> Iterator[Finding]:
    """Find routers that would choose among the interfaces of a machine full of bridges."""
    for agent, host in _hosts(fleet):
        if agent.global_interface is None:
            yield _error(
                "interface-unnamed",
                agent.place,
                f"nothing says by which interface {agent.name} meets the other agents",
                "its machine gets bridges for containers, which DDS may choose, and the firewall must know it",
                "name it: global: {interface: wlan0} for all, or global_interface: of this agent",
            )
        if host.network is ContainerNetwork.HOST and agent.local_interface is None:
            yield _error(
                "domain-everywhere",
                agent.place,
                f"{agent.name} stands on its host's network and speaks its own domain on every interface",
                "on the host's network nothing but the interface keeps its domain inside (paper A, 4.1)",
                f"name local_interface: (lo, or the cable of {_OWN_CONTROLLERS}), or use network: bridge",
            )


def _routers_complete(fleet: Fleet) -> Iterator[Finding]:
    """Find routers without an image, and images without a meaning."""
    common = fleet.deployment
    ours = common.router is RouterSoftware.SFGLAB
    if ours and common.router_image:
        yield _error(
            "router-image-unused",
            common.place,
            f"router_image {common.router_image} is given, but the router is sfglab's own",
            "our router runs in the agent's image, so this one would be passed over",
            "leave router_image out, or name the router that it holds",
        )
    if not ours and not common.router_image:
        yield _error(
            "router-image-missing",
            common.place,
            f"the router is {common.router.value}, but nothing says in which image",
            "its makers publish several, and which one runs is part of the release",
            "give router_image: with a tag, as in ubuntu-ddsrouter:v3.5.0",
        )
    if not ours and common.router_image and not _is_pinned(common.router_image):
        yield _error(
            "router-image-moves",
            common.place,
            f"router_image {common.router_image} has no fixed tag",
            "what it means changes without a change here, so that going back is not possible",
            "give a version as its tag, or a digest",
        )


def _is_pinned(image: str) -> bool:
    name = image.rpartition("/")[2]
    return "@sha256:" in image or (":" in name and not name.endswith(":latest"))


def _workspaces_buildable(fleet: Fleet) -> Iterator[Finding]:
    """Find workspaces that nothing could build."""
    for agent, host in _hosts(fleet):
        if host.workspace and fleet.deployment.ros is RosDistribution.NONE:
            yield _error(
                "workspace-without-ros",
                host.place,
                f"{agent.name} has the colcon workspace {host.workspace}, but the images have no ROS 2",
                "colcon builds against a distribution",
                "give deployment: {ros: humble}, or leave the workspace out",
            )


def _codecs_told(fleet: Fleet) -> Iterator[Finding]:
    """Tell where H.264 is encoded by the processor whatever the accelerator's name lets one hope."""
    for agent, host in _hosts(fleet):
        sends = any(stream.codec == "h264" for stream in agent.streams)
        if sends and host.accelerator in {Accelerator.JETSON, Accelerator.V4L2}:
            yield Finding(
                severity=Severity.INFO,
                code="encoder-in-software",
                place=host.place,
                what=f"{agent.name} sends H.264, encoded by the processor on {host.accelerator.value}",
                why="h264_nvmpi is not part of FFmpeg, and a Raspberry Pi 5 has no encoder in hardware",
                remedy="publish the stream with the user's own nodes, as the paper does",
            )


RULES: tuple[Callable[[Fleet], Iterator[Finding]], ...] = (
    _machines_named,
    _one_machine_one_kind,
    _interfaces_named,
    _routers_complete,
    _workspaces_buildable,
    _codecs_told,
)
"""Every rule, in the order of its findings."""


def _workspaces(fleet: Fleet, folder: Path) -> Iterator[Finding]:
    for agent, host in _hosts(fleet):
        if host.workspace and not (folder / host.workspace / "src").is_dir():
            yield _error(
                "workspace-missing",
                host.place,
                f"{agent.name} has the colcon workspace {host.workspace}, but there is no {host.workspace}/src",
                "its sources are built into the image",
                "put it beside the fleet file",
            )
