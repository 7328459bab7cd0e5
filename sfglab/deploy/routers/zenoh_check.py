"""Faults of a Zenoh bridge's configuration and access control: shape, and what they open, halve and rename.

Knows the keys that `zenoh-bridge-ros2dds` and Zenoh 1's access control take (``schemas/zenoh.yaml``); of other
sections of Zenoh's only that there are some, because they do not decide what crosses.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from sfglab.deploy.routers.dds_router import probe_names
from sfglab.deploy.routers.zenoh import KINDS
from sfglab.deploy.shapes import check_shape, read_json5
from sfglab.deploy.verdicts import Broken, Rules, error_sentences, worst_first
from sfglab.fleet.lint import Finding, Severity
from sfglab.fleet.policy import Direction, Policy
from sfglab.names import FqnError, ResourceKind, dds_names, ros_name_from_dds

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.documents import KeyPath

Bridge = dict[str, Any]
Control = dict[str, Any]
PLUGIN, CONTROL = ("plugins", "ros2dds"), ("access_control",)

#: What a bridge's configuration may mean that has the right shape.
RULES: Rules[Bridge, KeyPath] = Rules()

#: Whether it routes what a policy lets cross.
POLICY: Rules[tuple[Bridge, Policy], KeyPath] = Rules()

#: What access control may mean that has the right shape.
CONTROL_RULES: Rules[Control, KeyPath] = Rules()

#: The same of messages, if no rule is broken.
CONTROL_POLICY: Rules[tuple[Control, Policy], KeyPath] = Rules()


def check_zenoh(
    content: str, *, file: str = "zenoh.json5", policy: Policy | None = None
) -> tuple[Finding, ...]:
    """Return what is wrong with a Zenoh bridge's configuration in JSON5, the worst first.

    It has ``plugins.ros2dds``, ``access_control``, or both; the file's name is for places. The policy says
    what should cross; None does not ask.

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
    if bridge is not None and not any(error_sentences(_below(shape, ".".join(PLUGIN)))):
        findings += RULES.broken(bridge, document.place)
        findings += POLICY.broken((bridge, policy), document.place) if policy else ()
    if "access_control" in config and not _below(shape, *CONTROL):
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
    "open-router",
    "every topic, service and action of every agent crosses",
    "list what may cross under allow",
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
            yield Broken(
                (*PLUGIN, "allow"), found, f"allow {what}_{missing} as well, unless other agents do"
            )


@POLICY.add(
    "policy",
    "the bridge does not do what the fleet file says",
    "generate the file from the fleet file",
)
def _differences(asked: tuple[Bridge, Policy]) -> Iterator[Broken[KeyPath]]:
    """Find the first interface of each kind that a bridge routes and a policy keeps, or the other way round."""
    bridge, policy = asked
    for kind in KINDS:
        for name in _probes(bridge, policy):
            if kind.startswith("action") and any(r.pattern == f"rq{name}/*" for r in policy.rules):
                continue  # see `bridged_names`: no name of the schema
            try:
                should = policy_bridges(policy, kind, name)
            except FqnError:
                continue
            if bridges(bridge, kind, name) is not should:
                does = (
                    "does not cross, and the policy lets it"
                    if should
                    else "crosses, and the policy keeps it"
                )
                yield Broken((*PLUGIN, "allow", kind), f"{name} ({kind}) {does}")
                break


def _probes(bridge: Bridge, policy: Policy) -> tuple[str, ...]:
    sides = [bridge.get(side, {}) for side in ("allow", "deny")]
    entries = [entry for kind in KINDS for side in sides for entry in _texts(side.get(kind))]
    globs = [f"rt{entry.strip('^$').replace('.*', '*')}" for entry in entries]
    wires = map(ros_name_from_dds, probe_names([*globs, *(rule.pattern for rule in policy.rules)]))
    return tuple(sorted({wire.name for wire in wires if wire is not None}))


def bridges(bridge: Bridge, kind: str, name: str) -> bool:
    """Return whether a bridge with these values of ``plugins.ros2dds`` routes a ROS name, by `KINDS`."""
    if "allow" in bridge:
        return _listed(bridge["allow"].get(kind), name)
    return not _listed(bridge.get("deny", {}).get(kind), name)


def policy_bridges(policy: Policy, kind: str, name: str) -> bool:
    """Return whether a policy lets a name of a kind, seen from inside, cross; `FqnError` if it is none."""
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
    return any(re.search(f"^{entry}$", name) for entry in _texts(regexes))


def _texts(value: str | list[str] | None) -> list[str]:
    return [value] if isinstance(value, str) else value or []


@CONTROL_RULES.add("open-router", "it filters nothing until it is", "enabled: true")
def _disabled(control: Control) -> Iterator[Broken[KeyPath]]:
    if control.get("enabled") is not True:
        yield Broken((*CONTROL, "enabled"), "access control is not enabled")


@CONTROL_RULES.add(
    "open-router",
    "every name that nobody thought of crosses",
    "default_permission: deny",
    Severity.WARNING,
)
def _allowed_by_default(control: Control) -> Iterator[Broken[KeyPath]]:
    if control.get("default_permission") == "allow":
        yield Broken((*CONTROL, "default_permission"), "whatever no rule names is allowed")


@CONTROL_RULES.add("duplicate", "Zenoh does not start")
def _same_id(control: Control) -> Iterator[Broken[KeyPath]]:
    for key in ("rules", "subjects"):
        names = [item["id"] for item in control[key]]
        for position, name in enumerate(names):
            if name in names[:position]:
                yield Broken((*CONTROL, key, position), f"{name!r} is an id twice")


@CONTROL_RULES.add("reference", "Zenoh does not start")
def _unknown_id(control: Control) -> Iterator[Broken[KeyPath]]:
    for key in ("rules", "subjects"):
        known = [entry["id"] for entry in control[key]]
        for position, item in enumerate(control["policies"]):
            for name in item[key]:
                if name not in known:
                    yield Broken(
                        (*CONTROL, "policies", position, key), f"{name!r} is none of the {key}"
                    )


@CONTROL_RULES.add("unused", "it has no effect", severity=Severity.WARNING)
def _unused(control: Control) -> Iterator[Broken[KeyPath]]:
    used = {name for item in control["policies"] for name in item["rules"]}
    for position, rule in enumerate(control["rules"]):
        if rule["id"] not in used:
            yield Broken((*CONTROL, "rules", position), f"rule {rule['id']!r} is in no policy")


@CONTROL_POLICY.add(
    "policy",
    "access control does not do what the fleet file says",
    "generate the file from the fleet file",
)
def _other_messages(asked: tuple[Control, Policy]) -> Iterator[Broken[KeyPath]]:
    control, policy = asked
    for way, flow in ((Direction.OUTWARD, "egress"), (Direction.INWARD, "ingress")):
        for key in _KEYS:
            should = policy.crosses(f"rt/{key}", way)
            if permits(control, "put", flow, key) is not should:
                does = (
                    "is stopped, and the policy lets it cross"
                    if should
                    else "passes, and the policy keeps it"
                )
                yield Broken((*CONTROL, "rules"), f"a message of {key} {does} ({flow})")


_KEYS = (
    *("chatter", "rosout", "local/go2/x", "tf", "tf_static", "tf2"),
    *("global", "global/x", "global/go2/a/b", "globally/x"),
)


def includes(expression: str, key: str) -> bool:
    """Return whether a Zenoh key expression stands for a key.

    ``*`` is one segment, ``**`` any number of them, ``$*`` any characters within one; a segment that begins
    with ``@`` is stood for by itself only.
    """
    return _includes(expression.split("/"), key.split("/"))


def _includes(expression: list[str], key: list[str]) -> bool:
    if not expression:
        return not key
    first, *rest = expression
    if first == "**":
        return _includes(rest, key) or (
            bool(key) and key[0][:1] != "@" and _includes(expression, key[1:])
        )
    return bool(key) and _segment(first, key[0]) and _includes(rest, key[1:])


def _segment(expression: str, segment: str) -> bool:
    if segment.startswith("@"):
        return expression == segment
    if expression == "*":
        return True
    pattern = ".*".join(re.escape(part) for part in expression.split("$*"))
    return re.fullmatch(pattern, segment) is not None


def permits(control: Control, message: str, flow: str, key: str) -> bool:
    """Return whether these values of ``access_control`` let a message pass, for everybody.

    The message has a kind, as in ``put``, and a key; the flow is ``egress`` or ``ingress``. Denying rules win
    over allowing ones; without either, the default decides. Rules of other subjects are passed over.
    """
    everybody = {subject["id"] for subject in control["subjects"] if set(subject) == {"id"}}
    used = {r for p in control["policies"] if everybody & set(p["subjects"]) for r in p["rules"]}
    matching = {
        rule["permission"]
        for rule in control["rules"]
        if rule["id"] in used
        and message in rule["messages"]
        and flow in rule.get("flows", ("egress", "ingress"))
        and any(includes(expression, key) for expression in rule["key_exprs"])
    }
    decided = matching or {control.get("default_permission", "deny")}
    return "allow" in decided and "deny" not in decided
