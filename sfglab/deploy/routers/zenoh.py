"""A Zenoh bridge's configuration and access control for one agent, from the policy that our own router obeys.

Formats: `zenoh-bridge-ros2dds` (DEFAULT_CONFIG.json5 and config.rs of zenoh-plugin-ros2dds, 2025) and Zenoh's
access control (version 1). With bridges the Zenoh network takes the place of domain 0: plain ROS 2 nodes there
hear nothing. A rule that cannot be said in ROS names is a `DeployError`.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.deploy.errors import DeployError
from sfglab.deploy.routers.dds_router import header
from sfglab.fleet.policy import Direction, ForwardRule, Policy
from sfglab.names import DdsRole

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from sfglab.fleet.fleet_file import Fleet


_SIMPLE = re.compile(r"(rt|rq|rr)(/[A-Za-z0-9_/]*)(\*?)")
_TAILS = {DdsRole.TOPIC: "", DdsRole.REQUEST: "Request", DdsRole.REPLY: "Reply"}


@dataclass(frozen=True, slots=True, order=True)
class NamePattern:
    """A set of absolute ROS names."""

    start: str  #: The whole name, or its beginning.
    open: bool  #: Whether anything may follow.

    def matches(self, name: str) -> bool:
        """Return whether a ROS name is in the set."""
        return name.startswith(self.start) if self.open else name == self.start

    @property
    def regex(self) -> str:
        """The set as a regular expression for a whole name; its characters need no escape."""
        return self.start + (".*" if self.open else "")

    @property
    def key_expression(self) -> str:
        """The set as a Zenoh key expression: the name without its first slash.

        ``**`` alone would stand for no segment as well, so that ``global/**`` has the topic ``/global``.
        """
        key = self.start[1:]
        if not self.open:
            return key
        return f"{key}*/**" if not key or key.endswith("/") else f"{key}$*/**"

    @property
    def announced_key(self) -> str:
        """The set as a Zenoh bridge writes it into one segment of its announcements: ``§`` for slashes."""
        return self.start[1:].replace("/", "§") + ("$*" if self.open else "")


def both(first: Iterable[NamePattern], second: Iterable[NamePattern]) -> tuple[NamePattern, ...]:
    """Return patterns for the names that are in one of the first and in one of the second."""
    second = tuple(second)
    common = (_common(a, b) for a in first for b in second)
    return _smallest(pattern for pattern in common if pattern is not None)


def _common(a: NamePattern, b: NamePattern) -> NamePattern | None:
    longer, shorter = (a, b) if (len(a.start), not a.open) >= (len(b.start), not b.open) else (b, a)
    return longer if shorter.matches(longer.start) else None


def _names(policy: Policy, role: DdsRole, way: Direction) -> tuple[NamePattern, ...]:
    rules = [rule for rule in policy.rules if way in rule.directions]
    found = [_name_pattern(rule, role) for rule in rules]
    return _smallest(pattern for pattern in found if pattern is not None)


def _name_pattern(rule: ForwardRule, role: DdsRole) -> NamePattern | None:
    """Return the ROS names of a rule that is about this role, else None."""
    found = _SIMPLE.fullmatch(rule.pattern)
    if found is None:
        raise DeployError(
            f"rule {rule.pattern!r}: a Zenoh bridge filters ROS names, so allowed are rt/, rq/ or rr/ and a "
            "name of letters, digits, underscores and slashes, with at most one '*', at its end"
        )
    prefix, start, star = found.groups()
    if "/_" in start:
        raise DeployError(
            f"rule {rule.pattern!r}: a Zenoh bridge routes actions whole, not their parts"
        )
    if prefix != role.value:
        return None
    tail = _TAILS[role]
    if star and tail and any(start.endswith(tail[:n]) for n in range(1, len(tail) + 1)):
        raise DeployError(
            f"rule {rule.pattern!r}: its beginning may be part of the {tail!r} that ends every such name; "
            "allowed are beginnings that end otherwise, best in a slash"
        )
    if star:
        return NamePattern(start=start, open=True)
    name = start.removesuffix(tail)
    return NamePattern(start=name, open=False) if start.endswith(tail) and len(name) > 1 else None


def _smallest(patterns: Iterable[NamePattern]) -> tuple[NamePattern, ...]:
    """Return patterns without those that others contain, in order."""
    every = sorted(set(patterns))
    return tuple(
        p for p in every if not any(o != p and o.open and o.matches(p.start) for o in every)
    )


KINDS = (
    "publishers",
    "subscribers",
    "service_servers",
    "service_clients",
    "action_servers",
    "action_clients",
)
"""What a bridge filters, each seen from inside the agent."""

_IN, _OUT = Direction.INWARD, Direction.OUTWARD
_EGRESS, _INGRESS = "egress", "ingress"
_WANTED = ["liveliness_query", "declare_liveliness_subscriber"]


def bridged_names(policy: Policy) -> dict[str, tuple[NamePattern, ...]]:
    """Return the ROS names that a bridge lets through, by what they are inside the agent (`KINDS`).

    A service needs requests that cross one way and replies that cross the other; an action all of its services
    and topics, feedback against the goals. An action that is called like the beginning itself, such as
    ``/global``, is left out although all of its parts lie below: the schema has no such name.
    """
    topics = {way: _names(policy, DdsRole.TOPIC, way) for way in (_OUT, _IN)}
    services = {
        way: both(_names(policy, DdsRole.REQUEST, way), _names(policy, DdsRole.REPLY, back))
        for way, back in ((_IN, _OUT), (_OUT, _IN))
    }
    actions = {
        way: tuple(p for p in both(services[way], topics[back]) if p.open)
        for way, back in ((_IN, _OUT), (_OUT, _IN))
    }
    found = (topics[_OUT], topics[_IN], services[_IN], services[_OUT], actions[_IN], actions[_OUT])
    return dict(zip(KINDS, found, strict=True))


def render_zenoh_bridge(fleet: Fleet, agent: str) -> str:
    """Return the JSON5 file for one agent's `zenoh-bridge-ros2dds`; the same fleet gives the same text.

    Names are not changed (namespace ``/``), because they already bear the agent's.

    Raises:
        InvalidValueError: The fleet has no such agent.
        DeployError: A rule cannot be said in ROS names.
    """
    spec = fleet.agent(agent)
    broadcasters = max(a.tf.static_broadcasters for a in fleet.agents)
    plugin: dict[str, Any] = {
        "namespace": "/",
        "domain": spec.domain,
        "allow": {
            kind: [p.regex for p in names] for kind, names in bridged_names(fleet.policy).items()
        },
        # Kept of one topic of one agent: what a late joiner needs of each of its static broadcasters.
        "transient_local_cache_multiplier": max(10, broadcasters),
    }
    if spec.local_interface == "lo":
        plugin["ros_localhost_only"] = True
    config: dict[str, Any] = {"mode": "peer", "plugins": {"ros2dds": plugin}}
    if spec.global_interface is not None:
        config["scouting"] = {"multicast": {"enabled": True, "interface": spec.global_interface}}
    notes = [
        "The Zenoh network takes the place of the global domain: plain ROS 2 nodes there hear nothing.",
        "Give every agent's bridge its own file: bridges before 1.1 obey the receiving side alone.",
    ]
    return _file([*header(fleet, agent, "Zenoh bridge"), *notes], config)


def render_zenoh_acl(fleet: Fleet, agent: str) -> str:
    """Return a JSON5 file with the access control of one agent's bridge, to stand beside its ``plugins``.

    It denies whatever the policy does not let cross, also where a bridge's own filter fails, and on other
    agents' behalf. Directions are those of this agent: outward is egress.

    Raises:
        InvalidValueError: The fleet has no such agent.
        DeployError: A rule cannot be said in ROS names.
    """
    fleet.agent(agent)
    rules = [rule for rule in _rules(bridged_names(fleet.policy)) if rule["key_exprs"]]
    control = {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": "everybody"}],
        "policies": [{"rules": [rule["id"] for rule in rules], "subjects": ["everybody"]}],
    }
    notes = ["Zenoh 1.0 or newer; it cannot be changed while the bridge runs."]
    return _file(
        [*header(fleet, agent, "Zenoh access control"), *notes], {"access_control": control}
    )


def _file(comments: Sequence[str], config: dict[str, Any]) -> str:
    return "".join(f"// {line}\n" for line in comments) + json.dumps(config, indent=2) + "\n"


def _rules(names: dict[str, tuple[NamePattern, ...]]) -> Iterator[dict[str, Any]]:
    for kind, data, wish in (("publishers", _EGRESS, _INGRESS), ("subscribers", _INGRESS, _EGRESS)):
        keys = _keys(names[kind])
        # What late joiners ask of an advanced publisher lies below @adv, which no wildcard stands for.
        history = [f"{key}/@adv/**" for key in keys]
        yield _rule(f"{kind}: messages", data, ["put", "delete", "reply"], keys)
        yield _rule(f"{kind}: wishes", wish, ["declare_subscriber"], keys)
        yield _rule(f"{kind}: history", data, ["declare_queryable", "liveliness_token"], history)
        yield _rule(f"{kind}: history wanted", wish, ["query", *_WANTED], history)
    for kind, calls, replies in (("server", _INGRESS, _EGRESS), ("client", _EGRESS, _INGRESS)):
        keys = _keys(names[f"service_{kind}s"])  # an action's parts are among them
        yield _rule(f"{kind}s: calls", calls, ["query"], keys)
        yield _rule(f"{kind}s: replies", replies, ["reply", "declare_queryable"], keys)
    # Bridges tell each other what they route by tokens with the name in one segment.
    tokens = ["@/*/@ros2_lv"]
    for letters, kind in zip(("MP", "MS", "SS", "SC", "AS", "AC"), KINDS, strict=True):
        tokens += [f"@/*/@ros2_lv/{letters}/{pattern.announced_key}/**" for pattern in names[kind]]
    yield _rule("announcements", None, ["liveliness_token"], list(dict.fromkeys(tokens)))
    yield _rule("announcements wanted", None, _WANTED, ["@/*/@ros2_lv/**"])


def _keys(patterns: Sequence[NamePattern]) -> list[str]:
    return [pattern.key_expression for pattern in patterns]


def _rule(name: str, flow: str | None, messages: list[str], keys: list[str]) -> dict[str, Any]:
    flows = [_EGRESS, _INGRESS] if flow is None else [flow]
    return {
        "id": name,
        "permission": "allow",
        "flows": flows,
        "messages": messages,
        "key_exprs": keys,
    }
