"""The decoder's side of discovery events, on real DDS: late, and after the discoverer was replaced."""

from __future__ import annotations

import asyncio

import pytest

from sfglab.bus import Node
from sfglab.fleet.discovery.listener import (
    DISCOVERY_EVENT,
    DISCOVERY_QOS,
    KnownAgents,
    Offered,
    Withdrawn,
    agent_changes,
    discovery_topic,
)
from sfglab.messages import default_message

pytestmark = [pytest.mark.live]

TOPIC = discovery_topic("station")


def event(agent: str, kind: str = "DISCOVERED"):
    message = default_message(DISCOVERY_EVENT)
    message.agent, message.event = agent, getattr(message, kind)
    message.metadata.agent = agent
    return message


async def heard(changes, count: int) -> set:
    found = set()
    async with asyncio.timeout(60):
        while len(found) < count:
            change = await anext(changes)
            found.add((type(change), change.agent))
    return found


async def test_what_was_announced_before_is_heard_and_a_new_discoverer_leaves_no_ghosts(domains):
    address = domains[0].options()
    async with Node("decoder", **address) as near:
        changes = agent_changes(near, TOPIC, KnownAgents(grace_ns=300_000_000))
        async with Node("discoverer", **address) as far:
            publisher = far.create_publisher(DISCOVERY_EVENT, TOPIC, DISCOVERY_QOS)
            publisher.publish(event("go2"))
            publisher.publish(event("husky"))
            assert await heard(changes, 2) == {(Offered, "go2"), (Offered, "husky")}
        async with Node("discoverer", **address) as far:
            publisher = far.create_publisher(DISCOVERY_EVENT, TOPIC, DISCOVERY_QOS)
            publisher.publish(event("husky"))
            assert await heard(changes, 1) == {(Withdrawn, "go2")}, "nobody announced it again"
        await changes.aclose()
