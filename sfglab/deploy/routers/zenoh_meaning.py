"""What a Zenoh bridge's filter means although it can be loaded: what it opens, halves and renames."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from sfglab.deploy.routers.probes import probe_names
from sfglab.deploy.routers.shapes import fault
from sfglab.deploy.routers.zenoh import KINDS
from sfglab.fleet.border import Finding, Severity
from sfglab.fleet.routing import Direction
from sfglab.names import FqnError, ResourceKind, dds_names, ros_name_from_dds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sfglab.documents import Document
    from sfglab.fleet.routing import Policy


Bridge = dict[str, Any]
PLUGIN = ("plugins", "ros2dds")


def bridges(bridge: Bridge, kind: str, name: str) -> bool:
    """Return whether a bridge with this configuration routes an interface.

    Args:
        bridge: The values of ``plugins.ros2dds``.
        kind: One of `KINDS`.
        name: Absolute ROS name.
    """
    if "allow" in bridge:
        return _listed(bridge["allow"].get(kind), name)
    return not _listed(bridge.get("deny", {}).get(kind), name)


def policy_bridges(policy: Policy, kind: str, name: str) -> bool:
    """Return whether a policy lets an interface of one kind, seen from inside the agent, cross.

    Raises:
        FqnError: The name is not valid for its kind.
    """
    what, role = kind.split("_") if "_" in kind else ("topic", kind)
    speaks = role in {"publishers", "servers"}
    out = Direction.OUTWARD if speaks else Direction.INWARD
    back = Direction.INWARD if speaks else Direction.OUTWARD
    for dds in dds_names(name, ResourceKind(what)):
        asked = dds.startswith("rq/")
        if not policy.crosses(dds, back if asked else out):
            return False
    return True


def _listed(regexes: str | list[str] | None, name: str) -> bool:
    if regexes is None:
        return False
    entries = [regexes] if isinstance(regexes, str) else regexes
    return any(re.search(f"^{entry}$", name) for entry in entries)


def _open(document: Document, bridge: Bridge) -> Iterator[Finding]:
    if "allow" in bridge and "deny" in bridge:
        yield fault(
            document, (*PLUGIN, "deny"), "both allow and deny are given", why="the bridge does not start"
        )
    elif "deny" in bridge:
        yield fault(
            document,
            (*PLUGIN, "deny"),
            "deny instead of allow",
            why="every name that nobody thought of crosses",
            remedy="list what may cross under allow",
            code="open-router",
            severity=Severity.WARNING,
        )
    elif "allow" not in bridge:
        yield fault(
            document,
            PLUGIN,
            "there is neither allow nor deny",
            why="every topic, service and action of every agent crosses",
            remedy="list what may cross under allow",
            code="open-router",
        )


def _namespace(document: Document, bridge: Bridge) -> Iterator[Finding]:
    if bridge.get("namespace", "/") != "/":
        yield fault(
            document,
            (*PLUGIN, "namespace"),
            f"namespace {bridge['namespace']!r} is put in front of every name",
            why="also of absolute ones: /tf and /global/... become other names for everybody else",
            remedy='namespace: "/": the schema puts the agent into the name',
            code="namespace",
        )


def _pairs(document: Document, bridge: Bridge) -> Iterator[Finding]:
    allow = bridge.get("allow", {})
    for what in ("service", "action"):
        servers, clients = (allow.get(f"{what}_{role}") or [] for role in ("servers", "clients"))
        if "allow" in bridge and bool(servers) is not bool(clients):
            there, missing = ("servers", "clients") if servers else ("clients", "servers")
            yield fault(
                document,
                (*PLUGIN, "allow"),
                f"{what}_{there} are allowed, {what}_{missing} are not",
                why=f"with the same file everywhere no {what} works: one side's client is the other's server",
                remedy=f"allow {what}_{missing} as well, unless other agents do",
                code="half-open",
                severity=Severity.WARNING,
            )


def check_bridge_policy(document: Document, bridge: Bridge, policy: Policy) -> Iterator[Finding]:
    """Find interfaces that a bridge routes although the policy keeps them, or the other way round."""
    for kind in KINDS:
        for name in _probes(bridge, policy):
            if kind.startswith("action") and any(r.pattern == f"rq{name}/*" for r in policy.rules):
                continue  # see `action_names`: no name of the schema
            try:
                should = policy_bridges(policy, kind, name)
            except FqnError:
                continue
            if bridges(bridge, kind, name) is not should:
                does = (
                    "does not cross, and the policy lets it" if should else "crosses, and the policy keeps it"
                )
                yield fault(
                    document,
                    (*PLUGIN, "allow", kind),
                    f"{name} ({kind}) {does}",
                    why="the bridge does not do what the fleet file says",
                    remedy="generate the file from the fleet file",
                    code="policy",
                )
                break


def _probes(bridge: Bridge, policy: Policy) -> tuple[str, ...]:
    entries = [e for kind in KINDS for e in _entries(bridge, kind)]
    globs = [f"rt{entry.strip('^$').replace('.*', '*')}" for entry in entries]
    found = {_ros_name(name) for name in probe_names([*globs, *(rule.pattern for rule in policy.rules)])}
    return tuple(sorted(name for name in found if name is not None))


def _entries(bridge: Bridge, kind: str) -> list[str]:
    given = [*(bridge.get(side, {}).get(kind) or [] for side in ("allow", "deny"))]
    return [entry for part in given for entry in ([part] if isinstance(part, str) else part)]


def _ros_name(dds_name: str) -> str | None:
    wire = ros_name_from_dds(dds_name)
    return None if wire is None else wire.name


BRIDGE_MEANINGS: tuple[Callable[[Document, Bridge], Iterator[Finding]], ...] = (_open, _namespace, _pairs)
"""Every check of a bridge's configuration that has the right shape."""
