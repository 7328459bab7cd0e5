"""Faults of Zenoh's access control that has the right shape, and whether it lets cross what the policy does.

Format: section ``access_control`` of Zenoh 1 (``schemas/zenoh.yaml``).
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from sfglab.deploy.findings import Broken, Rules
from sfglab.fleet.lint import Severity
from sfglab.fleet.policy import Direction, Policy

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.documents import KeyPath


Control = dict[str, Any]
HERE = ("access_control",)
_PROBES = (
    *("chatter", "rosout", "local/go2/x", "tf", "tf_static", "tf2"),
    *("global", "global/x", "global/go2/a/b", "globally/x"),
)

RULES: Rules[Control, KeyPath] = Rules()
"""What access control may mean that has the right shape."""

POLICY: Rules[tuple[Control, Policy], KeyPath] = Rules()
"""Whether it lets messages pass that a policy lets cross, name by name; asked where no rule is broken."""


@RULES.add("open-router", "it filters nothing until it is", "enabled: true")
def _disabled(control: Control) -> Iterator[Broken[KeyPath]]:
    if control.get("enabled") is not True:
        yield Broken((*HERE, "enabled"), "access control is not enabled")


@RULES.add(
    "open-router", "every name that nobody thought of crosses", "default_permission: deny", Severity.WARNING
)
def _allowed_by_default(control: Control) -> Iterator[Broken[KeyPath]]:
    if control.get("default_permission") == "allow":
        yield Broken((*HERE, "default_permission"), "whatever no rule names is allowed")


@RULES.add("duplicate", "Zenoh does not start")
def _same_id(control: Control) -> Iterator[Broken[KeyPath]]:
    for key in ("rules", "subjects"):
        names = [item["id"] for item in control[key]]
        for position, name in enumerate(names):
            if name in names[:position]:
                yield Broken((*HERE, key, position), f"{name!r} is an id twice")


@RULES.add("reference", "Zenoh does not start")
def _unknown_id(control: Control) -> Iterator[Broken[KeyPath]]:
    for key in ("rules", "subjects"):
        known = [entry["id"] for entry in control[key]]
        for position, item in enumerate(control["policies"]):
            for name in item[key]:
                if name not in known:
                    yield Broken((*HERE, "policies", position, key), f"{name!r} is none of the {key}")


@RULES.add("unused", "it has no effect", severity=Severity.WARNING)
def _unused(control: Control) -> Iterator[Broken[KeyPath]]:
    used = {name for item in control["policies"] for name in item["rules"]}
    for position, rule in enumerate(control["rules"]):
        if rule["id"] not in used:
            yield Broken((*HERE, "rules", position), f"rule {rule['id']!r} is in no policy")


@POLICY.add(
    "policy", "access control does not do what the fleet file says", "generate the file from the fleet file"
)
def _differences(asked: tuple[Control, Policy]) -> Iterator[Broken[KeyPath]]:
    control, policy = asked
    for way, flow in ((Direction.OUTWARD, "egress"), (Direction.INWARD, "ingress")):
        for key in _PROBES:
            should = policy.crosses(f"rt/{key}", way)
            if permits(control, "put", flow, key) is not should:
                does = (
                    "is stopped, and the policy lets it cross" if should else "passes, and the policy keeps it"
                )
                yield Broken((*HERE, "rules"), f"a message of {key} {does} ({flow})")


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
        return _includes(rest, key) or (bool(key) and key[0][:1] != "@" and _includes(expression, key[1:]))
    return bool(key) and _segment(first, key[0]) and _includes(rest, key[1:])


def _segment(expression: str, segment: str) -> bool:
    if segment.startswith("@"):
        return expression == segment
    if expression == "*":
        return True
    pattern = ".*".join(re.escape(part) for part in expression.split("$*"))
    return re.fullmatch(pattern, segment) is not None


def permits(control: Control, message: str, flow: str, key: str) -> bool:
    """Return whether access control lets a message pass, for everybody.

    Denying rules win over allowing ones; without either, the default decides. Rules of other subjects than
    everybody are passed over.

    Args:
        control: The values of ``access_control``.
        message: Its kind, as in ``put``.
        flow: ``egress`` or ``ingress``.
        key: The message's key.
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
    if "deny" in matching:
        return False
    return "allow" in matching or control.get("default_permission", "deny") == "allow"
