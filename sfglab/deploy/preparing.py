"""Preparation of the bundles of a fleet's agents from its file on disk.

The one place that reads a fleet file, the checkout and this machine together; everything after it is pure.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sfglab.deploy.bundle import Bundle, bundle_of, workspace_members
from sfglab.deploy.deployment import Deployment, deployment_of
from sfglab.deploy.errors import DeployError
from sfglab.documents import suggestion
from sfglab.fleet.fleet_file import AUTO, Accelerator, read_fleet

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from sfglab.deploy.deployment import Release
    from sfglab.fleet.fleet_file import AgentSpec, Fleet, HostSpec


Detect = Callable[["HostSpec"], "Accelerator | None"]
"""Asked for the accelerator of a machine whose fleet file leaves it to detection."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSource:
    """A fleet and where it was read."""

    fleet: Fleet  #: The fleet.
    path: Path  #: Its file.
    text: str  #: What stands in it.

    @property
    def folder(self) -> Path:
        """Where the file stands; workspaces are named relative to it."""
        return self.path.parent


def load_source(path: Path) -> FleetSource:
    """Read a fleet file.

    Raises:
        DocumentError: It is not a fleet.
        DeployError: It cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DeployError(f"{path}: {error}, allowed: a fleet file in UTF-8") from error
    return FleetSource(fleet=read_fleet(text, str(path)), path=path, text=text)


def with_accelerator(source: FleetSource, agents: Sequence[str], name: str) -> FleetSource:
    """Return a fleet whose machines have an accelerator, whatever its file says.

    Args:
        source: The fleet.
        agents: Whose machines; none: all.
        name: What they have, or ``auto``, which leaves it to detection.

    Raises:
        DeployError: There is no accelerator of that name.
    """
    choices = (AUTO, *(member.value for member in Accelerator))
    if name not in choices:
        raise DeployError(
            f"accelerator: given {name!r}, allowed: {', '.join(choices)}{suggestion(name, choices)}"
        )
    accelerator = None if name == AUTO else Accelerator(name)

    def changed(agent: AgentSpec) -> AgentSpec:
        if agent.host is None or (agents and agent.name not in agents):
            return agent
        return replace(agent, host=replace(agent.host, accelerator=accelerator))

    return replace(source, fleet=replace(source.fleet, agents=tuple(map(changed, source.fleet.agents))))


def prepare(
    source: FleetSource,
    release: Release,
    wheel: bytes,
    *,
    agents: Sequence[str] = (),
    detect: Detect = lambda _: None,
) -> tuple[tuple[Deployment, Bundle], ...]:
    """Return deployment and bundle of agents.

    Args:
        source: The fleet.
        release: What is deployed.
        wheel: The bytes of its wheel.
        agents: Their names; none: all.
        detect: Asked for the accelerator of a machine whose fleet file leaves it to detection.

    Raises:
        DeployError: An agent cannot be deployed as it is described.
        UnknownAgentError: The fleet has no such agent.
    """
    names = agents or [agent.name for agent in source.fleet.agents]
    pairs = []
    for deployment in (describe(source, name, release, detect) for name in names):
        folder = deployment.host.workspace
        workspace = workspace_members(source.folder / folder) if folder else {}
        pairs.append((deployment, bundle_of(deployment, wheel, workspace)))
    return tuple(pairs)


def describe(source: FleetSource, agent: str, release: Release, detect: Detect) -> Deployment:
    """Return one agent's deployment, with what detection says where the fleet file leaves it open.

    Raises:
        DeployError: It cannot be deployed as it is described, or its machine cannot be reached.
        UnknownAgentError: The fleet has no such agent.
    """
    host = source.fleet.agent(agent).host
    detected = detect(host) if host is not None and host.accelerator is None else None
    return deployment_of(source.fleet, agent, release, detected=detected)
