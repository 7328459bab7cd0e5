"""Faults of a DDS Router's configuration: its shape, and what it opens, loops, halves and loses.

Shape and reader: eProsima DDS Router, configuration v5.0 (see ``schemas/dds-router.yaml``). A released
version (3.5 and older) tells less: unknown keys pass silently.
"""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

from sfglab.deploy.routers.dds_router import VERSION, accepts, probe_names
from sfglab.deploy.shapes import check_shape
from sfglab.deploy.verdicts import Broken, Rules, worst_first
from sfglab.documents import Document
from sfglab.fleet.lint import Finding, Severity
from sfglab.fleet.policy import Direction, Policy
from sfglab.names import TF_STATIC, dds_topic

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.errors import KeyPath

Config = dict[str, Any]

DEFAULT_HISTORY = 5000
DEEP_HISTORY = 1000  #: From here on, histories of images are measured in gigabytes.

IMAGE = dds_topic("/global/a/camera/color/image_raw")  #: A topic with large messages.


RULES: Rules[Config, KeyPath] = Rules()  #: What a configuration may mean that has the right shape.

#: Whether it is the policy, by names around both.
POLICY: Rules[tuple[Config, Policy], KeyPath] = Rules()


def check_dds_router(
    text: str, *, file: str = "ddsrouter.yaml", policy: Policy | None = None
) -> tuple[Finding, ...]:
    """Return what is wrong with a DDS Router's configuration in YAML, the worst first.

    The file's name is for places. The policy says what should cross; None does not ask.

    Raises:
        DocumentError: It is not YAML.
        MissingProgramError: The library that reads JSON Schema is not installed.
    """
    document = Document(text, file)
    config: Any = document.value
    findings = check_shape(document, "dds-router")
    if not findings:  # what a file means is asked once it can be loaded
        findings = (*RULES.broken(config, document.place),)
        findings += (*POLICY.broken((config, policy), document.place),) if policy else ()
    return worst_first(findings)


@RULES.add(
    "version", "v5.0 is taken, with a warning", f"version: {VERSION}", severity=Severity.WARNING
)
def _no_version(config: Config) -> Iterator[Broken[KeyPath]]:
    if "version" not in config:
        yield Broken(("version",), "no version is given")


@RULES.add("version", "v4.0 is deprecated", f"version: {VERSION}", severity=Severity.WARNING)
def _old_version(config: Config) -> Iterator[Broken[KeyPath]]:
    if config.get("version") == "v4.0":
        yield Broken(("version",), "v4.0 is given")


@RULES.add(
    "open-router",
    "a DDS Router takes that for 'everything': every topic of every agent crosses",
    "list what may cross; to forward nothing, run no router",
)
def _no_allowlist(config: Config) -> Iterator[Broken[KeyPath]]:
    if not config.get("allowlist"):
        what = "the allowlist is empty" if "allowlist" in config else "there is no allowlist"
        yield Broken(("allowlist",), what)


@RULES.add("open-router", "every topic of every agent crosses", "list what may cross")
def _wildcard_alone(config: Config) -> Iterator[Broken[KeyPath]]:
    for position, name in enumerate(_names(config)):
        if not name.strip("*"):
            yield Broken(("allowlist", position), f"allowlist has {name!r}, which is everything")


def _names(config: Config) -> list[str]:
    return [item["name"] for item in config.get("allowlist") or ()]


@RULES.add(
    "duplicate-participant",
    "the schema lets it pass (uniqueKeys is not of draft-07), the router does not start",
    "give each its own name",
)
def _same_name(config: Config) -> Iterator[Broken[KeyPath]]:
    names = [item["name"] for item in config["participants"]]
    for position, name in enumerate(names):
        if name in names[:position]:
            yield Broken(("participants", position), f"two participants are called {name!r}")


def _simple(config: Config) -> Iterator[tuple[KeyPath, Config]]:
    """Yield the participants that join a domain by its number."""
    for position, item in enumerate(config["participants"]):
        if item["kind"] in {"local", "simple"}:
            yield ("participants", position), item


@RULES.add("no-domain", "domain 0 is taken", "say which domain it joins", severity=Severity.WARNING)
def _no_domain(config: Config) -> Iterator[Broken[KeyPath]]:
    for path, item in _simple(config):
        if "domain" not in item:
            yield Broken(path, f"participant {item['name']!r} has no domain")


@RULES.add(
    "loop",
    "where they reach each other, every message goes round for ever",
    "give them different domains",
)
def _same_domain(config: Config) -> Iterator[Broken[KeyPath]]:
    first: dict[int, str] = {}
    for path, item in _simple(config):
        domain, name = item.get("domain", 0), item["name"]
        if domain in first:
            yield Broken(
                path, f"participants {first[domain]!r} and {name!r} are both in domain {domain}"
            )
        first.setdefault(domain, name)


@RULES.add("easy-mode", "it is for the built-in transports only", "transport: builtin")
def _easy_mode(config: Config) -> Iterator[Broken[KeyPath]]:
    for path, item in _simple(config):
        if "ros2-easy-mode" in item and item.get("transport", "builtin") != "builtin":
            yield Broken(
                (*path, "ros2-easy-mode"), f"ros2-easy-mode with transport {item['transport']}"
            )


@RULES.add(
    "one-sided", "there is nothing to route between", "name both domains", severity=Severity.WARNING
)
def _one_side(config: Config) -> Iterator[Broken[KeyPath]]:
    sides = [item for item in config["participants"] if item["kind"] != "echo"]
    if len(sides) < 2 and not any(item.get("repeater") for item in sides):
        yield Broken(("participants",), f"{len(sides)} participant beside echoes")


def _routes(config: Config) -> Iterator[tuple[KeyPath, Config, list[str]]]:
    """Yield each route with its place and the sources of those before it."""
    topics = enumerate(config.get("topic-routes") or ())
    lists = [(("topic-routes", position, "routes"), item["routes"]) for position, item in topics]
    for path, routes in ((("routes",), config.get("routes") or []), *lists):
        for position, route in enumerate(routes):
            yield (*path, position), route, [earlier["src"] for earlier in routes[:position]]


@RULES.add("route", "the configuration is refused")
def _unknown_route(config: Config) -> Iterator[Broken[KeyPath]]:
    known = [item["name"] for item in config["participants"]]
    for path, route, _ in _routes(config):
        unknown = [
            repr(name) for name in (route["src"], *route.get("dst", ())) if name not in known
        ]
        if unknown:
            what = f"route of {', '.join(unknown)}, which is no participant"
            yield Broken(path, what, f"participants are {', '.join(known)}")


@RULES.add("route", "one is lost")
def _second_route(config: Config) -> Iterator[Broken[KeyPath]]:
    for path, route, earlier in _routes(config):
        if route["src"] in earlier:
            yield Broken(path, f"a second route of {route['src']!r}")


@RULES.add(
    "route",
    "a repeater sends back what it receives, which the route then forbids",
    "add it to its own dst",
)
def _repeater_route(config: Config) -> Iterator[Broken[KeyPath]]:
    repeaters = {item["name"] for item in config["participants"] if item.get("repeater")}
    for path, route, _ in _routes(config):
        if route["src"] in repeaters and route["src"] not in route.get("dst", ()):
            yield Broken(
                path, f"repeater {route['src']!r} has a route that does not lead to itself"
            )


@RULES.add("half-open", "services are forwarded only where requests and replies are both allowed")
def _half_services(config: Config) -> Iterator[Broken[KeyPath]]:
    other = {"rq/": "rr/", "rr/": "rq/"}
    names = _names(config)
    for position, name in enumerate(names):
        mirror = other.get(name[:3], "") + name[3:].replace("Request", "\0").replace(
            "Reply", "Request"
        )
        mirror = mirror.replace("\0", "Reply")
        if name[:3] in other and not any(fnmatchcase(mirror, pattern) for pattern in names):
            what = f"{name} is allowed, its other half {mirror} is not"
            yield Broken(("allowlist", position), what, f"add {mirror}")


@RULES.add(
    "static-lost",
    "both do not go together: late joiners never receive the static transforms",
    "remove-unused-entities: false",
)
def _static_transforms(config: Config) -> Iterator[Broken[KeyPath]]:
    if config.get("specs", {}).get("remove-unused-entities") and accepts(
        config, dds_topic(TF_STATIC)
    ):
        path = ("specs", "remove-unused-entities")
        yield Broken(path, "remove-unused-entities: true, and rt/tf_static crosses")


@RULES.add(
    "history",
    "the router keeps them all, for late joiners",
    "give topics with large messages a history-depth of their own, under topics",
    severity=Severity.INFO,
)
def _history(config: Config) -> Iterator[Broken[KeyPath]]:
    depth = config.get("specs", {}).get("qos", {}).get("history-depth", DEFAULT_HISTORY)
    own = [t for t in config.get("topics") or () if fnmatchcase(IMAGE, t["name"])]
    bounded = any("history-depth" in topic.get("qos", {}) for topic in own)
    if depth >= DEEP_HISTORY and accepts(config, IMAGE) and not bounded:
        size = f"{depth} pictures of 640 x 360 are {depth * 640 * 360 * 3 / 1e9:.1f} GB a topic"
        what = f"a history of {depth} messages for topics such as {IMAGE}: {size}"
        yield Broken(("specs", "qos", "history-depth"), what)


@RULES.add(
    "wildcard",
    "built-in topics are made at once, by their full name and type",
    "write name and type in full",
)
def _builtin(config: Config) -> Iterator[Broken[KeyPath]]:
    for position, item in enumerate(config.get("builtin-topics") or ()):
        if set("*?[") & set(item["name"] + item["type"]):
            yield Broken(
                ("builtin-topics", position), f"builtin-topics has the wildcard {item['name']!r}"
            )


@POLICY.add(
    "policy",
    "the router does not do what the fleet file says",
    "generate the file from the fleet file",
)
def _differences(asked: tuple[Config, Policy]) -> Iterator[Broken[KeyPath]]:
    config, policy = asked
    names = probe_names([*_names(config), *(rule.pattern for rule in policy.rules)])
    crosses = {name: any(policy.crosses(name, way) for way in Direction) for name in names}
    wrong = [name for name in names if accepts(config, name) is not crosses[name]]
    kinds = {False: "crosses, and the policy keeps it", True: "stays, and the policy lets it cross"}
    for should, words in kinds.items():
        found = [name for name in wrong if crosses[name] is should]
        if found:
            others = f", and {len(found) - 1} more like it" if len(found) > 1 else ""
            yield Broken(("allowlist",), f"{found[0]} {words}{others}")


@POLICY.add(
    "policy",
    "less may cross than the policy says; names alone do not tell",
    severity=Severity.WARNING,
)
def _narrowed(asked: tuple[Config, Policy]) -> Iterator[Broken[KeyPath]]:
    config, _ = asked
    narrowed = [item for item in config.get("allowlist") or () if {"type", "filter"} & set(item)]
    if narrowed:
        yield Broken(("allowlist",), f"{len(narrowed)} entries also ask for a type or content")
