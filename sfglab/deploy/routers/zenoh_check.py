"""What is wrong with a Zenoh bridge's configuration or access control, and whether it is the policy.

Knows the keys that `zenoh-bridge-ros2dds` and Zenoh's access control take (see `zenoh`); of Zenoh's other
sections only that there are some, because they do not decide what crosses.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from sfglab.deploy.routers.json5 import read_json5
from sfglab.deploy.routers.shapes import anything, fault, flag, listing, mapping, number, text, whole
from sfglab.deploy.routers.zenoh import KINDS
from sfglab.deploy.routers.zenoh_acl_check import check_access_control
from sfglab.deploy.routers.zenoh_meaning import BRIDGE_MEANINGS, check_bridge_policy
from sfglab.fleet.border import Finding, Severity
from sfglab.fleet.fleet_file import MAX_DOMAIN

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.documents import Document, KeyPath
    from sfglab.fleet.routing import Policy


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
