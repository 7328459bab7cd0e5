"""Faults of a Zenoh bridge's configuration: its shape, and what it opens, halves and renames.

Knows the keys that `zenoh-bridge-ros2dds` and Zenoh's access control take (``schemas/zenoh.yaml``); of Zenoh's
other sections only that there are some, because they do not decide what crosses.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from sfglab.deploy.findings import Broken, Rules, has_errors, worst_first
from sfglab.deploy.json5 import read_json5
from sfglab.deploy.routers.dds_router import probe_names
from sfglab.deploy.routers.zenoh import KINDS
from sfglab.deploy.routers.zenoh_acl_check import HERE
from sfglab.deploy.routers.zenoh_acl_check import POLICY as CONTROL_POLICY
from sfglab.deploy.routers.zenoh_acl_check import RULES as CONTROL_RULES
from sfglab.deploy.shapes import check_shape
from sfglab.fleet.lint import Finding, Severity
from sfglab.fleet.policy import Direction, Policy
from sfglab.names import FqnError, ResourceKind, dds_names, ros_name_from_dds

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.documents import KeyPath


Bridge = dict[str, Any]
PLUGIN = ("plugins", "ros2dds")

RULES: Rules[Bridge, KeyPath] = Rules()
"""What a bridge's configuration may mean that has the right shape."""

POLICY: Rules[tuple[Bridge, Policy], KeyPath] = Rules()
"""Whether it routes what a policy lets cross, name by name."""


def check_zenoh(
    content: str, *, file: str = "zenoh.json5", policy: Policy | None = None
) -> tuple[Finding, ...]:
    """Return what is wrong with a Zenoh bridge's configuration, the worst first.

    Args:
        content: The JSON5 file's text, with ``plugins.ros2dds``, ``access_control``, or both.
        file: Its name, for the findings' places.
        policy: What should cross; None does not ask.

    Raises:
        DocumentError: It is not JSON5.
        MissingProgramError: The library that reads JSON Schema is not installed.
    """
    document = read_json5(content, file)
    shape = check_shape(document, "zenoh")
    config: Any = document.value if isinstance(document.value, dict) else {}
    plugins = config.get("plugins")
    bridge = plugins.get("ros2dds") if isinstance(plugins, dict) else None
    findings = list(shape)
    if bridge is not None and not has_errors(_below(shape, ".".join(PLUGIN))):
        findings += RULES.broken(bridge, document.place)
        findings += POLICY.broken((bridge, policy), document.place) if policy else ()
    if "access_control" in config and not _below(shape, *HERE):
        meant = list(CONTROL_RULES.broken(config["access_control"], document.place))
        if policy is not None and not meant:
            meant += CONTROL_POLICY.broken((config["access_control"], policy), document.place)
        findings += meant
    return worst_first(findings)


def _below(findings: tuple[Finding, ...], key: str) -> list[Finding]:
    return [finding for finding in findings if finding.place.key.startswith(key)]


@RULES.add("schema", "the bridge does not start")
def _both_lists(bridge: Bridge) -> Iterator[Broken[KeyPath]]:
    if "allow" in bridge and "deny" in bridge:
        yield Broken((*PLUGIN, "deny"), "both allow and deny are given")


@RULES.add(
    "open-router",
    "every name that nobody thought of crosses",
    "list what may cross under allow",
    Severity.WARNING,
)
def _only_denied(bridge: Bridge) -> Iterator[Broken[KeyPath]]:
    if "deny" in bridge and "allow" not in bridge:
        yield Broken((*PLUGIN, "deny"), "deny instead of allow")


@RULES.add(
    "open-router", "every topic, service and action of every agent crosses", "list what may cross under allow"
)
def _unfiltered(bridge: Bridge) -> Iterator[Broken[KeyPath]]:
    if not {"allow", "deny"} & set(bridge):
        yield Broken(PLUGIN, "there is neither allow nor deny")


@RULES.add(
    "namespace",
    "also of absolute ones: /tf and /global/... become other names for everybody else",
    'namespace: "/": the schema puts the agent into the name',
)
def _namespace(bridge: Bridge) -> Iterator[Broken[KeyPath]]:
    if bridge.get("namespace", "/") != "/":
        what = f"namespace {bridge['namespace']!r} is put in front of every name"
        yield Broken((*PLUGIN, "namespace"), what)


@RULES.add(
    "half-open",
    "with the same file everywhere none of them works: one side's client is the other's server",
    severity=Severity.WARNING,
)
def _pairs(bridge: Bridge) -> Iterator[Broken[KeyPath]]:
    allow = bridge.get("allow", {})
    for what in ("service", "action"):
        servers, clients = (allow.get(f"{what}_{role}") or [] for role in ("servers", "clients"))
        if "allow" in bridge and bool(servers) is not bool(clients):
            there, missing = ("servers", "clients") if servers else ("clients", "servers")
            found = f"{what}_{there} are allowed, {what}_{missing} are not"
            yield Broken((*PLUGIN, "allow"), found, f"allow {what}_{missing} as well, unless other agents do")


@POLICY.add(
    "policy", "the bridge does not do what the fleet file says", "generate the file from the fleet file"
)
def _differences(asked: tuple[Bridge, Policy]) -> Iterator[Broken[KeyPath]]:
    """Find the first interface of each kind that a bridge routes and a policy keeps, or the other way round."""
    bridge, policy = asked
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
                yield Broken((*PLUGIN, "allow", kind), f"{name} ({kind}) {does}")
                break


def _probes(bridge: Bridge, policy: Policy) -> tuple[str, ...]:
    entries = [e for kind in KINDS for e in _entries(bridge, kind)]
    globs = [f"rt{entry.strip('^$').replace('.*', '*')}" for entry in entries]
    wires = map(ros_name_from_dds, probe_names([*globs, *(rule.pattern for rule in policy.rules)]))
    return tuple(sorted({wire.name for wire in wires if wire is not None}))


def _entries(bridge: Bridge, kind: str) -> list[str]:
    given = [*(bridge.get(side, {}).get(kind) or [] for side in ("allow", "deny"))]
    return [entry for part in given for entry in ([part] if isinstance(part, str) else part)]


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
