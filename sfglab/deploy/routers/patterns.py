r"""Forwarding rules as ROS names, for routers that do not filter DDS topics.

A rule speaks of DDS topics (``rq/global/*``), a Zenoh bridge of ROS services (``/global/.*``). A `NamePattern`
is what both can say: one ROS name, or all names with one beginning. Refuses rules that say anything else,
because a filter that is almost the policy is worse than none.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.deploy.routers.errors import RouterFileError
from sfglab.names import DdsRole

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sfglab.fleet.routing import Direction, ForwardRule, Policy


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


def topic_names(policy: Policy, way: Direction) -> tuple[NamePattern, ...]:
    """Return the topics whose messages cross one way.

    Raises:
        RouterFileError: A rule cannot be said in ROS names.
    """
    return _names(policy, DdsRole.TOPIC, way)


def service_names(policy: Policy, *, requests: Direction) -> tuple[NamePattern, ...]:
    """Return the services whose requests cross one way and whose replies cross the other.

    Args:
        policy: What crosses.
        requests: The way of the requests: outward for callers inside, inward for servers inside.

    Raises:
        RouterFileError: A rule cannot be said in ROS names.
    """
    replies = _other(requests)
    return both(_names(policy, DdsRole.REQUEST, requests), _names(policy, DdsRole.REPLY, replies))


def action_names(policy: Policy, *, goals: Direction) -> tuple[NamePattern, ...]:
    """Return the actions all of whose services and topics cross; feedback goes against the goals.

    An action that is called like the beginning itself, such as ``/global``, is left out although all of its
    parts lie below: the schema has no such name.

    Raises:
        RouterFileError: A rule cannot be said in ROS names.
    """
    services = service_names(policy, requests=goals)
    return tuple(p for p in both(services, topic_names(policy, _other(goals))) if p.open)


def both(first: Iterable[NamePattern], second: Iterable[NamePattern]) -> tuple[NamePattern, ...]:
    """Return patterns for the names that are in one of the first and in one of the second."""
    second = tuple(second)
    common = (_common(a, b) for a in first for b in second)
    return _smallest(pattern for pattern in common if pattern is not None)


def _common(a: NamePattern, b: NamePattern) -> NamePattern | None:
    longer, shorter = (a, b) if (len(a.start), not a.open) >= (len(b.start), not b.open) else (b, a)
    return longer if shorter.matches(longer.start) else None


def _other(way: Direction) -> Direction:
    return next(other for other in type(way) if other is not way)


def _names(policy: Policy, role: DdsRole, way: Direction) -> tuple[NamePattern, ...]:
    rules = [rule for rule in policy.rules if way in rule.directions]
    found = [_name_pattern(rule, role) for rule in rules]
    return _smallest(pattern for pattern in found if pattern is not None)


def _name_pattern(rule: ForwardRule, role: DdsRole) -> NamePattern | None:
    """Return the ROS names of a rule that is about this role, else None."""
    found = _SIMPLE.fullmatch(rule.pattern)
    if found is None:
        raise RouterFileError(
            f"rule {rule.pattern!r}: a Zenoh bridge filters ROS names, so allowed are rt/, rq/ or rr/ and a "
            "name of letters, digits, underscores and slashes, with at most one '*', at its end"
        )
    prefix, start, star = found.groups()
    if "/_" in start:
        raise RouterFileError(f"rule {rule.pattern!r}: a Zenoh bridge routes actions whole, not their parts")
    if prefix != role.value:
        return None
    tail = _TAILS[role]
    if star and tail and any(start.endswith(tail[:n]) for n in range(1, len(tail) + 1)):
        raise RouterFileError(
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
    return tuple(p for p in every if not any(o != p and o.open and o.matches(p.start) for o in every))
