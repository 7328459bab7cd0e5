"""Nodes come and go: the graph notices, and nothing is left behind."""

import asyncio
import gc
import re
import socket
import threading
from contextlib import closing, suppress
from pathlib import Path

import psutil
import pytest
import waiting
from bus_messages import SERVICE, STRING, Request, connected, response, text

from sfglab import bus
from sfglab.bus.dds.domain import DomainConfig, join
from sfglab.qos import LATCHED

pytestmark = pytest.mark.live
world = pytest.fixture(lambda live: live)
LIBRARY = '<Library path="dds_security_auth" initFunction="i" finalizeFunction="f"/>'
SECURITY = f"<Security><Authentication>{LIBRARY}</Authentication></Security>"
SECURED = f"<CycloneDDS><Domain>{SECURITY}</Domain></CycloneDDS>"


def resources():
    """Count what this process would leak: threads, descriptors and maps.

    Zenoh's pools of threads, which earlier tests in this process may have started, shrink when they are idle.
    """
    gc.collect()
    process = psutil.Process()
    threads = 0
    for task in Path("/proc/self/task").glob("*/comm"):
        with suppress(OSError):  # the thread has ended
            threads += re.match(r"(acc|app|net|rx|tx)-\d", task.read_text()) is None
    maps = Path("/proc/self/maps").read_text(encoding="ascii")
    shared = maps.count("memfd:") + maps.count("/dev/shm/")
    return threads, process.num_fds(), shared


def settle(before):
    """Wait until this process has what it had; what runs in threads ends in its own time."""
    waiting.wait_until(lambda: resources() == before)


async def use(here):
    """Make endpoints of every kind, and send messages."""
    for transport in ("dds", "shm"):
        publisher, subscription = await connected(here, here, transport=transport)
        here.create_subscription(STRING, "/t", lambda _: None, transport=transport)
        await publisher.wait_for_subscriptions(2)
        publisher.publish(text("x"))
    here.create_service(SERVICE, "/s", print)
    here.create_client(SERVICE, "/s")
    here.create_action_server("sfglab_interfaces/action/FollowTrajectory", "/go", print)
    here.create_action_client("sfglab_interfaces/action/FollowTrajectory", "/go")
    return await subscription.take(60)


async def test_eight_open_and_close_cycles_leave_nothing(node):
    for number in range(9):
        async with node("here") as here:
            here.create_timer(0.001, lambda: asyncio.sleep(3600))
            here.create_subscription(STRING, "/t", lambda _: asyncio.sleep(3600))
            await use(here)
        if number == 0:
            before = resources()
    settle(before)
    assert len(asyncio.all_tasks()) == 1


async def test_an_abandoned_node_closes_itself_and_a_rerun_works(node):
    async def cell():
        """A notebook cell that forgets to close."""
        here = node("same_name")
        here.start()
        return await use(here)

    async def forgotten():
        got = await cell()
        gc.collect()
        return got

    for number in range(4):
        with pytest.warns(ResourceWarning, match="node 'same_name' was not closed"):
            assert (await forgotten()).data == "x"
        if number == 0:
            before = resources()
    settle(before)


def test_a_loop_that_ends_without_closing_its_node_leaves_nothing(live):
    kept = []

    async def scenario(node):
        kept.append(node("script"))
        kept[0].start()
        await use(kept[0])

    def forget():
        kept.clear()
        gc.collect()

    live.run(scenario)
    with pytest.warns(ResourceWarning, match="node 'script' was not closed"):
        forget()
    before = resources()
    live.run(scenario)
    kept.pop().destroy_node()
    settle(before)


async def test_one_process_cannot_join_a_domain_in_two_ways(node):
    async with node("first"), node("second"):
        with pytest.raises(bus.DomainError, match=r"already joined.*lease_s=10\.0.*lease_s=2"):
            node("third", lease_s=2).start()
    async with node("after", lease_s=2):
        pass


@pytest.mark.parametrize(
    ("environment", "said"),
    [
        (
            {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"},
            "sfglab has no DDS Security",
        ),
        ({"CYCLONEDDS_URI": SECURED}, "Cyclone DDS cannot start"),
    ],
)
def test_a_domain_that_must_be_secured_is_not_joined(monkeypatch, environment, said):
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(bus.DomainError, match=said):
        join(DomainConfig(domain_id=99, interface="lo"))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"interface": "eth77"}, r"no network interface 'eth77' here; allowed: .*lo"),
        *(({"domain_id": number}, "0 to 232") for number in (-1, 233)),
        ({"external_domain_id": 233}, "0 to 232"),
        ({"multicast": "maybe"}, "Cyclone DDS cannot start"),
        ({"lease_s": 0}, "lease_s: given 0, allowed: at least 0.1"),
    ],
)
async def test_a_domain_that_cannot_be_joined_says_why(options, said):
    with pytest.raises(bus.DomainError, match=said):
        bus.Node("n", **{"domain_id": 100, **options}).start()


async def test_a_taken_port_is_an_error_that_names_it(node, domain_id):
    port = 7400 + 250 * domain_id
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as other:
        other.bind(("", port))
        with pytest.raises(bus.DomainError, match=f"UDP port {port} is not taken"):
            node("n").start()
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
    async with child('node.create_subscription(String, "/t"); await hear()', "deaf") as deaf:
        publisher = here.create_publisher(STRING, "/t")
        await publisher.wait_for_subscriptions(timeout_s=60)
        await deaf.stop()
        publisher.publish(text("x"))
        threads = set(threading.enumerate())
        publisher.close()
        # Cyclone waits a second for the acknowledgement, in a thread.
        (ending,) = set(threading.enumerate()) - threads
        assert ending.daemon, "an interpreter that ends does not wait either"
        await until(lambda: not ending.is_alive())
        await until(lambda: here.graph.publishers("/t") == ())
        deaf.go_on()


# --- Another process.


async def test_a_publisher_with_more_readers_than_it_looks_at_still_counts_them(
    here, there, until, monkeypatch
):
    """Any process may make readers of a topic, so their number is not bounded."""
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
    """A reliable writer that keeps all would wait for such a client until its lease ends."""
    service = here.create_service(SERVICE, "/s", lambda _: response("x" * 4000))
    listener = f"""
    client = node.create_client("{SERVICE}", "/s")
    await client.wait_for_service(60)
    await hear()
    """
    async with child(listener, "deaf", lease_s=1000.0) as deaf:
        client = there.create_client(SERVICE, "/s")
        await until(lambda: len(service._writer.matched_prefixes) == 2)
        await deaf.stop()
        for _ in range(300):
            assert len((await client.call(Request(), timeout_s=30)).message) == 4000
        deaf.go_on()
