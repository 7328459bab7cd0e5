"""All checks of a fleet before anything is brought anywhere, in three steps: the fleet, its files, each file.

A step is asked only when the one before it holds: files of a fleet that makes no sense are not worth a word.
"""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from sfglab.deploy.bundle import render_bundle
from sfglab.deploy.bundle_check import check_bundle
from sfglab.deploy.preparing import describe
from sfglab.deploy.verdicts import State, Verdict, verdict_of
from sfglab.fleet.border import Finding, Severity, lint
from sfglab.fleet.fleet_file import Accelerator, ContainerNetwork, RosDistribution, RouterSoftware

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

    from sfglab.deploy.deployment import Deployment, Release
    from sfglab.deploy.files import BundleFile
    from sfglab.deploy.preparing import Detect, FleetSource
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


def check_fleet(
    source: FleetSource, release: Release, *, agents: Sequence[str] = (), detect: Detect = lambda _: None
) -> tuple[Verdict, ...]:
    """Check a fleet file and everything that would be made of it.

    Args:
        source: The fleet, from `load_source`.
        release: What would be deployed.
        agents: Whose files; none: all.
        detect: Asked for the accelerator of a machine whose fleet file leaves it to detection.

    Raises:
        UnknownAgentError: The fleet has no such agent.
    """
    names = agents or tuple(agent.name for agent in source.fleet.agents)
    border, machines = lint(source.fleet).findings, check_rules(source.fleet, source.folder)
    verdicts = [
        verdict_of("names, domains, QoS and frames", str(source.path), lambda: _errors(border)),
        verdict_of("machines and routers", str(source.path), lambda: _errors(machines)),
    ]
    if fails(verdicts):
        return tuple(verdicts)
    rendered: dict[str, tuple[Deployment, dict[str, BundleFile]]] = {}

    def make(name: str) -> tuple[str, ...]:
        deployment = describe(source, name, release, detect)
        rendered[name] = deployment, render_bundle(deployment)
        return ()

    verdicts += [verdict_of("files are made", name, make, name) for name in names]
    if not fails(verdicts):
        verdicts += (
            Verdict(check=v.check, subject=f"{name}/{v.subject}", state=v.state, says=v.says)
            for name, (deployment, files) in rendered.items()
            for v in check_bundle(files, deployment)
        )
    return tuple(verdicts)


def fails(verdicts: Iterable[Verdict]) -> bool:
    """Tell whether anything does not hold."""
    return any(verdict.state is State.FAILS for verdict in verdicts)


def _errors(findings: Iterable[Finding]) -> Iterator[str]:
    """Yield the first error of each kind in full, and how many there are like it."""
    kinds: dict[str, list[Finding]] = defaultdict(list)
    for finding in findings:
        if finding.severity is Severity.ERROR:
            kinds[finding.code].append(finding)
    for first, *more in kinds.values():
        like = f", and {len(more)} more like it" if more else ""
        yield f"{first.place}: {first.what} ({first.why}; {first.remedy}){like}"
