"""Routers by name: write a configuration for one, check one that somebody wrote."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.deploy.errors import DeployError
from sfglab.deploy.routers.dds_router import render_dds_router
from sfglab.deploy.routers.dds_router_check import check_dds_router
from sfglab.deploy.routers.domain_bridge import check_domain_bridge, render_domain_bridge
from sfglab.deploy.routers.zenoh import render_zenoh_acl, render_zenoh_bridge
from sfglab.deploy.routers.zenoh_check import check_zenoh
from sfglab.documents import Document, suggestion
from sfglab.files import read_text
from sfglab.fleet.fleet_file import Fleet, RouterSoftware

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.fleet.lint import Finding
    from sfglab.fleet.policy import Policy

TARGETS: dict[str, Callable[[Fleet, str], str]] = {
    "dds-router": render_dds_router,
    "zenoh-bridge": render_zenoh_bridge,
    "zenoh-acl": render_zenoh_acl,
    "domain-bridge": render_domain_bridge,
}
"""What a configuration can be written for: target -> function of fleet and agent."""


def render_router(fleet: Fleet, agent: str, target: str) -> str:
    """Return the configuration of an agent's router, one of `TARGETS`.

    Raises:
        DeployError: There is no such target, or it cannot express the policy.
        InvalidValueError: The fleet has no such agent.
    """
    if target not in TARGETS:
        raise DeployError(
            f"target: given {target!r}, allowed: {', '.join(TARGETS)}{suggestion(target, tuple(TARGETS))}"
        )
    return TARGETS[target](fleet, agent)


def check_file(path: Path | str, *, policy: Policy | None = None) -> tuple[Finding, ...]:
    """Check a file of a DDS Router, a domain_bridge (``.yaml``, ``.yml``) or Zenoh (``.json5``, ``.json``).

    A domain_bridge's has ``from_domain`` or its topics by name; other YAML is taken for a DDS Router's. The
    policy says what should cross, as in a fleet file; None does not ask. Findings come the worst first. Raises
    `InvalidValueError` or `DocumentError` if it cannot be read, `DeployError` if its name does not say what it
    is.
    """
    path = Path(path)
    checks: dict[str, Callable[..., tuple[Finding, ...]]] = {
        ".yaml": _check_yaml,
        ".yml": _check_yaml,
        ".json5": check_zenoh,
        ".json": check_zenoh,
    }
    check = checks.get(path.suffix)
    if check is None:
        raise DeployError(f"{path}: given a file {path.suffix!r}, allowed: {', '.join(checks)}")
    return check(read_text(path, f"a file {path.suffix} in UTF-8"), file=str(path), policy=policy)


ROUTER_FILES = {
    RouterSoftware.DDS_ROUTER: "router/dds-router.yaml",
    RouterSoftware.ZENOH_BRIDGE: "router/zenoh-bridge.json5",
}
"""Where it stands in the agent's folder; our own router reads the fleet file."""


def render_router_file(fleet: Fleet, agent: str, interface: str) -> str:
    """Return the configuration of the router that the fleet uses, empty for our own.

    Its `interface` to the agent takes the place of what the fleet file says of the agent's own nodes.

    Raises:
        DeployError: That router cannot express the fleet's policy.
    """
    if fleet.deployment.router not in ROUTER_FILES:
        return ""
    agents = tuple(
        replace(a, local_interface=interface) if a.name == agent else a for a in fleet.agents
    )
    return render_router(replace(fleet, agents=agents), agent, fleet.deployment.router.value)


def _check_yaml(text: str, *, file: str, policy: Policy | None) -> tuple[Finding, ...]:
    config = Document(text, file).value
    bridge = isinstance(config, dict) and (
        "from_domain" in config or isinstance(config.get("topics"), dict)
    )
    return (check_domain_bridge if bridge else check_dds_router)(text, file=file, policy=policy)
