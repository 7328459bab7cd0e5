"""Nodes over Zenoh: sessions without a router, after a fork, full links, and samples of others."""

import asyncio
import multiprocessing
import os
import time
from dataclasses import replace
from functools import partial

import pytest
from bus_messages import IMAGE, STRING, text

from sfglab.bus import BusError, DomainError, Node
from sfglab.bus.errors import WriterBlockedError
from sfglab.bus.zenoh.backend import ZenohBackend
from sfglab.bus.zenoh.session import Session, ZenohConfig
from sfglab.errors import MissingExtraError
from sfglab.qos import LATCHED, History, QoSProfile

pytestmark = pytest.mark.zenoh
KEEP_ALL = QoSProfile(history=History.KEEP_ALL)


def over(config, name, **options):
    return Node(name, join=partial(ZenohBackend, config), **options)


def router(config):
    """Open the router that the nodes of a configuration connect to."""
    import zenoh

    listening = replace(config, mode="router", connect=(), listen=config.connect)
    settings = zenoh.Config.from_json5(listening.json("a"))
    settings.insert_json5("scouting/delay", "0")
    return zenoh.open(settings)


@pytest.fixture
def place(free_port):
    return ZenohConfig(connect=(f"tcp/127.0.0.1:{free_port}",))


async def test_a_node_starts_without_a_router_says_so_and_goes_on_when_there_is_one(
    place, caplog, until
):
    async with over(place, "here") as here, over(place, "there") as there:
        publisher = here.create_publisher(STRING, "/t", LATCHED)
        volatile = here.create_publisher(STRING, "/u")
        for number in range(3):
            publisher.publish(text(number))
            volatile.publish(text(number))
        assert not await publisher.wait_for_all_acked(0.05)
        subscription = there.create_subscription(STRING, "/t", qos=LATCHED)
        await until(lambda: caplog.records)
        said = (
            f"Zenoh at {place.connect[0]} does not respond; next attempt in 1 s: Unable to connect"
        )
        assert caplog.records[0].getMessage().startswith(said)
        with router(place):
            assert (await subscription.take(60)).data == "2"
            assert await publisher.wait_for_all_acked()


async def test_a_publisher_that_is_closed_at_once_sends_the_sample_that_waits(place, caplog, until):
    with router(place):
        async with over(place, "here") as here, over(place, "there") as there:
            got = []
            there.create_subscription(
                STRING, "/t", lambda message: got.append(message.data), LATCHED
            )
            here.create_publisher(STRING, "/t", LATCHED).publish(text("first"))
            await until(lambda: got == ["first"])
            publisher = here.create_publisher(STRING, "/t", LATCHED)
            publisher.publish(text("last"))
            publisher.close()
            time.sleep(0.5)  # noqa: ASYNC251 - the thread declares and undeclares before the loop runs
            await until(lambda: got == ["first", "last"])
    assert not [record for record in caplog.records if record.exc_info]


async def test_a_port_in_use_is_reported_as_such(place, caplog, until):
    with router(place):
        listening = replace(place, mode="peer", connect=(), listen=place.connect)
        async with over(listening, "here"):
            await until(lambda: caplog.records)
    said = caplog.records[0].getMessage()
    assert said.startswith(f"Zenoh at {place.connect[0]} cannot be opened; next attempt in 1 s: ")
    assert "Address already in use" in said


async def test_peers_need_no_router(place):
    first = replace(place, mode="peer", connect=(), listen=place.connect)
    second = replace(place, mode="peer")
    async with over(first, "here") as here, over(second, "there") as there:
        publisher = here.create_publisher(STRING, "/t", LATCHED)
        publisher.publish(text("latched"))
        late = there.create_subscription(STRING, "/t", qos=LATCHED)
        assert (await late.take(60)).data == "latched"


async def test_a_node_without_a_router_ends_at_once(place):
    start_s = time.monotonic()
    async with over(place, "here") as here:
        here.create_publisher(STRING, "/t", LATCHED).publish(text("x"))
    assert time.monotonic() - start_s < 4


async def test_latched_samples_of_an_outage_arrive_and_none_twice(place, until):
    heard = []
    quick = replace(place, lease_s=1.0)
    first = router(place)
    async with over(quick, "here") as here, over(quick, "there") as there:
        publisher = here.create_publisher(STRING, "/t", replace(LATCHED, depth=9))
        deep = replace(LATCHED, depth=9)
        there.create_subscription(STRING, "/t", lambda message: heard.append(message.data), deep)
        publisher.publish(text("before"))
        await until(lambda: heard == ["before"])
        first.close()
        await until(lambda: not publisher.get_subscription_count())
        publisher.publish(text("meanwhile"))
        with router(place):
            await until(lambda: len(heard) > 1)
            publisher.publish(text("after"))
            await until(lambda: len(heard) > 2)
    assert heard == ["before", "meanwhile", "after"]


async def test_a_reader_that_lost_the_last_latched_samples_gets_them_after_a_heartbeat(hub, until):
    import zenoh
    from zenoh import ext

    numbers, heartbeats = [], []
    with zenoh.open(zenoh.Config.from_json5(hub.json("b"))) as other:
        async with over(hub, "here") as here:
            publisher = here.create_publisher(STRING, "/t", replace(LATCHED, depth=2))
            await until(lambda: here.backend.session.is_open)
            other.declare_subscriber(
                "0/t/**/@adv/pub/**",
                lambda sample: heartbeats.append(
                    int.from_bytes(sample.payload.to_bytes(), "little")
                ),
            )
            for number in range(4):
                publisher.publish(text(number))
            await asyncio.sleep(0.2)
            # It receives no sample and does not ask for the history: heartbeats alone tell it what it lacks.
            ext.declare_advanced_subscriber(
                other,
                "0/t/**",
                lambda sample: numbers.append(sample.payload.to_bytes()[8:9]),
                recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
            )
            await until(lambda: numbers == [b"2", b"3"])
            await asyncio.sleep(1)
    assert heartbeats == [3]


def _open_in_child(config):
    try:
        Session(config, "child")
    except BusError as error:
        os._exit(0 if "spawn" in str(error) else 2)
    os._exit(1)


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_forked_process_opens_no_session(hub):
    session = Session(hub, "parent")
    child = multiprocessing.get_context("fork").Process(target=_open_in_child, args=(hub,))
    child.start()
    child.join(60)
    session.close()
    assert child.exitcode == 0


async def test_a_keep_all_writer_refuses_samples_instead_of_stopping_the_loop(hub, until):
    async with over(hub, "here") as here:
        publisher = here.create_publisher(STRING, "/t", KEEP_ALL)
        await until(lambda: publisher._writer._is_started)
        publisher._writer._send = lambda *_: time.sleep(0.5)  # as while a receiver is slow

        def fill():
            for _ in range(300):
                publisher.publish(text("x"))

        start_s = time.monotonic()
        with pytest.raises(WriterBlockedError, match=r"'/t'.*256 samples of a KEEP_ALL writer"):
            fill()
        assert time.monotonic() - start_s < 0.5
        publisher._writer._send = lambda *_: None


async def test_all_samples_of_a_keep_all_writer_arrive(hub):
    async with over(hub, "here") as here, over(hub, "there") as there:
        publisher = here.create_publisher(STRING, "/t", KEEP_ALL)
        subscription = there.create_subscription(STRING, "/t", qos=KEEP_ALL)
        await publisher.wait_for_subscriptions()
        for number in range(2000):
            while True:
                try:
                    publisher.publish(text(number))
                    break
                except WriterBlockedError:
                    await asyncio.sleep(0.001)
        publisher.close()
        got = [(await subscription.take(60)).data for _ in range(2000)]
    assert got == [str(number) for number in range(2000)]
    assert subscription.lost == 0


async def test_images_and_transforms_have_priorities_of_their_own(hub, until):
    import zenoh

    async with over(hub, "here") as here:
        ends = [
            here.create_publisher(type_, f"/t{number}")
            for number, type_ in enumerate((IMAGE, STRING, "tf2_msgs/msg/TFMessage"))
        ]
        await until(lambda: all(end._writer._is_started for end in ends))
        given = [end._writer._publisher.priority for end in ends]
    priority = zenoh.Priority
    assert given == [priority.DATA_LOW, priority.DATA, priority.DATA_HIGH]


async def test_gaps_and_samples_without_an_attachment_count_as_lost(hub, until):
    async with over(hub, "here") as here, over(hub, "there") as there:
        publisher = here.create_publisher(STRING, "/t")
        subscription = there.create_subscription(STRING, "/t")
        await publisher.wait_for_subscriptions()
        await until(lambda: publisher._writer._is_started)
        publisher.publish(text("1"))
        next(publisher._writer._numbers)
        publisher.publish(text("3"))
        publisher._writer._publisher.put(b"of no node of ROS 2")
        publisher.publish(text("4"))
        assert [(await subscription.take(60)).data for _ in range(3)] == ["1", "3", "4"]
        assert subscription.lost == 2


async def test_a_topic_s_first_use_asks_for_its_tokens_and_a_tool_for_all(hub):
    async with over(hub, "here") as here, over(hub, "there") as there:
        for topic in ("/t", "/u"):
            here.create_publisher(STRING, topic)
        assert await there.graph.wait_for(lambda: there.graph.publishers("/t") != ())
        assert {end.topic for end in there.graph._known()} == {"/t"}
        assert await there.graph.wait_for(lambda: set(there.graph.topics()) == {"/t", "/u"})


def test_wrong_configurations_and_a_missing_library_are_refused(monkeypatch):
    with pytest.raises(DomainError, match="0 to 232"):
        ZenohConfig(domain_id=233)
    with pytest.raises(BusError, match="Zenoh refuses the configuration"):
        Session(ZenohConfig(connect=("nowhere",)), "here")
    monkeypatch.setattr("sfglab.bus.zenoh.session.find_spec", lambda _: None)
    with pytest.raises(MissingExtraError, match=r"node over Zenoh needs 'zenoh'.*\[zenoh\]"):
        Session(ZenohConfig(), "here")
