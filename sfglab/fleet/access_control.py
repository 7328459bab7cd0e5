"""Access control of Zenoh between the agents of a fleet, from its policy; paper A, section 4.1 and Table 1.

A hub knows an agent by the common name of its certificate, and accepts messages of these kinds:

* Samples and services below `/global/<agent>/`, as far as the policy lets them out.
* Samples on the policy's other topics, such as `/tf`, and on those of heartbeats and descriptions.
* Samples on topics that the fleet file lists as published by the agent, such as `/global/go2/cmd_vel`.
* Subscriptions and calls of all names that the policy lets in, and queries of the graph.
* Tokens, which announce endpoints, of nodes in the namespace `/<agent>`.

The hub drops other messages without an error. It sends accepted messages to all agents that subscribe to them.

Key expressions cannot tell what a sample contains. On `/tf`, `/tf_static`, and the topics of heartbeats and
descriptions, an agent can send frames, a heartbeat or a description of another agent. It can announce an endpoint
on a topic of another agent, but no sample of it arrives. Rights on a name are for topics and services alike; the
routers do not open those of the other kind.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from sfglab.bus.zenoh.layout import TOKENS, mangled
from sfglab.errors import InvalidValueError
from sfglab.fleet.policy import Direction
from sfglab.fleet.status.heartbeat import heartbeat_topic, metadata_topic
from sfglab.names import dds_topic

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.fleet.fleet_file import AgentSpec, Fleet

#: Common name of the certificates of all hubs; no agent can have it.
HUB = "fleet-hub"

_SEND = ("put", "declare_queryable", "reply", "liveliness_token")
_RECEIVE = ("declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query")
_ALL = _SEND + _RECEIVE
# "**" matches no part of a key that begins with "@". Caches of latched topics have such parts, and so have tokens.
_CACHES = "/@adv/**"
_EVERYWHERE = ("**", f"**{_CACHES}", f"{TOKENS}/**")
# Wildcards of the policy stand for any characters, those of Zenoh for whole parts of a key.
_PATTERN = re.compile(r"r[tqr]/\w+(/(\w+|\*(?!/\*)))*")


def access_control(fleet: Fleet) -> dict[str, Any]:
    """Return Zenoh's `access_control` settings for the hubs and peers of a fleet.

    Raises:
        InvalidValueError: The policy has a pattern that key expressions cannot express for each agent, as ``rt/*``.
    """
    for number, rule in enumerate(fleet.policy.rules):
        if not _PATTERN.fullmatch(rule.pattern):
            allowed = "a name whose parts after the first may be *, such as rt/tf or rt/global/*"
            raise InvalidValueError(("policy", number), rule.pattern, allowed)
    tokens = f"{TOKENS}/{fleet.global_domain}/"
    agents = {agent.name: agent for agent in fleet.agents}
    grants = [
        _rule("all: deliver", _ALL, _EVERYWHERE, [HUB, *agents], flow="egress"),
        _rule("hubs: forward", _ALL, _EVERYWHERE, [HUB]),
        _rule(
            "all: receive", _RECEIVE, [*_keys(fleet, Direction.INWARD), f"{tokens}**"], [*agents]
        ),
    ]
    for name, agent in agents.items():
        node = f"{tokens}*/*/*/*/*/{mangled(f'/{name}')}/**"
        grants.append(_rule(name, _SEND, [*_keys(fleet, Direction.OUTWARD, agent), node], [name]))
    settings = {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for rule, _ in grants],
        "subjects": [{"id": name, "cert_common_names": [name]} for name in (HUB, *agents)],
        "policies": [policy for _, policy in grants],
    }
    return {"access_control": settings}


def _rule(
    name: str,
    messages: Sequence[str],
    keys: Sequence[str],
    subjects: Sequence[str],
    *,
    flow: str = "ingress",
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a rule and the policy that applies it."""
    rule = {"id": name, "permission": "allow", "flows": [flow]}
    policy = {"rules": [name], "subjects": subjects}
    return {**rule, "messages": messages, "key_exprs": keys}, policy


def _keys(fleet: Fleet, direction: Direction, agent: AgentSpec | None = None) -> list[str]:
    """Return key expressions of the names that cross in a direction, or of those that an agent may use."""
    # Requests cross against their replies.
    rules = [
        rule
        for rule in fleet.policy.rules
        if direction in rule.directions and not rule.pattern.startswith("rq/")
    ]
    names = [rule.pattern[3:].removesuffix("Reply").replace("*", "**") for rule in rules]
    if agent is not None:
        own = f"global/{agent.name}/"
        names = [name.replace("global/**", f"{own}**") for name in names]
        names = [name for name in names if name.startswith(own) or not name.startswith("global/")]
        listed = [heartbeat_topic(), metadata_topic(), *(use.name for use in agent.publishes)]
        names += [
            name[1:] for name in listed if any(rule.matches(dds_topic(name)) for rule in rules)
        ]
    # Type and hash follow the name in a key.
    names = [name if name.endswith("*") else f"{name}/*/*" for name in dict.fromkeys(names)]
    return [f"{fleet.global_domain}/{name}{end}" for name in names for end in ("", _CACHES)]
