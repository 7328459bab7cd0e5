"""What is wrong with a Zenoh bridge's configuration or access control, and whether it is the policy.

Knows the keys that `zenoh-bridge-ros2dds` and Zenoh's access control take (see `zenoh`); of Zenoh's other
sections only that there are some, because they do not decide what crosses.
"""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

from sfglab.deploy.routers.shapes import (
    anything,
    fault,
    flag,
    listing,
    mapping,
    number,
    probe_names,
    text,
    whole,
)
from sfglab.deploy.routers.zenoh import KINDS
from sfglab.deploy.routers.zenoh_acl_check import check_access_control
from sfglab.documents import Document
from sfglab.fleet.border import Finding, Severity
from sfglab.fleet.fleet_file import MAX_DOMAIN
from sfglab.fleet.routing import Direction
from sfglab.names import FqnError, ResourceKind, dds_names, ros_name_from_dds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sfglab.documents import KeyPath
    from sfglab.fleet.routing import Policy


_TOKEN = re.compile(
    r"""
      (?P<string>"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*')
    | (?P<comment>//[^\n]*|/\*.*?\*/)
    | (?P<comma>,(?=(?:\s|//[^\n]*|/\*.*?\*/)*[}\]]))
    | (?P<colon>:)
    | (?P<tab>\t)
    | (?P<word>[A-Za-z_$][\w$]*)
    | (?P<power>-?\d+(?:\.\d*)?[eE][+-]?\d+)
    """,
    re.VERBOSE | re.DOTALL,
)


def read_json5(text: str, file: str) -> Document:
    """Read a JSON5 file.

    Args:
        text: What stands in it.
        file: Its name, for places.

    Raises:
        DocumentError: It is not JSON5, or has more of it than is taken here.
    """
    return Document(_TOKEN.sub(_as_yaml, text), file)


def _as_yaml(token: re.Match[str]) -> str:
    """Return what stands for a token in YAML, with as many lines."""
    found = token.group()
    match token.lastgroup:
        case "string":
            return _string(found)
        case "colon":
            return ": "
        case "word":
            return found
        case "power":
            return repr(float(found))  # YAML 1.1 asks for a dot and a sign
        case _:
            return "\n" * found.count("\n") + " "


def _string(found: str) -> str:
    """Return a string of YAML; a pair of surrogates, which YAML does not know, becomes one character."""
    inner = found[1:-1]
    if found[0] == "'":
        inner = inner.replace("\\'", "'").replace('"', '\\"')
    try:
        value = json.loads(f'"{inner}"')
    except json.JSONDecodeError:
        return f'"{inner}"'  # an escape that JSON does not have; YAML may
    plain = (c if " " <= c <= "~" and c not in '"\\' else f"\\U{ord(c):08x}" for c in value)
    return f'"{"".join(plain)}"'


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


BRIDGE = ("plugins", "ros2dds")
_NOT_RUST = re.compile(r"\(\?(?:=|!|<=|<!|P=)|\\[1-9]")


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
    """
    document = read_json5(content, file)
    findings = list(_check(document, document.value, policy))
    order = list(Severity)
    return tuple(sorted(findings, key=lambda finding: order.index(finding.severity)))


def _check(document: Document, config: Any, policy: Policy | None) -> Iterator[Finding]:
    if not isinstance(config, dict):
        yield fault(document, (), "the file is not a mapping", why="the bridge does not start")
        return
    if "mode" in config:
        yield from _MODE(document, ("mode",), config["mode"])
    plugins = config.get("plugins")
    bridge = plugins.get("ros2dds") if isinstance(plugins, dict) else None
    if bridge is not None:
        yield from _check_bridge(document, bridge, policy)
    if "access_control" in config:
        yield from check_access_control(document, config["access_control"], policy)
    elif bridge is None:
        yield fault(
            document,
            (),
            "neither plugins.ros2dds nor access_control is there",
            why="nothing here decides what crosses",
            code="nothing-filtered",
        )


def _check_bridge(document: Document, bridge: Any, policy: Policy | None) -> Iterator[Finding]:
    found = list(_BRIDGE(document, BRIDGE, bridge))
    if not any(finding.severity is Severity.ERROR for finding in found):
        for check in BRIDGE_MEANINGS:
            found += check(document, bridge)
        found += check_bridge_policy(document, bridge, policy) if policy else ()
    yield from found


def _regex(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
    """Check one regular expression of a list; Rust's know neither look-around nor back references."""
    if not isinstance(value, str):
        yield fault(document, path, f"given {value!r}, allowed: a regular expression", why="it is refused")
        return
    try:
        re.compile(value)
    except re.error as error:
        yield fault(document, path, f"{value!r} is no regular expression: {error}", why="it is refused")
        return
    if _NOT_RUST.search(value):
        yield fault(
            document,
            path,
            f"{value!r} uses look-around or a back reference",
            why="the bridge's regular expressions (Rust) have neither: it does not start",
        )
    if _bare_alternative(value):
        yield fault(
            document,
            path,
            f"{value!r} has an alternative that is not in brackets",
            why="the bridge anchors the whole, ^a|b$: each part then matches any name that begins or ends so",
            remedy="make two entries of it, or write (?:a|b)",
            code="loose-regex",
        )


def _bare_alternative(regex: str) -> bool:
    """Return whether a ``|`` stands outside of all brackets."""
    bare = re.sub(r"\\.|\[(?:\\.|[^\]])*\]", "", regex)
    depth = 0
    for character in bare:
        depth += {"(": 1, ")": -1}.get(character, 0)
        if character == "|" and depth == 0:
            return True
    return False


def _regexes(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
    if isinstance(value, str):
        yield from _regex(document, path, value)
    else:
        yield from listing(_regex)(document, path, value)


def _assignment(form: str, meaning: str) -> Any:
    """Return a check for texts of the form ``<regex>=<value>``."""
    pattern = re.compile(rf"(?P<regex>.+?)=(?:{form})", re.DOTALL)

    def check(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
        found = pattern.fullmatch(value) if isinstance(value, str) else None
        if found is None:
            yield fault(document, path, f"given {value!r}, allowed: <regex>={meaning}", why="it is refused")
        elif not found["regex"].startswith("^") or not found["regex"].endswith("$"):
            yield _unanchored(document, path, found["regex"])

    return check


def _unanchored(document: Document, path: KeyPath, regex: str) -> Finding:
    hit = "/tf also finds /tf_static" if regex == "/tf" else "/a also finds /a_b and /x/a"
    return fault(
        document,
        path,
        f"{regex!r} is searched for anywhere in a name",
        why=f"unlike allow and deny, this list is not anchored: {hit}",
        remedy=f"write ^{regex.removeprefix('^').removesuffix('$')}$",
        code="loose-regex",
        severity=Severity.WARNING,
    )


def _seconds(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
    if isinstance(value, list):
        yield from listing(_assignment(r"[0-9.]+", "<seconds>"))(document, path, value)
    else:
        yield from number()(document, path, value)


_MODE = text("router", "peer", "client")
_LISTS = mapping(dict.fromkeys(KINDS, _regexes))
_BRIDGE = mapping(
    {
        "namespace": text(),
        "nodename": text(),
        "domain": whole(0, MAX_DOMAIN),
        "ros_localhost_only": flag,
        "shm_enabled": flag,
        "allow": _LISTS,
        "deny": _LISTS,
        "pub_max_frequencies": listing(_assignment(r"[0-9.]+", "<hertz>")),
        "pub_priorities": listing(_assignment(r"[1-7](?::express)?", "<1 to 7>[:express]")),
        "reliable_routes_blocking": flag,
        "transient_local_cache_multiplier": whole(1),
        "queries_timeout": mapping(
            {
                "default": number(above=True),
                "transient_local_subscribers": _seconds,
                "services": _seconds,
                "actions": mapping(dict.fromkeys(("send_goal", "cancel_goal", "get_result"), _seconds)),
            }
        ),
        "work_thread_num": whole(1),
        "max_block_thread_num": whole(1),
        "__required__": flag,
        "__path__": anything,
    }
)
"""The shape of ``plugins.ros2dds``; it refuses keys that it does not know."""
