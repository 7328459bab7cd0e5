"""All checks of a fleet before anything is brought anywhere, in three steps: the fleet, its files, each file.

A step is asked only when the one before it holds: files of a fleet that makes no sense are not worth a word.
"""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from sfglab.deploy.bundle import render_bundle
from sfglab.deploy.checking import State, Verdict, check_bundle, verdict_of
from sfglab.deploy.preparing import describe
from sfglab.deploy.rules import check_rules
from sfglab.errors import SfglabError
from sfglab.fleet.border import Severity, lint

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from sfglab.deploy.deployment import Deployment, Release
    from sfglab.deploy.files import BundleFile
    from sfglab.deploy.preparing import Detect, FleetSource
    from sfglab.fleet.border import Finding


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
    for name in names:

        def made(name: str = name) -> Iterator[str]:
            yield from _render(source, name, release, detect, rendered)

        verdicts.append(verdict_of("files are made", name, made))
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


def _render(
    source: FleetSource,
    name: str,
    release: Release,
    detect: Detect,
    into: dict[str, tuple[Deployment, dict[str, BundleFile]]],
) -> Iterator[str]:
    """Make an agent's files; yield why that is not possible."""
    try:
        deployment = describe(source, name, release, detect)
        into[name] = deployment, render_bundle(deployment)
    except SfglabError as error:
        yield str(error)


def _errors(findings: Iterable[Finding]) -> Iterator[str]:
    """Yield the first error of each kind in full, and how many there are like it."""
    kinds: dict[str, list[Finding]] = defaultdict(list)
    for finding in findings:
        if finding.severity is Severity.ERROR:
            kinds[finding.code].append(finding)
    for first, *more in kinds.values():
        like = f", and {len(more)} more like it" if more else ""
        yield f"{first.place}: {first.what} ({first.why}; {first.remedy}){like}"
