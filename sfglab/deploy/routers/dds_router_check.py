"""What is wrong with a DDS Router's configuration: its schema, what its reader asks beyond, and what it means.

Schema and reader: eProsima DDS Router, configuration v5.0 (schema of August 2026, commit 7958efa5); DDS-Pipe's
readers. Whoever loads a file with a released version (3.5 and older) is told less: unknown keys pass silently.
"""

from __future__ import annotations

import ipaddress
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

from sfglab.deploy.routers.dds_router import VERSION, accepts
from sfglab.deploy.routers.shapes import (
    Check,
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
from sfglab.documents import Document
from sfglab.fleet.border import Finding, Severity
from sfglab.fleet.fleet_file import MAX_DOMAIN
from sfglab.fleet.routing import Direction
from sfglab.names import TF_STATIC, dds_topic

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sfglab.documents import KeyPath
    from sfglab.fleet.routing import Policy


Config = dict[str, Any]

DEFAULT_HISTORY = 5000
DEEP_HISTORY = 1000
"""From here on, histories of images are measured in gigabytes."""

IMAGE = dds_topic("/global/a/camera/color/image_raw")
"""A topic whose messages are large, to ask whether such topics are routed."""


def _old_version(document: Document, config: Config) -> Iterator[Finding]:
    if "version" not in config or config["version"] == "v4.0":
        given = config.get("version", "no version")
        yield fault(
            document,
            ("version",),
            f"{given} is given",
            why="v5.0 is taken, with a warning" if "version" not in config else "v4.0 is deprecated",
            remedy=f"version: {VERSION}",
            code="version",
            severity=Severity.WARNING,
        )


def _open(document: Document, config: Config) -> Iterator[Finding]:
    if not config.get("allowlist"):
        yield fault(
            document,
            ("allowlist",),
            "the allowlist is empty" if "allowlist" in config else "there is no allowlist",
            why="a DDS Router takes that for 'everything': every topic of every agent crosses",
            remedy="list what may cross; to forward nothing, run no router",
            code="open-router",
        )
    for position, item in enumerate(config.get("allowlist") or ()):
        if not item["name"].strip("*"):
            yield fault(
                document,
                ("allowlist", position),
                f"allowlist has {item['name']!r}, which is everything",
                why="every topic of every agent crosses",
                remedy="list what may cross",
                code="open-router",
            )


def _participants(document: Document, config: Config) -> Iterator[Finding]:
    names: set[str] = set()
    domains: dict[int, str] = {}
    for position, item in enumerate(config["participants"]):
        path = ("participants", position)
        if item["name"] in names:
            yield fault(
                document,
                path,
                f"two participants are called {item['name']!r}",
                why="the schema lets it pass (uniqueKeys is not of draft-07), the router does not start",
                remedy="give each its own name",
                code="duplicate-participant",
            )
        names.add(item["name"])
        if item["kind"] in {"local", "simple"}:
            yield from _simple(document, path, item, domains)


def _simple(
    document: Document, path: tuple[str | int, ...], item: Config, domains: dict[int, str]
) -> Iterator[Finding]:
    if "domain" not in item:
        yield fault(
            document,
            path,
            f"participant {item['name']!r} has no domain",
            why="domain 0 is taken",
            remedy="say which domain it joins",
            code="no-domain",
            severity=Severity.WARNING,
        )
    domain = item.get("domain", 0)
    if domain in domains:
        yield fault(
            document,
            path,
            f"participants {domains[domain]!r} and {item['name']!r} are both in domain {domain}",
            why="where they reach each other, every message goes round for ever",
            remedy="give them different domains",
            code="loop",
        )
    domains.setdefault(domain, item["name"])
    if "ros2-easy-mode" in item and item.get("transport", "builtin") != "builtin":
        yield fault(
            document,
            (*path, "ros2-easy-mode"),
            f"ros2-easy-mode with transport {item['transport']}",
            why="it is for the built-in transports only",
            remedy="transport: builtin",
            code="easy-mode",
        )


def _count(document: Document, config: Config) -> Iterator[Finding]:
    sides = [item for item in config["participants"] if item["kind"] != "echo"]
    if len(sides) < 2 and not any(item.get("repeater") for item in sides):
        yield fault(
            document,
            ("participants",),
            f"{len(sides)} participant beside echoes",
            why="there is nothing to route between",
            remedy="name both domains",
            code="one-sided",
            severity=Severity.WARNING,
        )


def _routes(document: Document, config: Config) -> Iterator[Finding]:
    yield from _route_list(document, config, ("routes",), config.get("routes") or ())
    for position, item in enumerate(config.get("topic-routes") or ()):
        yield from _route_list(document, config, ("topic-routes", position, "routes"), item["routes"])


def _route_list(
    document: Document, config: Config, path: tuple[str | int, ...], routes: Any
) -> Iterator[Finding]:
    participants = {item["name"]: item for item in config["participants"]}
    sources = [route["src"] for route in routes]
    for position, route in enumerate(routes):
        here = (*path, position)
        unknown = [name for name in (route["src"], *route.get("dst", ())) if name not in participants]
        if unknown:
            yield fault(
                document,
                here,
                f"route of {', '.join(map(repr, unknown))}, which is no participant",
                why="the configuration is refused",
                remedy=f"participants are {', '.join(participants)}",
                code="route",
            )
        elif sources.index(route["src"]) != position:
            yield fault(document, here, f"a second route of {route['src']!r}", why="one is lost", code="route")
        elif participants[route["src"]].get("repeater") and route["src"] not in route.get("dst", ()):
            yield fault(
                document,
                here,
                f"repeater {route['src']!r} has a route that does not lead to itself",
                why="a repeater sends back what it receives, which the route then forbids",
                remedy="add it to its own dst",
                code="route",
            )


def _services(document: Document, config: Config) -> Iterator[Finding]:
    other = {"rq/": "rr/", "rr/": "rq/"}
    names = [item["name"] for item in config.get("allowlist") or ()]
    for position, name in enumerate(names):
        mirror = other.get(name[:3], "") + name[3:].replace("Request", "\0").replace("Reply", "Request")
        mirror = mirror.replace("\0", "Reply")
        if name[:3] in other and not any(fnmatchcase(mirror, pattern) for pattern in names):
            yield fault(
                document,
                ("allowlist", position),
                f"{name} is allowed, its other half {mirror} is not",
                why="services are forwarded only where requests and replies are both allowed",
                remedy=f"add {mirror}",
                code="half-open",
            )


def _static_transforms(document: Document, config: Config) -> Iterator[Finding]:
    if config.get("specs", {}).get("remove-unused-entities") and accepts(config, dds_topic(TF_STATIC)):
        yield fault(
            document,
            ("specs", "remove-unused-entities"),
            "remove-unused-entities: true, and rt/tf_static crosses",
            why="both do not go together: late joiners never receive the static transforms",
            remedy="remove-unused-entities: false",
            code="static-lost",
        )


def _history(document: Document, config: Config) -> Iterator[Finding]:
    depth = config.get("specs", {}).get("qos", {}).get("history-depth", DEFAULT_HISTORY)
    own = [t for t in config.get("topics") or () if fnmatchcase(IMAGE, t["name"])]
    bounded = any("history-depth" in topic.get("qos", {}) for topic in own)
    if depth >= DEEP_HISTORY and accepts(config, IMAGE) and not bounded:
        yield fault(
            document,
            ("specs", "qos", "history-depth"),
            f"a history of {depth} messages for topics such as {IMAGE}",
            why=f"{depth} pictures of 640 x 360 are {depth * 640 * 360 * 3 / 1e9:.1f} GB a topic",
            remedy="give topics with large messages a history-depth of their own, under topics",
            code="history",
            severity=Severity.INFO,
        )


def _builtin(document: Document, config: Config) -> Iterator[Finding]:
    for position, item in enumerate(config.get("builtin-topics") or ()):
        if set("*?[") & set(item["name"] + item["type"]):
            yield fault(
                document,
                ("builtin-topics", position),
                f"builtin-topics has the wildcard {item['name']!r}",
                why="built-in topics are made at once, by their full name and type",
                remedy="write name and type in full",
                code="wildcard",
            )


def check_policy(document: Document, config: Config, policy: Policy) -> Iterator[Finding]:
    """Find topics that cross although the policy keeps them, or the other way round.

    Asks with names made from both sides' patterns and their neighbours, so that every difference of patterns
    that end in one ``*`` is found.
    """
    allowed = [item["name"] for item in config.get("allowlist") or ()]
    narrowed = [item for item in config.get("allowlist") or () if {"type", "filter"} & set(item)]
    names = probe_names([*allowed, *(rule.pattern for rule in policy.rules)])
    wrong = {
        name: crosses for name in names if accepts(config, name) is not (crosses := _crosses(policy, name))
    }
    for should in (False, True):
        found = [name for name, crosses in wrong.items() if crosses is should]
        if found:
            yield _not_the_policy(document, found, should=should)
    if narrowed:
        yield fault(
            document,
            ("allowlist",),
            f"{len(narrowed)} entries also ask for a type or content",
            why="less may cross than the policy says; names alone do not tell",
            code="policy",
            severity=Severity.WARNING,
        )


def _crosses(policy: Policy, name: str) -> bool:
    return any(policy.crosses(name, way) for way in Direction)


def _not_the_policy(document: Document, names: list[str], *, should: bool) -> Finding:
    does, meant = ("stays", "lets it cross") if should else ("crosses", "keeps it")
    others = f", and {len(names) - 1} more like it" if len(names) > 1 else ""
    return fault(
        document,
        ("allowlist",),
        f"{names[0]} {does}, and the policy {meant}{others}",
        why="the router does not do what the fleet file says",
        remedy="generate the file from the fleet file",
        code="policy",
    )


MEANINGS: tuple[Callable[[Document, Config], Iterator[Finding]], ...] = (
    _old_version,
    _open,
    _participants,
    _count,
    _routes,
    _services,
    _static_transforms,
    _history,
    _builtin,
)
"""Every check of a configuration that has the right shape."""


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


def _known_version(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
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
        "version": _known_version,
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
