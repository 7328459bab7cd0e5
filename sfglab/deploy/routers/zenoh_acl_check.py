"""What is wrong with Zenoh's access control, and whether it lets cross what the policy does.

Format: section ``access_control`` of Zenoh 1 (DEFAULT_CONFIG.json5, 2025).
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from sfglab.deploy.routers.shapes import fault, flag, listing, mapping, text
from sfglab.fleet.border import Finding, Severity
from sfglab.fleet.routing import Direction

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.documents import Document, KeyPath
    from sfglab.fleet.routing import Policy


Control = dict[str, Any]
HERE = ("access_control",)
MESSAGES = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)
PROTOCOLS = ("tcp", "udp", "tls", "quic", "ws", "serial", "unixsock-stream", "unixpipe", "vsock")
PROBES = (
    "chatter",
    "rosout",
    "local/go2/x",
    "tf",
    "tf_static",
    "tf2",
    "global",
    "global/x",
    "global/go2/a/b",
    "globally/x",
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
        message: One of `MESSAGES`.
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


def check_access_control(document: Document, control: Any, policy: Policy | None) -> Iterator[Finding]:
    """Find what is wrong with a section ``access_control``, and with its meaning.

    Args:
        document: Where it stands.
        control: Its values.
        policy: What should cross; None does not ask.
    """
    found = list(_CONTROL(document, HERE, control))
    if not found:
        for check in (_disabled, _identities, _references):
            found += check(document, control)
        found += _check_policy(document, control, policy) if policy and not found else ()
    yield from found


def _disabled(document: Document, control: Control) -> Iterator[Finding]:
    if control.get("enabled") is not True:
        yield fault(
            document,
            (*HERE, "enabled"),
            "access control is not enabled",
            why="it filters nothing until it is",
            remedy="enabled: true",
            code="open-router",
        )
    if control.get("default_permission") == "allow":
        yield fault(
            document,
            (*HERE, "default_permission"),
            "whatever no rule names is allowed",
            why="every name that nobody thought of crosses",
            remedy="default_permission: deny",
            code="open-router",
            severity=Severity.WARNING,
        )


def _identities(document: Document, control: Control) -> Iterator[Finding]:
    for key in ("rules", "subjects"):
        names = [item["id"] for item in control[key]]
        for position, name in enumerate(names):
            if names.index(name) != position:
                what = f"{name!r} is an id twice"
                yield fault(
                    document, (*HERE, key, position), what, why="Zenoh does not start", code="duplicate"
                )


def _references(document: Document, control: Control) -> Iterator[Finding]:
    used: set[str] = set()
    for position, item in enumerate(control["policies"]):
        for key in ("rules", "subjects"):
            known = [entry["id"] for entry in control[key]]
            for name in item[key]:
                used.add(name)
                if name not in known:
                    what = f"{name!r} is none of the {key}"
                    path = (*HERE, "policies", position, key)
                    yield fault(document, path, what, why="Zenoh does not start", code="reference")
    for position, rule in enumerate(control["rules"]):
        if rule["id"] not in used:
            yield fault(
                document,
                (*HERE, "rules", position),
                f"rule {rule['id']!r} is in no policy",
                why="it has no effect",
                code="unused",
                severity=Severity.WARNING,
            )


def _check_policy(document: Document, control: Control, policy: Policy) -> Iterator[Finding]:
    for way, flow in ((Direction.OUTWARD, "egress"), (Direction.INWARD, "ingress")):
        for key in PROBES:
            should = policy.crosses(f"rt/{key}", way)
            if permits(control, "put", flow, key) is not should:
                does = (
                    "is stopped, and the policy lets it cross" if should else "passes, and the policy keeps it"
                )
                yield fault(
                    document,
                    (*HERE, "rules"),
                    f"a message of {key} {does} ({flow})",
                    why="access control does not do what the fleet file says",
                    remedy="generate the file from the fleet file",
                    code="policy",
                )


def _key_expression(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
    bad = not isinstance(value, str) or not value or any(_bad_segment(s) for s in str(value).split("/"))
    if bad:
        yield fault(
            document,
            path,
            f"given {value!r}, allowed: a key expression",
            why="segments are not empty; '*' and '**' stand alone, '$*' within one; '#' and '?' do not stand",
            remedy="a ROS name goes without its first slash",
            code="key-expression",
        )


def _bad_segment(segment: str) -> bool:
    if segment in {"*", "**"}:
        return False
    return not segment or "*" in segment.replace("$*", "") or bool(set("#?$") & set(segment.replace("$*", "")))


_RULE = mapping(
    {
        "id": text(),
        "permission": text("allow", "deny"),
        "messages": listing(text(*MESSAGES), least=1),
        "flows": listing(text("egress", "ingress"), least=1),
        "key_exprs": listing(_key_expression, least=1),
    },
    needed=("id", "permission", "messages", "key_exprs"),
)
_SUBJECT = mapping(
    {
        "id": text(),
        **dict.fromkeys(("interfaces", "cert_common_names", "usernames", "zids"), listing(text(), least=1)),
        "link_protocols": listing(text(*PROTOCOLS), least=1),
    },
    needed=("id",),
)
_POLICY = mapping(
    {"id": text(), "rules": listing(text(), least=1), "subjects": listing(text(), least=1)},
    needed=("rules", "subjects"),
)
_CONTROL = mapping(
    {
        "enabled": flag,
        "default_permission": text("allow", "deny"),
        "rules": listing(_RULE),
        "subjects": listing(_SUBJECT),
        "policies": listing(_POLICY),
    },
    needed=("rules", "subjects", "policies"),
)
"""The shape of ``access_control``; without one of its three lists Zenoh does not start."""
