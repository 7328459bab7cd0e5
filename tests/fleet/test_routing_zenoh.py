"""Routers of two agents with DDS that meet over Zenoh: topics, latched topics and services cross once."""

import asyncio
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest
from waiting import until

from sfglab.bus import Node
from sfglab.bus.dds.endpoints import DdsReader, DdsWriter
from sfglab.component import beside
from sfglab.fleet.router.config import RouterSettings
from sfglab.fleet.router.node import Router
from sfglab.messages import message_type
from sfglab.messages.dds import opaque_idl_struct
from sfglab.qos import LATCHED

pytestmark = [pytest.mark.live, pytest.mark.zenoh]

STRING = "std_msgs/msg/String"
String = message_type(STRING)


@asynccontextmanager
async def agent(name, domain_id, over_zenoh):
    """A node in an agent's domain of DDS, behind a router to Zenoh."""
    async with (
        Node(name, domain_id=domain_id, interface="lo") as node,
        Node("router", domain_id=domain_id, interface="lo") as near,
        over_zenoh.node("router", namespace=f"/{name}") as far,
    ):
        router = Router(near, far, RouterSettings(agent=name, idle_timeout_s=0.1))
        async with beside(router.run()):
            yield node


@pytest.fixture
def fleet(free_domains, over_zenoh):
    """Two agents."""

    @asynccontextmanager
    async def opened():
        one, two = free_domains(2)
        async with agent("one", one, over_zenoh) as here, agent("two", two, over_zenoh) as there:
            yield here, there

    return opened


async def test_topics_cross_once_in_order_with_their_stamps_and_local_ones_stay(fleet):
    heard, stayed = [], []
    async with fleet() as (here, there):
        there.create_subscription(STRING, "/global/one/t", lambda m: heard.append(m.data), 100)
        there.create_subscription(STRING, "/local/t", lambda m: stayed.append(m.data), 100)
        publisher = here.create_publisher(STRING, "/global/one/t", 100)
        here.create_publisher(STRING, "/local/t", 100).publish(String(data="local"))
        await publisher.wait_for_subscriptions()
        await until(lambda: heard, lambda: publisher.publish(String(data="first")), every_s=0.1)
        for number in range(50):
            publisher.publish(String(data=str(number)))
        await until(lambda: heard[-1] == "49")
    assert [one for one in heard if one != "first"] == [str(number) for number in range(50)]
    assert stayed == []


async def test_latched_samples_of_two_publishers_reach_who_subscribes_late_once_each(fleet):
    async with fleet() as (here, there):
        kept = replace(LATCHED, depth=10)
        for name in "ab":
            publisher = here.create_publisher(STRING, "/global/one/t", kept)
            publisher.publish(String(data=name))
        early, late = [], []
        there.create_subscription(STRING, "/global/one/t", lambda m: early.append(m.data), kept)
        await until(lambda: len(early) == 2)
        there.create_subscription(STRING, "/global/one/t", lambda m: late.append(m.data), kept)
        await until(lambda: len(late) == 2)
        await asyncio.sleep(0.3)
    assert sorted(early) == sorted(late) == ["a", "b"]


@pytest.mark.parametrize("is_early", [True, False])
async def test_an_unknown_type_crosses_two_routers(fleet, is_early):
    custom, topic, got = "my_robot_msgs/msg/Arm", "rt/global/one/arm", []
    cdr, struct = b"\0\1\0\0" + bytes(range(200)), opaque_idl_struct(custom)
    how = {"on_matched": lambda: None}

    def write(near):
        raw = near.create_writer(topic, struct, LATCHED)
        DdsWriter(raw, topic, type_=custom, waitset=near.waitset, **how).write(cdr, 7)

    async with fleet() as nodes:
        near, far = (node.backend.participant for node in nodes)
        if is_early:
            write(near)
            await asyncio.sleep(0.3)
        raw = far.create_reader(topic, struct, LATCHED)
        DdsReader(raw, waitset=far.waitset, on_samples=got.extend, **how)
        if not is_early:
            await asyncio.sleep(0.3)
            write(near)
        await until(lambda: got)
    assert [sample[:2] for sample in got] == [(cdr, 7)]


async def test_services_cross_both_ways(fleet, calls_cross):
    async with fleet() as nodes:
        await calls_cross(*nodes)
