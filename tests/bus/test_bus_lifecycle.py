"""Nodes come and go: the graph notices, and nothing is left behind."""

import asyncio
import gc
import socket
import threading
import time
from contextlib import closing
from pathlib import Path

import psutil
import pytest
from bus_messages import SERVICE, STRING, Request, connected, text

from sfglab import bus
from sfglab.bus.dds.domain import DomainConfig, join
from sfglab.messages import default_message, service_type
from sfglab.names import FqnError
from sfglab.qos import LATCHED

pytestmark = pytest.mark.live
world = pytest.fixture(lambda live: live)


def resources():
    """Count what this process would leak: threads of Python and of C, descriptors, maps, children."""
    gc.collect()
    process = psutil.Process()
    maps = Path("/proc/self/maps").read_text(encoding="ascii")
    shared = maps.count("memfd:") + maps.count("/dev/shm/")
    return (
        threading.active_count(),
        process.num_threads(),
        process.num_fds(),
        shared,
        len(process.children()),
    )


def settle(before):
    """Wait until this process has what it had; what runs in threads ends in its own time."""
    end_s = time.monotonic() + 60
    while resources() != before and time.monotonic() < end_s:
        time.sleep(0.01)
    assert resources() == before


async def use(node):
    async with node("here") as here:
        received = asyncio.Event()
        for transport in ("dds", "shm"):
            publisher = here.create_publisher(STRING, "/t", transport=transport)
            held = here.create_subscription(STRING, "/t", transport=transport)
            here.create_subscription(STRING, "/t", lambda _: received.set(), transport=transport)
            await publisher.wait_for_subscriptions(2)
            await held.wait_for_publishers()
            publisher.publish(text("x"))
            await asyncio.wait_for(received.wait(), 60)
        here.create_service(SERVICE, "/s", print)
        here.create_client(SERVICE, "/s")
        here.create_timer(0.001, lambda: asyncio.sleep(3600))
        here.create_subscription(STRING, "/t", lambda _: asyncio.sleep(3600))
        publisher.publish(text("y"))


async def test_twenty_open_and_close_cycles_leave_nothing(node):
    await use(node)
    before = resources()
    for _ in range(20):
        await use(node)
    settle(before)
    assert len(asyncio.all_tasks()) == 1


async def test_an_abandoned_node_closes_itself_and_a_rerun_works(domain_id):
    async def cell():
        """A notebook cell that forgets to close."""
        here = await bus.Node.create("same_name", domain_id=domain_id, interface="lo")
        here.create_action_server("sfglab_interfaces/action/FollowTrajectory", "/go", print)
        here.create_action_client("sfglab_interfaces/action/FollowTrajectory", "/go")
        publisher, subscription = await connected(here, here, transport="shm")
        publisher.publish(text("x"))
        return await subscription.take(60)

    async def forgotten():
        got = await cell()
        gc.collect()
        return got

    with pytest.warns(ResourceWarning, match="node 'same_name' was not closed"):
        await forgotten()
    before = resources()
    for _ in range(3):
        with pytest.warns(ResourceWarning):
            assert (await forgotten()).data == "x"
    settle(before)


def test_a_loop_that_ends_without_closing_its_node_leaves_nothing(domain_id):
    kept = []

    async def scenario():
        here = await bus.Node.create("script", domain_id=domain_id, interface="lo")
        publisher = here.create_publisher(STRING, "/t", transport="shm")
        here.create_subscription(STRING, "/t", lambda _: None, transport="shm")
        here.create_subscription(STRING, "/t", lambda _: None)
        await publisher.wait_for_subscriptions()
        kept.append(here)

    def forget():
        kept.clear()
        gc.collect()

    asyncio.run(scenario())
    with pytest.warns(ResourceWarning, match="node 'script' was not closed"):
        forget()
    before = resources()
    asyncio.run(scenario())
    kept.pop().destroy_node()
    settle(before)


async def test_cancelling_or_interrupting_the_body_closes_the_node(node):
    async def body(started):
        async with node("here") as here:
            subscription = here.create_subscription(STRING, "/t")
            started.set()
            await subscription.take()

    counts = []
    for _ in range(2):
        started = asyncio.Event()
        task = asyncio.create_task(body(started))
        await started.wait()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        counts.append(resources())
    assert counts[0] == counts[1]


async def test_one_process_cannot_join_a_domain_in_two_ways(node):
    async with node("first"), node("second"):
        with pytest.raises(bus.DomainError, match=r"already joined.*lease_s=10\.0.*lease_s=2"):
            node("third", lease_s=2).start()
    async with node("after", lease_s=2):
        pass


def test_a_domain_that_must_be_secured_is_not_joined(monkeypatch):
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    with pytest.raises(bus.DomainError, match="cannot obey"):
        join(DomainConfig(domain_id=99, interface="lo"))


def test_a_domain_is_not_joined_in_the_open_where_security_is_asked_for(monkeypatch):
    library = '<Library path="dds_security_auth" initFunction="i" finalizeFunction="f"/>'
    security = f"<Security><Authentication>{library}</Authentication></Security>"
    uri = f"<CycloneDDS><Domain>{security}</Domain></CycloneDDS>"
    monkeypatch.setenv("CYCLONEDDS_URI", uri)
    with pytest.raises(bus.DomainError, match="Cyclone DDS cannot start"):
        join(DomainConfig(domain_id=99, interface="lo"))


async def test_a_domain_that_cannot_be_joined_says_why():
    with pytest.raises(bus.DomainError, match=r"no network interface 'eth77' here; there are .*lo"):
        await bus.Node.create("n", domain_id=100, interface="eth77")
    for domain_id in (-1, 233, 1.5, True):
        with pytest.raises(bus.DomainError, match="0 to 232"):
            bus.Node("n", domain_id=domain_id)
    with pytest.raises(bus.DomainError, match="0 to 232"):
        bus.Node("n", external_domain_id=233)
    with pytest.raises(bus.DomainError, match="allowed are default, spdp, true, false"):
        bus.Node("n", multicast="maybe")
    with pytest.raises(bus.DomainError, match=r"lease_s=0"):
        bus.Node("n", lease_s=0)
    with pytest.raises(FqnError):
        await bus.Node.create("no name", domain_id=100, interface="lo")


async def test_a_taken_port_is_an_error_that_names_it(node, domain_id):
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as other:
        other.bind(("", 7400 + 250 * domain_id))
        with pytest.raises(
            bus.DomainError, match=f"UDP port {7400 + 250 * domain_id} is not taken"
        ):
            await bus.Node.create("n", domain_id=domain_id, interface="lo")
    async with node("here"):
        pass  # the failure left nothing behind


async def test_without_multicast_nodes_of_one_host_find_each_other(node, child):
    talker = """
    node.create_publisher(String, "/t", LATCHED).publish(String(data="unicast"))
    await hear()
    """
    async with node("here", multicast="false") as here, child(talker, "talker", multicast="false"):
        subscription = here.create_subscription(STRING, "/t", qos=LATCHED)
        assert (await subscription.take(60)).data == "unicast"


async def test_closing_a_publisher_waits_for_no_reader_that_acknowledges_nothing(
    here, child, until
):
    listener = f"""
    node.create_subscription("{STRING}", "/t")
    await hear()
    """
    async with child(listener, "deaf", lease_s=10.0) as deaf:
        publisher = here.create_publisher(STRING, "/t")
        await publisher.wait_for_subscriptions(timeout_s=60)
        await deaf.stop()
        publisher.publish(text("x"))
        threads = set(threading.enumerate())
        publisher.close()
        (waiting,) = (
            set(threading.enumerate()) - threads
        )  # Cyclone waits a second for the acknowledgement
        assert waiting.daemon, "an interpreter that ends does not wait either"
        await until(lambda: not waiting.is_alive())
        await until(lambda: here.graph.publishers("/t") == ())
        deaf.go_on()


# --- Another process.


async def test_a_publisher_with_more_readers_than_it_looks_at_still_counts_them(
    here, there, until, monkeypatch
):
    """Anybody may make readers of a topic: they end nothing."""
    monkeypatch.setattr("sfglab.bus.dds.endpoints._MAX_MATCHED", 2)
    publisher = here.create_publisher(STRING, "/crowded")
    readers = [there.create_subscription(STRING, "/crowded") for _ in range(4)]
    await publisher.wait_for_subscriptions(4)
    readers.pop().close()
    await until(lambda: publisher.get_subscription_count() == 3)
    publisher.publish(text("heard"))
    assert (await readers[0].take(timeout_s=60)).data == "heard"


async def test_a_client_that_acknowledges_nothing_takes_no_answer_from_others(
    here, there, child, until
):
    """Killed, stopped or ill-willed: until its lease ends a reliable writer that keeps all waits for it."""
    response = default_message(service_type(SERVICE).response, message="x" * 4000)
    service = here.create_service(SERVICE, "/agent/get_metadata", lambda _: response)
    listener = f"""
    client = node.create_client("{SERVICE}", "/agent/get_metadata")
    await client.wait_for_service(60)
    await hear()
    """
    async with child(listener, "deaf", lease_s=1000.0) as deaf:
        client = there.create_client(SERVICE, "/agent/get_metadata")
        await until(lambda: len(service._pair.writer.matched_prefixes) == 2)
        await deaf.stop()
        for _ in range(300):
            assert len((await client.call(Request(), timeout_s=30)).message) == 4000
        deaf.go_on()


async def test_a_servers_death_is_a_timeout(here, child):
    answering = f"""
    response = default_message("{SERVICE}_Response")
    node.create_service("{SERVICE}", "/agent/get_metadata", lambda _: response)
    await hear()
    """
    async with child(answering, "server", lease_s=1.0) as server:
        client = here.create_client(SERVICE, "/agent/get_metadata")
        await client.wait_for_service(60)
        assert not (await client.call(Request())).success
        await server.kill()
        with pytest.raises(bus.BusTimeoutError, match=r"has gone|did not respond"):
            await client.call(Request(), timeout_s=0.2)
        assert await client._pair.changed.wait_until(lambda: not client.service_is_ready(), 60)
