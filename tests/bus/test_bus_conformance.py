"""Nodes behave alike over every backend: one set of facts, shown on live, simulated and toy ones."""

import asyncio
import threading
from functools import partial

import numpy as np
import pytest
from bus_messages import SERVICE, STRING, Request, String, connected, failures, response, text
from toy_bus import OtherToyBackend, ToyBackend, ToyDomain

from sfglab import bus
from sfglab.component import beside
from sfglab.errors import InvalidValueError
from sfglab.fleet.discovery.config import DiscoverySettings
from sfglab.fleet.discovery.node import AgentDiscoverer
from sfglab.fleet.router.config import RouterSettings
from sfglab.fleet.router.node import Router
from sfglab.fleet.status.config import StatusSettings
from sfglab.fleet.status.node import StatusProvider
from sfglab.messages import default_message, serialize
from sfglab.qos import DEFAULT, LATCHED, SENSOR_DATA, Durability, QoSProfile

HEADER = "std_msgs/msg/Header"


async def test_a_message_arrives_with_what_is_known_about_it(here, there):
    publisher, subscription = await connected(here, there)
    before_ns = here.get_clock().now_ns()
    publisher.publish(text("hello"))
    message, info = await subscription.take_with_info(60)
    assert message == text("hello")
    assert before_ns <= info.source_timestamp_ns <= info.received_timestamp_ns
    assert info.received_timestamp_ns <= there.get_clock().now_ns()
    assert info.publisher_gid == publisher.gid
    assert (publisher.get_subscription_count(), subscription.get_publisher_count()) == (1, 1)
    assert await there.graph.wait_for(lambda: there.graph.topics() == {"/t": (STRING,)})


async def test_an_async_callback_gets_the_next_message_when_done_and_only_it_misses_some(
    here, there, until
):
    gate, log = asyncio.Event(), []

    async def slow(message):
        log.append(f"+{message.data}")
        await gate.wait()
        log.append(f"-{message.data}")

    publisher = here.create_publisher(STRING, "/t", 5)
    slowly = there.create_subscription(STRING, "/t", slow, 5)
    fast = there.create_subscription(STRING, "/t", qos=5)
    await publisher.wait_for_subscriptions(2)
    for number in range(40):  # in lock step with the fast one, so only the slow one can drop
        publisher.publish(text(number))
        assert (await fast.take(60)).data == str(number)
        await until(lambda: log)  # the slow one is busy with the first
    await until(lambda: slowly.dropped == 40 - 5 - 1)
    gate.set()
    await until(lambda: len(log) == 12)
    assert log == [f"{sign}{number}" for number in (0, 35, 36, 37, 38, 39) for sign in "+-"]
    assert (slowly.dropped, slowly.lost, fast.dropped) == (34, 0, 0)


@pytest.mark.parametrize("transport", ["dds", "shm"])
async def test_every_reader_and_callback_gets_all_in_order_and_nothing_once_closed(
    here, there, until, caplog, transport
):
    there = here if transport == "shm" else there  # simulated nodes may be on a host each
    options, heard = {"qos": 50, "transport": transport}, {True: [], False: []}
    threads = set()

    def note(threaded, message):
        heard[threaded].append(message.data)
        if threaded:
            threads.add(threading.current_thread())
        if message.data == "3":
            raise ValueError(message.data)

    publisher = here.create_publisher(STRING, "/t", **options)
    noted = [
        there.create_subscription(STRING, "/t", partial(note, kind), threaded=kind, **options)
        for kind in heard
    ]
    readers = [node.create_subscription(STRING, "/t", **options) for node in (here, there)]
    await publisher.wait_for_subscriptions(4)
    numbers = [str(number) for number in range(40)]
    for number in numbers:
        publisher.publish(text(number))
    for reader in readers:
        assert [(await reader.take(60)).data for _ in numbers] == numbers
    await until(lambda: [*heard.values()] == [numbers, numbers] and len(caplog.records) == 2)
    for subscription in noted:
        subscription.close()
    publisher.publish(text("late"))
    await readers[1].take(60)
    assert [*heard.values()] == [numbers, numbers]
    assert {each.dropped for each in noted} == {0}
    assert {r.getMessage() for r in caplog.records} == {"callback of subscription '/t' failed"}
    (thread,) = threads
    assert (thread is threading.main_thread()) == (there.backend.kind != "live")


@pytest.mark.parametrize("callback", [None, asyncio.sleep])
async def test_a_threaded_subscription_without_a_plain_callback_is_refused(here, callback):
    with pytest.raises(InvalidValueError, match=r"threaded subscription of '/t'.*a plain function"):
        here.create_subscription(STRING, "/t", callback, threaded=True)


@pytest.mark.parametrize("depth", [1, 3])
async def test_a_late_joiner_hears_the_history_first_if_it_wants_that_and_its_publisher_lives(
    here, there, depth
):
    kept = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=depth)
    publisher = here.create_publisher(STRING, "/t", kept)
    for number in range(5):
        publisher.publish(text(number))
    assert await publisher.wait_for_all_acked()
    wanted = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=10)
    late, volatile = (there.create_subscription(STRING, "/t", qos=qos) for qos in (wanted, DEFAULT))
    await publisher.wait_for_subscriptions(2)
    await volatile.wait_for_publishers()
    publisher.publish(text("new"))
    history = [str(number) for number in range(5 - depth, 5)]
    assert [(await late.take(60)).data for _ in range(depth + 1)] == [*history, "new"]
    assert (await volatile.take(60)).data == "new"
    publisher.close()
    await there.graph.wait_for(lambda: there.graph.publishers("/t") == ())
    with pytest.raises(bus.BusTimeoutError, match="0 matching"):
        await there.create_subscription(STRING, "/t", qos=LATCHED).take(0.05)


@pytest.mark.parametrize("transport", ["dds", "shm"])
@pytest.mark.parametrize(
    ("type_", "offered", "requested", "reason"),
    [
        (STRING, SENSOR_DATA, DEFAULT, "reliability: the reader requests RELIABLE"),
        (STRING, DEFAULT, LATCHED, "durability: the reader requests TRANSIENT_LOCAL"),
        (STRING, DEFAULT, QoSProfile(deadline_ns=5), "deadline: the reader requests 5 ns"),
        (HEADER, DEFAULT, SENSOR_DATA, f"type: the reader wants {STRING}, the writer has"),
    ],
)
async def test_what_does_not_match_says_so_once_and_what_does_says_nothing(
    node, caplog, type_, offered, requested, reason, transport, until
):
    async with node("here") as here, node("there") as there:
        publisher = here.create_publisher(type_, "/t", offered, transport=transport)
        there.create_subscription(STRING, "/t", qos=requested, transport=transport)
        matching = here.create_subscription(type_, "/u", qos=SENSOR_DATA, transport=transport)
        here.create_publisher(type_, "/u", offered, transport=transport)
        await matching.wait_for_publishers()
        await until(lambda: caplog.records != [])
        assert publisher.get_subscription_count() == 0
    (record,) = caplog.records
    said = "topic '/t': nothing will arrive from a publisher of node '/here': "
    assert record.getMessage().startswith(said + reason)


async def test_waits_in_vain_say_for_what(here):
    publisher, subscription = await connected(here, here)
    with pytest.raises(bus.BusTimeoutError, match=r"'/t'.*0\.01 s from 1 matching"):
        await subscription.take(0.01)
    with pytest.raises(bus.BusTimeoutError, match=r"3 matching subscription.*1 found"):
        await publisher.wait_for_subscriptions(3, 0.01)
    with pytest.raises(bus.BusTimeoutError, match=r"2 matching publisher.*1 found"):
        await subscription.wait_for_publishers(2, 0.01)
    client = here.create_client(SERVICE, "/s")
    with pytest.raises(bus.BusTimeoutError, match="service '/s': a server"):
        await client.wait_for_service(0.01)


async def test_raw_cdr_passes_unchanged_with_its_source_time_stamp(here, there):
    publisher, raw = await connected(here, there, type_=String, raw=True)
    cdr = serialize(text("four"))
    for kind in (bytes, bytearray, memoryview, partial(np.frombuffer, dtype=np.uint8)):
        publisher.publish_raw(kind(cdr), source_timestamp_ns=1_234_567_890)
        received, info = await raw.take_with_info(60)
        assert (received, info.source_timestamp_ns) == (cdr, 1_234_567_890)


@pytest.mark.live
async def test_what_is_no_message_of_the_topic_is_refused_and_dds_lends_no_memory(live):
    async with live.node("here") as here:
        publisher = here.create_publisher(STRING, "/t")
        for garbage in (
            b"",
            b"\0\1",
            serialize(text("hello"))[:9],
            b"\0\1\0\0\xff\xff\xff\xffabcd",
        ):
            with pytest.raises(bus.InvalidMessageError, match=r"'/t'.*std_msgs/msg/String"):
                publisher.publish_raw(garbage)
        for other, name in ((default_message(HEADER), HEADER), ({}, "dict")):
            with pytest.raises(bus.InvalidMessageError, match=f"given a {name}"):
                publisher.publish(other)
        with pytest.raises(TypeError), publisher.loan(8):
            pass


async def test_cancelling_a_take_loses_no_message(here):
    publisher, subscription = await connected(here, here, 200)
    got = []
    for number in range(50):
        taking = asyncio.create_task(subscription.take())
        await asyncio.sleep(0)
        publisher.publish(text(number))
        await asyncio.sleep(number % 3 * 1e-4)
        taking.cancel()
        await asyncio.wait([taking])
        if not taking.cancelled():
            got.append(taking.result().data)
    while len(got) < 50:
        got.append((await subscription.take(60)).data)
    assert got == [str(number) for number in range(50)]


async def test_closing_ends_readers_and_calls_and_further_use_is_an_error(node):
    asked = asyncio.Event()

    async def all_of(subscription):
        return [message async for message in subscription]

    async def never(request):
        asked.set()
        await asyncio.sleep(3600)

    async with node("here") as here:
        publisher = here.create_publisher(STRING, "/t")
        subscription = here.create_subscription(STRING, "/t")
        here.create_service(SERVICE, "/s", never)
        client = here.create_client(SERVICE, "/s")
        taking, listing, calling = map(
            asyncio.create_task, (subscription.take(), all_of(subscription), client.call(Request()))
        )
        await asyncio.wait_for(asked.wait(), 60)
        client.close()
        with pytest.raises(bus.ClosedError, match="client '/s'"):
            await calling
    with pytest.raises(bus.ClosedError, match=r"subscription '/t' is closed"):
        await taking
    assert await listing == []
    for thing in (publisher, subscription, client):
        thing.close()
    with pytest.raises(bus.ClosedError):
        publisher.publish(text(""))
    with pytest.raises(bus.ClosedError):
        here.create_timer(1.0, print)
    with pytest.raises(bus.ClosedError, match="client '/s'"):
        await client.call(Request())


async def test_listeners_are_told_what_is_known_and_then_changes_until_they_end(here, there, until):
    graph, everything, heard = there.graph, [], []
    publisher = here.create_publisher(STRING, "/t", 7)
    await graph.wait_for(lambda: graph.publishers("/t") != ())
    (endpoint,) = graph.publishers("/t")
    assert (endpoint.gid, endpoint.kind) == (publisher.gid, bus.EndpointKind.PUBLISHER)
    assert (endpoint.topic, endpoint.type, endpoint.dds_topic) == ("/t", STRING, "rt/t")
    assert (endpoint.qos.depth, endpoint.node, endpoint.transport) == (7, "/here", "dds")
    assert (endpoint.participant, endpoint.user_data) == (here.guid, b"")
    watched = [bus.EndpointAdded(endpoint=endpoint), bus.EndpointRemoved(endpoint=endpoint)]
    graph.listen(everything.append)
    end = graph.watch("rt/t", bus.EndpointKind.PUBLISHER, heard.append)
    assert everything == heard == watched[:1]
    subscription = there.create_subscription(STRING, "/t")
    await until(lambda: everything[1:])
    assert everything[1].endpoint.gid == subscription.gid
    publisher.close()
    await until(lambda: everything[2:])
    assert everything[2] == watched[1]
    end()
    end()
    here.create_publisher(STRING, "/t")
    await until(lambda: everything[3:])
    assert heard == watched


async def test_a_service_and_a_client_say_who_they_are_at_both_of_their_topics(here, there, until):
    here.create_service(SERVICE, "/s", print)
    here.create_client(SERVICE, "/s")
    await until(lambda: len(there.graph.endpoints()) == 4)
    shown = [
        (end.topic, end.kind.value, *end.user_data.split(b"=")) for end in there.graph.endpoints()
    ]
    assert {row[:3] for row in shown} == {
        ("rq/sRequest", "subscription", b"serviceid"),
        ("rr/sReply", "publisher", b"serviceid"),
        ("rq/sRequest", "publisher", b"clientid"),
        ("rr/sReply", "subscription", b"clientid"),
    }
    assert {len(row[3].split(b".")) for row in shown} == {16}


async def test_concurrent_calls_of_two_clients_get_their_own_answers(here, there):
    release, waiting = asyncio.Event(), []

    async def answer(request):
        waiting.append(number := len(waiting))
        if len(waiting) == 10:
            release.set()
        await release.wait()
        await asyncio.sleep(0.001 * (10 - number))  # in another order than they were asked
        return response(str(number))

    there.create_service(SERVICE, "/s", answer)
    clients = [here.create_client(SERVICE, "/s"), there.create_client(SERVICE, "s")]
    calls = [client.call(Request()) for client in clients for _ in range(5)]
    assert sorted(int(r.message) for r in await asyncio.gather(*calls)) == list(range(10))


async def test_calls_that_fail_say_how_and_a_failing_handler_is_logged(here, there, caplog, until):
    answers = [
        lambda: response("plain"),
        lambda: asyncio.sleep(3600),
        lambda: text("wrong"),
        lambda: 1 / 0,
    ]
    client = there.create_client(SERVICE, "/s")
    with pytest.raises(bus.BusTimeoutError, match="no server was found"):
        await client.call(Request(), timeout_s=0.01)
    service = here.create_service(SERVICE, "/s", lambda _: answers.pop(0)())
    await client.wait_for_service()
    assert (await client.call(Request())).message == "plain"
    for _ in range(3):
        with pytest.raises(bus.BusTimeoutError, match="did not respond"):
            await client.call(Request(), timeout_s=0.05)
    with pytest.raises(bus.InvalidMessageError, match="GetMetadata_Request"):
        await client.call(text("wrong"))
    assert failures(caplog) == [bus.InvalidMessageError, ZeroDivisionError]
    assert {r.getMessage() for r in caplog.records} == {"callback of service '/s' failed"}
    service.close()
    await until(lambda: not client.service_is_ready())


async def test_timers_tick_without_drift_skip_what_they_miss_and_can_be_cancelled(
    world, here, caplog, until
):
    loop, ticks = asyncio.get_running_loop(), []
    start_s = loop.time()

    async def tick():
        ticks.append((loop.time() - start_s + 1e-6) / 0.02)
        if len(ticks) == 2:
            await asyncio.sleep(0.05)  # the third and fourth turn are lost
        if len(ticks) == 3:
            raise LookupError

    timer = here.create_timer(0.02, tick)
    await until(lambda: len(ticks) == 5)
    timer.cancel()
    assert all(turn >= number for number, turn in enumerate(ticks, start=1)), "none is early"
    assert ticks[2] >= 5
    if world.kind.startswith("simulated"):  # where a machine's other work makes none late
        assert [round(turn, 2) for turn in ticks] == [1, 2, 5, 6, 7]
    await here.get_clock().sleep_for(0.05)
    assert len(ticks) == 5
    with pytest.raises(ValueError, match="positive"):
        here.create_timer(0.0, tick)
    assert [r.getMessage() for r in caplog.records] == ["callback of timer of 0.02 s failed"]


async def test_the_two_transports_do_not_meet_and_zenoh_has_only_one(world, here):
    if world.kind == "zenoh":
        with pytest.raises(InvalidValueError, match=r"'/t', transport over Zenoh: given 'shm'"):
            here.create_publisher(STRING, "/t", transport="shm")
        return
    dds = here.create_subscription(STRING, "/t")
    publisher, shm = await connected(here, here, transport="shm")
    publisher.publish(text("shared"))
    assert (await shm.take(60)).data == "shared"
    assert (publisher.get_subscription_count(), dds.get_publisher_count()) == (1, 0)
    with pytest.raises(InvalidValueError, match=r"transport: given .smoke., allowed: dds, shm"):
        here.create_publisher(STRING, "/t", transport="smoke")


# --- Components need no change for another backend, and a router stands between any two.


@pytest.fixture(
    params=[
        "toy",
        "other toy",
        pytest.param("live", marks=pytest.mark.live),
        pytest.param("over_zenoh", marks=pytest.mark.zenoh),
    ]
)
def network(request):
    """Make nodes of the network: of the agent's backend, of another kind, of DDS, or over Zenoh."""
    if "toy" not in request.param:
        return request.getfixturevalue(request.param).node
    kind = OtherToyBackend if request.param == "other toy" else ToyBackend
    return partial(ToyDomain().node, kind=kind)


async def test_a_discoverer_finds_an_agent_and_its_description_through_the_agents_router(network):
    own, news = ToyDomain().node, asyncio.Queue()
    async with (
        own("near") as near,
        own("status") as status,
        network("far") as far,
        network("station") as station,
    ):
        found = AgentDiscoverer(
            station, DiscoverySettings(agent="station"), on_event=news.put_nowait
        )
        router = Router(near, far, RouterSettings(agent="go2"))
        provider = StatusProvider(status, StatusSettings(agent="go2"))
        async with beside(router.run(), provider.run(), found.run()):
            heard = await asyncio.wait_for(news.get(), 60)
            assert (heard.agent, heard.event) == ("go2", "DISCOVERED")
            senders = {e.node for e in station.graph.publishers("/global/agent_heartbeat")}
            # Over Zenoh routers send heartbeats without tokens.
            assert senders == (set() if far.backend.kind == "zenoh" else {"/far"})
