"""Checks of a fleet, in memory: the fleet, then its files, then each file, as far as all holds until then."""

from __future__ import annotations

from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cache, partial
from os import sched_getaffinity
from typing import TYPE_CHECKING, Any

from sfglab.deploy.bundle import Detect, FleetSource, describe, render_bundle
from sfglab.deploy.compose_check import check_compose
from sfglab.deploy.dockerfile_check import check_dockerfile
from sfglab.deploy.editor_check import SHAPES, check_editor
from sfglab.deploy.errors import MissingProgramError
from sfglab.deploy.programs import find_program
from sfglab.deploy.routers.dds_router import ROUTER_FILE
from sfglab.deploy.routers.dds_router_check import check_dds_router
from sfglab.deploy.text_check import check_dockerfiles, check_secrets, check_shell
from sfglab.deploy.unit_check import check_unit
from sfglab.deploy.verdicts import Broken, Rules, State, Verdict, error_sentences, verdict_of
from sfglab.fleet import fleet_file
from sfglab.fleet.fleet_file import RouterSoftware
from sfglab.fleet.lint import Finding, Severity, lint

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from sfglab.deploy.deployment import Deployment, Release
    from sfglab.deploy.files import BundleFile
    from sfglab.documents import Place
    from sfglab.fleet.policy import Policy

#: What a fleet file may say that makes no sense to deploy.
RULES: Rules[FleetSource, Place] = Rules()


def _hosts(source: FleetSource) -> Iterator[tuple[fleet_file.AgentSpec, fleet_file.HostSpec]]:
    yield from ((agent, agent.host) for agent in source.fleet.agents if agent.host is not None)


@RULES.add(
    "no-host",
    "its files depend on architecture, accelerator and network of the machine",
    "give it a section host:, at least host: {accelerator: auto}",
)
def _no_machine(source: FleetSource) -> Iterator[Broken[Place]]:
    for agent in source.fleet.agents:
        if agent.host is None:
            yield Broken(agent.place, f"nothing says which machine {agent.name} runs on")


@RULES.add(
    "workspace-without-ros",
    "colcon builds against a distribution",
    "give deployment: {ros: humble}, or leave the workspace out",
)
def _workspace_without_ros(source: FleetSource) -> Iterator[Broken[Place]]:
    for agent, host in _hosts(source):
        if host.workspace and source.fleet.deployment.ros is fleet_file.RosDistribution.NONE:
            what = f"{agent.name} has the colcon workspace {host.workspace}, but the images have no ROS 2"
            yield Broken(host.place, what)


@RULES.add(
    "encoder-in-software",
    "h264_nvmpi is not part of FFmpeg, and a Raspberry Pi 5 has no encoder in hardware",
    "publish the stream with the user's own nodes, as the paper does",
    Severity.INFO,
)
def _encoded_by_processor(source: FleetSource) -> Iterator[Broken[Place]]:
    for agent, host in _hosts(source):
        sends = any(stream.codec == "h264" for stream in agent.streams)
        if sends and host.accelerator in {
            fleet_file.Accelerator.JETSON,
            fleet_file.Accelerator.V4L2,
        }:
            what = f"{agent.name} sends H.264, encoded by the processor on {host.accelerator.value}"
            yield Broken(host.place, what)


@RULES.add(
    "workspace-missing", "its sources are built into the image", "put it beside the fleet file"
)
def _no_workspace(source: FleetSource) -> Iterator[Broken[Place]]:
    for agent, host in _hosts(source):
        if host.workspace and not (source.folder / host.workspace / "src").is_dir():
            missing = f"but there is no {host.workspace}/src"
            yield Broken(
                host.place, f"{agent.name} has the colcon workspace {host.workspace}, {missing}"
            )


_Checked = tuple[Verdict, ...]


def check_fleet(
    source: FleetSource,
    release: Release,
    *,
    agents: Sequence[str] = (),
    detect: Detect = lambda _: None,
    progress: Callable[[Iterable[_Checked]], Iterable[_Checked]] = iter,
) -> tuple[Verdict, ...]:
    """Check a fleet of `load_source` and everything that would be made of it for some agents; none: for all.

    Agents are checked beside each other, for linters are programs; each passes `progress` when it is.

    Raises:
        InvalidValueError: The fleet has no such agent.
    """
    names = agents or tuple(agent.name for agent in source.fleet.agents)
    border, machines = lint(source.fleet).findings, tuple(RULES.broken(source, lambda place: place))
    verdicts = [
        verdict_of(
            "names, domains, QoS and frames", str(source.path), lambda: _fleet_errors(border)
        ),
        verdict_of("machines and routers", str(source.path), lambda: _fleet_errors(machines)),
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
        with ThreadPoolExecutor(len(sched_getaffinity(0))) as pool:
            found = pool.map(lambda made: check_bundle(made[1], made[0]), rendered.values())
            for name, checked in zip(rendered, progress(found), strict=True):
                verdicts += (
                    replace(verdict, subject=f"{name}/{verdict.subject}") for verdict in checked
                )
    return tuple(verdicts)


def fails(verdicts: Iterable[Verdict]) -> bool:
    """Tell whether anything does not hold."""
    return any(verdict.state is State.FAILS for verdict in verdicts)


def _fleet_errors(findings: Iterable[Finding]) -> Iterator[str]:
    """Yield the first error of each kind in full, and how many there are like it."""
    kinds: dict[str, list[Finding]] = defaultdict(list)
    for finding in findings:
        if finding.severity is Severity.ERROR:
            kinds[finding.code].append(finding)
    for first, *more in kinds.values():
        like = f", and {len(more)} more like it" if more else ""
        yield f"{first.place}: {first.what} ({first.why}; {first.remedy}){like}"


_NO_FILE = "there is no such file"


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnRules:
    """Rules of ours for files of a kind, which stand beside what renders them."""

    check: str  #: What is asked.
    pattern: str  #: Which files, as in ``systemd/*.service``; that there is one is asked too.
    #: Takes a file's text and its name without folders, returns findings; errors fail.
    rules: Callable[[str, str], Iterable[Finding]]
    program: str = ""  #: What they also ask where it is installed; empty: none.
    install: str = ""  #: The command that installs it.


_UNIT = {"program": "systemd-analyze", "install": "apt install systemd"}
OWN_RULES = (
    OwnRules(check="layers and provenance", pattern="Dockerfile", rules=check_dockerfile),
    OwnRules(check="service unit", pattern="systemd/*.service", rules=check_unit, **_UNIT),
)
"""Our rules for Dockerfiles and for units of systemd."""


def check_bundle(
    files: Mapping[str, BundleFile], deployment: Deployment, own: Iterable[OwnRules] = OWN_RULES
) -> tuple[Verdict, ...]:
    """Return every check's verdict about an agent's folder, its files by their paths relative to it."""
    return (
        *check_compose(files, deployment),
        *check_dockerfiles(files),
        *check_shell(files),
        *_routers(files, deployment),
        *_editor(files),
        *(verdict for rules in own for verdict in _own(rules, files)),
        *check_secrets(files),
    )


def _own(own: OwnRules, files: Mapping[str, BundleFile]) -> Iterator[Verdict]:
    names = [name for name in files if fnmatchcase(name, own.pattern)]
    if not names:
        yield Verdict(check=own.check, subject=own.pattern, state=State.FAILS, says=_NO_FILE)
    for name in names:
        yield verdict_of(
            own.check, name, _errors, own.rules, files[name].text, name.rpartition("/")[2]
        )
        try:  # that a program was not asked is told by a verdict of its own
            find_program(own.program or "sh", own.install)
        except MissingProgramError as error:
            yield Verdict(check=own.program, subject=name, state=State.SKIPPED, says=str(error))


def _errors(find: Callable[..., Iterable[Finding]], *about: Any) -> Iterator[str]:
    yield from error_sentences(find(*about))


def _routers(files: Mapping[str, BundleFile], deployment: Deployment) -> Iterator[Verdict]:
    """Yield a verdict about a DDS Router's file; our own router reads the fleet file."""
    expected = ROUTER_FILE if deployment.common.router is RouterSoftware.DDS_ROUTER else ""
    given = (name for name in files if name.startswith("router/"))
    for name in dict.fromkeys(filter(None, (expected, *given))):
        if name in files:
            yield verdict_of(
                "router's file", name, _errors, _router, files, name, deployment.fleet.policy
            )
        else:
            yield Verdict(check="router's file", subject=name, state=State.FAILS, says=_NO_FILE)


def _router(files: Mapping[str, BundleFile], name: str, policy: Policy) -> tuple[Finding, ...]:
    return check_dds_router(files[name].text, file=name, policy=policy)


def _editor(files: Mapping[str, BundleFile]) -> Iterator[Verdict]:
    found = cache(partial(check_editor, files))
    names = {name for name in files if name.startswith((".devcontainer/", ".vscode/"))}
    for name in sorted(names | set(SHAPES)):
        yield verdict_of("editor's file", name, _errors, _of_file, found, name)


def _of_file(found: Callable[[], Iterable[Finding]], name: str) -> list[Finding]:
    return [finding for finding in found() if finding.place.file == name]
