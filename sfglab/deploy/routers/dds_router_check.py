"""What is wrong with a DDS Router's configuration: its schema, what its reader asks beyond, and what it means.

Schema and reader: eProsima DDS Router, configuration v5.0 (schema of August 2026, commit 7958efa5); DDS-Pipe's
readers. Whoever loads a file with a released version (3.5 and older) is told less: unknown keys pass silently.
"""

from __future__ import annotations

import ipaddress
from typing import TYPE_CHECKING, Any

from sfglab.deploy.routers.dds_router import VERSION
from sfglab.deploy.routers.dds_router_meaning import MEANINGS, check_policy
from sfglab.deploy.routers.shapes import Check, anything, fault, flag, listing, mapping, number, text, whole
from sfglab.documents import Document
from sfglab.fleet.border import Finding, Severity
from sfglab.fleet.fleet_file import MAX_DOMAIN

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.documents import KeyPath
    from sfglab.fleet.routing import Policy


VERSIONS = ("v1.0", "v2.0", "v3.0", "v3.1", "v4.0", VERSION)


def check_dds_router(
    text: str, *, file: str = "ddsrouter.yaml", policy: Policy | None = None
) -> tuple[Finding, ...]:
    """Return what is wrong with a DDS Router's configuration, the worst first.

    Args:
        text: The YAML file's text.
        file: Its name, for the findings' places.
        policy: What should cross; None does not ask.

    Raises:
        DocumentError: It is not YAML.
    """
    document = Document(text, file)
    config: Any = document.value
    findings = list(ROOT(document, (), config))
    if not findings:  # what a file means is asked once it can be loaded
        for check in MEANINGS:
            findings += check(document, config)
        findings += check_policy(document, config, policy) if policy else ()
    order = list(Severity)
    return tuple(sorted(findings, key=lambda finding: order.index(finding.severity)))


def _version(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
    yield from text(*VERSIONS)(document, path, value)
    if value in VERSIONS and value not in {VERSION, "v4.0"}:
        yield fault(
            document,
            path,
            f"configuration {value} is in the schema, but the reader refuses it",
            why="it knows v5.0, and v4.0 with a warning; the router's own version (3.x) is another number",
            remedy=f"version: {VERSION}",
            code="version",
        )


def _ip(document: Document, path: KeyPath, value: Any, *, version: int | None = None) -> Iterator[Finding]:
    try:
        found = ipaddress.ip_address(value if isinstance(value, str) else "")
    except ValueError:
        found = None
    if found is None or (version is not None and found.version != version):
        yield fault(
            document,
            path,
            f"given {value!r}, allowed: an {'IP' if version is None else f'IPv{version}'} address",
            why="names of interfaces and hosts do not stand here; a whitelist passes over what is no address",
            remedy="write the address; for a host name there is the key domain",
            code="address",
        )


def _ipv4(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
    return _ip(document, path, value, version=4)


def _address(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
    yield from _ADDRESS(document, path, value)
    if isinstance(value, dict) and "ip" in value:
        version = {"v4": 4, "v6": 6}.get(value.get("ip-version", ""))
        yield from _ip(document, (*path, "ip"), value["ip"], version=version)


def _tls(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
    yield from _TLS(document, path, value)
    trio = ("password", "private_key", "cert")
    given = [key for key in trio if isinstance(value, dict) and key in value]
    if 0 < len(given) < len(trio):
        yield fault(
            document,
            path,
            f"tls has {', '.join(given)} without {', '.join(k for k in trio if k not in given)}",
            why="a server's password, private_key and cert belong together",
            remedy="give all three, or none",
            code="tls",
        )
    for key in ("private_key", "cert"):
        if isinstance(value, dict) and isinstance(value.get(key), str) and not value[key].strip():
            yield fault(document, (*path, key), f"tls: {key} is empty", why="it names a file", code="tls")


_WAN = ("wan", "router", "initial-peers")
_SERVERS = (
    "discovery-server",
    "ds",
    "local-ds",
    "local-discovery-server",
    "wan-ds",
    "wan-discovery-server",
)
_TRANSPORT_KEYS = ("whitelist-interfaces", "ros2-easy-mode", "transport", "ignore-participant-flags", "qos")
_ADDRESS_KEYS = ("listening-addresses", "connection-addresses", "tls")
KIND_KEYS: dict[str, tuple[str, ...]] = {
    "echo": ("discovery", "data", "verbose"),
    **dict.fromkeys(("local", "simple"), ("domain", *_TRANSPORT_KEYS)),
    **dict.fromkeys(_WAN, ("domain", "repeater", *_ADDRESS_KEYS, *_TRANSPORT_KEYS)),
    **dict.fromkeys(_SERVERS, ("discovery-server-guid", *_ADDRESS_KEYS, *_TRANSPORT_KEYS)),
    **dict.fromkeys(("xml", "XML"), ("profile", "repeater")),
}
"""What a participant of each kind may have beside name and kind."""


def _participant(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
    yield from _PARTICIPANT(document, path, value)
    kind = value.get("kind") if isinstance(value, dict) else None
    if not isinstance(kind, str) or kind not in KIND_KEYS:
        return
    for key in value:
        if key in _PARTICIPANT_KEYS and key not in {"name", "kind", *KIND_KEYS[kind]}:
            yield fault(
                document,
                (*path, key),
                f"a participant of kind {kind} has no {key}",
                why="the configuration is refused when it is loaded",
                remedy=f"allowed for it: {', '.join(KIND_KEYS[kind])}",
                code="kind-key",
            )
    needs_address = kind in _WAN or kind in _SERVERS
    if needs_address and not {"listening-addresses", "connection-addresses"} & set(value):
        yield fault(
            document,
            path,
            f"a participant of kind {kind} needs listening-addresses or connection-addresses",
            why="it would find nobody, and the configuration is refused",
            code="missing-key",
        )
    if kind in {"xml", "XML"} and "profile" not in value:
        yield fault(document, path, "a participant of kind xml needs profile", why="it is made from one")


_DOMAIN = whole(0, MAX_DOMAIN)
_QOS = mapping(
    {
        **dict.fromkeys(("reliability", "durability", "ownership", "partitions", "keyed"), flag),
        "history-depth": whole(0),
        "max-tx-rate": number(),
        "max-rx-rate": number(),
        "downsampling": whole(1),
        "endpoint-profile-name": text(),
    }
)
_PRODUCER = mapping(
    {"enable": flag, "domain": _DOMAIN, "period": number(above=True), "topic-name": text()}, needed=("enable",)
)
_SPECS = mapping(
    {
        "threads": whole(0),
        "remove-unused-entities": flag,
        "qos": _QOS,
        "discovery-trigger": text("reader", "writer", "any", "none", ignore_case=True),
        "logging": mapping(
            {
                "publish": mapping(
                    {"enable": flag, "domain": _DOMAIN, "topic-name": text()}, needed=("enable",)
                ),
                "stdout": flag,
                "verbosity": text("info", "warning", "error"),
                "filter": mapping(dict.fromkeys(("info", "warning", "error"), text())),
            }
        ),
        "monitor": mapping({"domain": _DOMAIN, "status": _PRODUCER, "topics": _PRODUCER}),
    }
)
_FILTER = mapping({"name": text(), "type": text(), "qos": _QOS, "filter": text()}, needed=("name",))
_BUILTIN = mapping({"name": text(), "type": text()}, needed=("name", "type"))
_TOPIC = mapping(
    {"name": text(), "type": text(), "qos": _QOS, "filter": text(), "participants": listing(text())},
    needed=("name",),
)
_ROUTE = mapping({"src": text(), "dst": listing(text())}, needed=("src",))
# The schema leaves routes out of what a topic's route needs; the reader asks for them.
_TOPIC_ROUTE = mapping(
    {"name": text(), "type": text(), "routes": listing(_ROUTE)}, needed=("name", "type", "routes")
)
_ADDRESS = mapping(
    {
        "ip": anything,
        "domain": text(),
        "port": whole(0, 65535),
        "external-port": whole(0, 65535),
        "transport": text("tcp", "udp"),
        "ip-version": text("v4", "v6"),
    },
    needed=("port",),
    one_of=("ip", "domain"),
)
_TLS = mapping(
    {
        **dict.fromkeys(("ca", "password", "private_key", "cert", "dh_params", "sni_host"), text()),
        "peer_verification": flag,
    },
    needed=("ca",),
)
_PARTICIPANT_KEYS: dict[str, Check] = {
    "name": text(),
    "kind": text(*KIND_KEYS),
    "domain": _DOMAIN,
    "repeater": flag,
    "discovery-server-guid": mapping(
        {"guid": text(), "id": whole(0), "ros-discovery-server": flag}, one_of=("guid", "id")
    ),
    "listening-addresses": listing(_address, least=1),
    "connection-addresses": listing(_address, least=1),
    "tls": _tls,
    **dict.fromkeys(("discovery", "data", "verbose"), flag),
    "whitelist-interfaces": listing(_ip),
    "ros2-easy-mode": _ipv4,
    "transport": text("builtin", "udp", "shm"),
    "ignore-participant-flags": text(
        "no_filter",
        "filter_different_host",
        "filter_different_process",
        "filter_same_process",
        "filter_different_and_same_process",
    ),
    "qos": _QOS,
    "profile": text(),
}
_PARTICIPANT = mapping(_PARTICIPANT_KEYS, needed=("name", "kind"))
ROOT = mapping(
    {
        "version": _version,
        "specs": _SPECS,
        "allowlist": listing(_FILTER),
        "blocklist": listing(_FILTER),
        "builtin-topics": listing(_BUILTIN),
        "topics": listing(_TOPIC),
        "routes": listing(_ROUTE),
        "topic-routes": listing(_TOPIC_ROUTE),
        "participants": listing(_participant, least=1),
        "xml": mapping({"raw": text(), "files": listing(text(), least=1)}, one_of=("raw", "files")),
    },
    needed=("participants",),
)
"""The shape of a whole configuration."""
