"""A publisher that can never reach a subscription is named, with the reason."""

from __future__ import annotations

import asyncio
import logging

import pytest

from sfglab.bus import Node
from sfglab.qos import DEFAULT, LATCHED, SENSOR_DATA

pytestmark = pytest.mark.live

STRING = "std_msgs/msg/String"


@pytest.mark.parametrize("transport", ["dds", "shm"])
@pytest.mark.parametrize(
    ("offered", "requested", "reason"),
    [
        ((STRING, SENSOR_DATA), (STRING, DEFAULT), "reliability: the reader requests RELIABLE"),
        ((STRING, DEFAULT), (STRING, LATCHED), "durability: the reader requests TRANSIENT_LOCAL"),
        (("std_msgs/msg/Bool", DEFAULT), (STRING, DEFAULT), "type: the reader wants std_msgs/msg/String"),
    ],
)
def test_a_publisher_that_does_not_match_is_named_once(
    domain_id, caplog, transport, offered, requested, reason
):
    async def scenario():
        async with (
            Node("talker", domain_id=domain_id, interface="lo") as talker,
            Node("listener", domain_id=domain_id, interface="lo") as listener,
        ):
            listener.create_subscription(requested[0], "/t", qos=requested[1], transport=transport)
            talker.create_publisher(offered[0], "/t", offered[1], transport=transport)
            async with asyncio.timeout(60):
                while "nothing will arrive" not in caplog.text:
                    await asyncio.sleep(0.01)

    with caplog.at_level(logging.WARNING, logger="sfglab.bus"):
        asyncio.run(scenario())
    warnings = [r.getMessage() for r in caplog.records if "nothing will arrive" in r.getMessage()]
    assert len(warnings) == 1
    assert "'/talker'" in warnings[0]
    assert reason in warnings[0]


def test_publishers_that_match_are_not_mentioned(domain_id, caplog):
    async def scenario():
        async with Node("talker", domain_id=domain_id, interface="lo") as node:
            subscription = node.create_subscription(STRING, "/t", qos=SENSOR_DATA)
            node.create_publisher(STRING, "/t", DEFAULT)
            await subscription.wait_for_publishers()

    asyncio.run(scenario())
    assert "nothing will arrive" not in caplog.text
