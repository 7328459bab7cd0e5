"""Rights of agents for DDS Security: who may publish and subscribe what (OMG DDS Security 1.1, 9.4).

An agent may publish in the global domain what the policy lets out, under its own name or as the fleet file
says; it may subscribe the topics that the policy lets in, and of services the halves that it serves or calls.
In its own domain it may everything, elsewhere nothing.
"""

from __future__ import annotations

from dataclasses import replace
from fnmatch import fnmatchcase
from itertools import product
from typing import TYPE_CHECKING

from sfglab.deploy.files import render
from sfglab.errors import InvalidValueError
from sfglab.fleet.lint import View
from sfglab.fleet.policy import Direction
from sfglab.fleet.status.heartbeat import metadata_service
from sfglab.names import ResourceKind, dds_names, dds_service

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from datetime import datetime

    from sfglab.fleet.fleet_file import Fleet

LAST_DOMAIN = 230  #: That these documents may name: Cyclone DDS reads none about a later one.
_OWNED = "rt/global/", "rq/global/", "rr/global/"  # and then the agent's name


def global_rights(fleet: Fleet, agent: str) -> dict[str, tuple[str, ...]]:
    """Return what an agent may publish and subscribe in the global domain, as patterns of DDS topics' names.

    Raises:
        InvalidValueError: The fleet has no such agent.
    """
    used = set(_used(fleet, agent))
    rights = {}
    for verb, way in (("publish", Direction.OUTWARD), ("subscribe", Direction.INWARD)):
        rules = {rule.pattern for rule in fleet.policy.rules if way in rule.directions}
        may = {name for name, its_way in used if its_way is way}
        names = _passing(may, rules) | _passing(rules, may) | set(filter(_is_nobodys, rules))
        rights[verb] = tuple(sorted(name for name in names if not _passing([name], names - {name})))
    return rights


def _used(fleet: Fleet, agent: str) -> Iterator[tuple[str, Direction]]:
    """Return the DDS topics that an agent may use if they cross, and which way their samples go."""
    spec = fleet.agent(agent)
    yield "rt/*", Direction.INWARD
    yield from product((f"{owned}{agent}/*" for owned in _OWNED), Direction)
    for use in View(replace(fleet, agents=(spec,))).uses:
        for name in dds_names(use.name, use.kind):
            answers = use.kind is ResourceKind.TOPIC or not name.startswith("rq/")
            yield name, Direction.OUTWARD if use.speaks == answers else Direction.INWARD
    if spec.lifecycle:  # asks everybody, also those who come later
        for name, way in zip(dds_service(metadata_service(agent)), Direction, strict=True):
            yield name.replace(f"/{agent}/", "/*/"), way


def _passing(names: Iterable[str], rules: set[str]) -> set[str]:
    # A `*` in a name is met by a rule's `*` alone, so that whatever it stands for passes, too.
    return {name for name in names if any(fnmatchcase(name, rule) for rule in rules)}


def _is_nobodys(rule: str) -> bool:
    """Return whether no name with an agent in it falls under a rule, as under "rt/tf"."""
    fixed = rule[: min((i for i, char in enumerate(rule) if char in "*?["), default=len(rule))]
    return not any((o.startswith(fixed) and fixed != rule) or fixed.startswith(o) for o in _OWNED)


def render_permissions(fleet: Fleet, agent: str, not_before: datetime, not_after: datetime) -> str:
    """Return an agent's permissions, for a certificate whose common name is ``/<agent>``; times in UTC.

    Raises:
        InvalidValueError: The fleet has no such agent, or a domain cannot be secured.
    """
    rules = {fleet.global_domain: global_rights(fleet, agent)}
    rules.setdefault(fleet.agent(agent).domain, {"publish": ("*",), "subscribe": ("*",)})
    for domain in rules:
        if domain > LAST_DOMAIN:
            raise InvalidValueError(f"domain of {agent}, secured", domain, f"0 to {LAST_DOMAIN}")
    times = {"not_before": f"{not_before:%FT%T}", "not_after": f"{not_after:%FT%T}"}
    return render("security/permissions.xml.j2", agent=agent, rules=rules, **times)
