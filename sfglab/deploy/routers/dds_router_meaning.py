"""What a DDS Router's configuration means although it can be loaded: what it opens, loops, halves and loses."""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

from sfglab.deploy.routers.dds_router import VERSION, accepts
from sfglab.deploy.routers.probes import probe_names
from sfglab.deploy.routers.shapes import fault
from sfglab.fleet.border import Finding, Severity
from sfglab.fleet.routing import Direction
from sfglab.names import TF_STATIC, dds_topic

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sfglab.documents import Document
    from sfglab.fleet.routing import Policy


Config = dict[str, Any]

DEFAULT_HISTORY = 5000
DEEP_HISTORY = 1000
"""From here on, histories of images are measured in gigabytes."""

IMAGE = dds_topic("/global/a/camera/color/image_raw")
"""A topic whose messages are large, to ask whether such topics are routed."""


def _version(document: Document, config: Config) -> Iterator[Finding]:
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
    _version,
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
