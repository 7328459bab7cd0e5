"""The shared-memory back-end between real processes and within one."""

import asyncio
import ctypes
import errno
import gc
import mmap
import os
import socket
import threading
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest
from bus_messages import IMAGE, PIXELS, STRING, connected, image, text

from sfglab import bus
from sfglab.bus.api import SHM_KEY, entries
from sfglab.bus.shm import wire, writer
from sfglab.bus.shm.fanout import credits_of, returns_of
from sfglab.messages import serialize
from sfglab.qos import LATCHED, History, QoSProfile

pytestmark = pytest.mark.live
world = pytest.fixture(lambda live: live)
pair = partial(connected, transport="shm")

TOGETHER = returns_of(credits_of(10))
"""So many slots a subscriber of the default depth gives back at once."""


def address_of(array):
    return array.__array_interface__["data"][0]


def connect(node):
    """Return a connection to the publisher of /t, as a subscriber makes it."""
    return wire.connect(entries(node.graph.publishers("/t")[0].user_data)[SHM_KEY])


def maps(permissions):
    """Return the address ranges that this process has mapped of publishers' memory files."""
    lines = Path("/proc/self/maps").read_text(encoding="ascii").splitlines()
    fields = [line.split() for line in lines if "memfd:sfglab" in line]
    return [tuple(int(end, 16) for end in f[0].split("-")) for f in fields if f[1] == permissions]


@pytest.mark.parametrize("transport", ["dds", "shm"])
async def test_images_cross_whole_to_another_process_and_the_graph_says_how(here, child, transport):
    reader = f"""
    sub = node.create_subscription(Image, "/image", qos=LATCHED, transport={transport!r})
    for _ in range(2):
        message, info = await sub.take_with_info(60)
        past = info.source_timestamp_ns <= info.received_timestamp_ns
        say(shape=[message.height, message.width], sum=int(message.data.sum()), frame=message.header.frame_id,
            writeable=message.data.flags.writeable, gid=info.publisher_gid.hex(), past=past)
        del message
        await hear()
    """
    publisher = here.create_publisher(IMAGE, "/image", LATCHED, transport=transport)
    publisher.publish(image(2))
    publisher.publish(image(3))  # the late joiner gets the last one
    async with child(reader, "reader") as other:
        said = {"shape": [360, 640], "frame": "camera", "writeable": False, "past": True}
        assert await other.hear() == said | {"sum": 3 * PIXELS, "gid": publisher.gid.hex()}
        assert await here.graph.wait_for(lambda: here.graph.subscriptions("/image") != ())
        (there,) = here.graph.subscriptions("/image")
        (mine,) = here.graph.publishers("/image")
        assert (there.transport, there.host, there.node) == (transport, mine.host, "/reader")
        await other.tell()
        publisher.publish(image(7))
        assert (await other.hear())["sum"] == 7 * PIXELS
        await other.tell()
        await other.end()


async def test_a_received_array_is_the_map_itself_and_cannot_be_written(here):
    publisher, subscription = await pair(here, here, type_=IMAGE)
    publisher.publish(image(5))
    message = await subscription.take(60)
    start = address_of(message.data)
    assert any(low <= start and start + PIXELS <= high for low, high in maps("r--s"))
    assert not message.data.flags.writeable
    with pytest.raises(ValueError, match="WRITEABLE"):
        message.data.flags.writeable = True


async def test_a_held_message_is_never_overwritten_and_its_slot_is_free_once_let_go(here):
    publisher, subscription = await pair(here, here, type_=IMAGE, qos=3)
    pool = publisher._writer._pool
    publisher.publish(image(1))
    held = (await subscription.take(60)).data[100:200]  # a view of a view also holds it
    addresses = set()
    for fill in range(2, 60):
        publisher.publish(image(fill))
        addresses.add(address_of((await subscription.take(60)).data))
    assert held.tolist() == [1] * 100
    assert address_of(held) - 100 not in addresses
    assert len(addresses) <= 1 + TOGETHER  # the others' slots were used again and again
    del held
    publisher.publish(image(60))
    assert len(pool._users) <= TOGETHER


async def test_a_reader_that_keeps_everything_goes_on_receiving_in_bounded_memory(here, there):
    publisher, hoarder = await pair(here, here, type_=IMAGE, qos=2)
    fast = there.create_subscription(IMAGE, "/t", qos=2, transport="shm")
    await publisher.wait_for_subscriptions(2)
    await fast.wait_for_publishers()
    hoard = []
    for fill in range(50):
        publisher.publish(image(fill))
        assert (await fast.take(60)).data[0] == fill
        hoard.append(await hoarder.take(60))
    assert [m.data[0] for m in hoard] == list(range(50)), "beyond its slots it is given copies"
    assert len(publisher._writer._pool._users) <= 2 * credits_of(2)
    assert (hoarder.dropped, fast.dropped) == (0, 0)


async def test_a_process_that_slept_gets_the_newest_messages_only(here, child):
    reader = """
    sub = node.create_subscription(String, "/t", qos=3, transport="shm")
    await sub.wait_for_publishers()
    say(ready=True)
    sys.stdin.readline()  # the loop stands still
    say(got=[(await sub.take(60)).data for _ in range(3)], dropped=sub.dropped)
    """
    publisher = here.create_publisher(STRING, "/t", transport="shm")
    async with child(reader, "reader") as other:
        await other.hear()
        for number in range(100):
            publisher.publish(text(number))
        assert len(publisher._writer._pool._users) <= credits_of(3) + 3
        await other.tell()
        assert await other.hear() == {"got": ["97", "98", "99"], "dropped": 97}
        await other.end()


@pytest.mark.parametrize("transport", ["dds", "shm"])
async def test_a_long_threaded_call_delays_no_other_keeps_the_newest_and_is_waited_for(
    node, until, transport
):
    threads, gate, called, got = set(threading.enumerate()), threading.Semaphore(0), [], []

    def slow(message):
        called.append(message.data)
        gate.acquire()
        got.append(message.data)

    async with node("here") as here, node("there") as there:
        publisher, fast = await pair(here, there, transport=transport)
        slowly = there.create_subscription(
            STRING, "/t", slow, 3, transport=transport, threaded=True
        )
        await publisher.wait_for_subscriptions(2)
        await slowly.wait_for_publishers()
        for number in range(20):
            publisher.publish(text(number))
            assert (await fast.take(60)).data == str(number)
            await until(lambda: called)
        gate.release(4)
        await until(lambda: len(got) == 4)
        assert got == ["0", "17", "18", "19"]
        publisher.publish(text("last"))
        await until(lambda: called[4:])
        asyncio.get_running_loop().run_in_executor(None, lambda: time.sleep(0.2) or gate.release())
        slowly.close()
        assert got[4:] == ["last"]
        await until(lambda: publisher.get_subscription_count() == 1)
        other = there.create_subscription(STRING, "/t", slow, 3, transport=transport, threaded=True)
        await other.wait_for_publishers()
        publisher.close()
        await until(lambda: other.get_publisher_count() == 0)
    assert not [t for t in set(threading.enumerate()) - threads if t.name.startswith("sfglab")]


async def test_the_death_of_a_subscriber_that_holds_slots_frees_them_at_once(here, child, until):
    reader = """
    sub = node.create_subscription(Image, "/t", qos=5, transport="shm")
    await sub.wait_for_publishers()
    say(ready=True)
    held = [await sub.take(60) for _ in range(5)]
    say(held=len(held))
    await hear()
    """
    publisher = here.create_publisher(IMAGE, "/t", 5, transport="shm")
    async with child(reader, "reader", lease_s=1.0) as other:
        await other.hear()
        for fill in range(5):
            publisher.publish(image(fill))
        assert await other.hear() == {"held": 5}
        assert len(publisher._writer._pool._users) == 5
        await other.kill()
        await until(lambda: publisher.get_subscription_count() == 0)
        assert len(publisher._writer._pool._users) < TOGETHER, "but for what is given back together"
        assert await here.graph.wait_for(lambda: not here.graph.subscriptions("/t"), 60)


async def test_the_death_of_a_publisher_leaves_held_messages_readable(here, child, until):
    writer = """
    node.create_publisher(Image, "/image")  # whose death the graph tells after its lease, too
    publisher = node.create_publisher(Image, "/image", transport="shm")
    await publisher.wait_for_subscriptions()
    publisher.publish(default_message(Image, data=np.full(1000, 9, np.uint8)))
    await hear()
    """
    before = maps("r--s")
    async with child(writer, "writer", lease_s=1.0) as other:
        subscription = here.create_subscription(IMAGE, "/image", transport="shm")
        message = await subscription.take(60)
        await here.graph.wait_for(lambda: len(here.graph.publishers("/image")) == 2)
        await other.kill()
        await until(lambda: subscription.get_publisher_count() == 0)
        assert message.data.tolist() == [9] * 1000
        assert await here.graph.wait_for(lambda: not here.graph.publishers("/image"), 60)
        assert len(maps("r--s")) == len(before) + 1
        del message
        gc.collect()
        assert len(maps("r--s")) <= len(before)


async def test_a_closed_subscription_gets_nothing_more_but_keeps_what_it_holds(here, until):
    publisher, subscription = await pair(here, here, type_=IMAGE)
    publisher.publish(image(1))
    held = (await subscription.take(60)).data
    subscription.close()
    del subscription
    await until(lambda: publisher.get_subscription_count() == 0)
    other = here.create_subscription(IMAGE, "/t", transport="shm")
    await publisher.wait_for_subscriptions()
    await other.wait_for_publishers()
    for fill in range(2, 20):
        publisher.publish(image(fill))
        await other.take(60)
    assert (held == 1).all()
    del held
    gc.collect()
    await until(lambda: len(publisher._writer._connections) == 1)


async def test_a_loan_is_written_in_place_and_an_exception_publishes_nothing(here):
    publisher, subscription = await pair(here, here)
    cdr = serialize(text("in place"))
    with publisher.loan(len(cdr)) as buffer:
        buffer[:] = cdr
        start = ctypes.addressof(ctypes.c_char.from_buffer(buffer))
    assert any(low <= start < high for low, high in maps("rw-s"))
    assert start % 64 == 60  # so that what follows the CDR header is aligned
    with pytest.raises(KeyError), publisher.loan(100):
        raise KeyError
    publisher.publish(text("next"))
    assert [(await subscription.take(60)).data for _ in range(2)] == ["in place", "next"]
    publisher._writer._collect()
    assert len(publisher._writer._pool._users) < TOGETHER, (
        "let go, but for what is given back together"
    )


async def test_limits_of_size_and_memory_are_errors_that_say_so(here):
    publisher, subscription = await pair(here, here, qos=1, max_message_bytes=4000)
    with pytest.raises(bus.InvalidMessageError, match=r"5009 bytes exceeds.*4000"):
        publisher.publish_raw(bytes(5009))
    with ExitStack() as loans:
        for _ in range(64):
            loans.enter_context(publisher.loan(3000))
        with pytest.raises(bus.PublishError, match=r"hold all \d+ bytes of shared memory"):
            publisher.publish(text("no room"))
        loans.pop_all()  # given up, not published
    gc.collect()
    publisher.publish(text("room"))
    assert (await subscription.take(60)).data == "room"


async def test_a_peer_cannot_write_or_truncate_the_memory_and_nonsense_is_hung_up_on(here):
    publisher, subscription = await pair(here, here)
    for nonsense in (b"x", b"", b"sfgs" + bytes(100)):
        peer = connect(here)
        peer.send(nonsense)
        peer.setblocking(True)
        assert await asyncio.wait_for(asyncio.to_thread(peer.recv, 10), 60) == b""
        peer.close()
    publisher.publish(text("still there"))
    assert (await subscription.take(60)).data == "still there"
    fd = os.open(f"/proc/self/fd/{publisher._writer._arena.reader_fd}", os.O_RDONLY)
    with pytest.raises(PermissionError):
        mmap.mmap(fd, 4096, prot=mmap.PROT_WRITE)
    os.close(fd)
    with pytest.raises(PermissionError):
        os.ftruncate(publisher._writer._arena._fd, 0)


async def test_a_subscriber_that_gives_slots_back_and_ends_while_more_waits_is_no_fault(
    here, until, caplog
):
    publisher = here.create_publisher(STRING, "/t", transport="shm")
    await until(lambda: here.graph.publishers("/t"))
    with connect(here) as peer:
        peer.sendall(wire.pack_hello(wire.Hello(depth=1, wants_history=False)))
        await until(lambda: publisher._writer._fanout.peers)
        for i in range(2 * credits_of(1)):
            publisher.publish(text(i))
        fds = socket.recv_fds(peer, 100, 1)[1]
        arena = publisher._writer._pool.arena_bytes
        told = [wire.unpack_announcement(peer.recv(100), arena)[1] for _ in range(credits_of(1))]
        peer.sendall(wire.pack_returns(told))
    publisher.publish(text("next"))
    assert publisher._writer._fanout.peers == ()
    assert caplog.messages == []
    os.close(*fds)


async def test_silent_connections_end_and_used_up_descriptors_lock_nobody_out(
    here, monkeypatch, until
):
    monkeypatch.setattr(writer, "HELLO_S", 0.2)
    publisher, _ = await pair(here, here)
    silent = [connect(here) for _ in range(20)]
    await until(lambda: len(publisher._writer._connections) > 1)
    await until(lambda: len(publisher._writer._connections) == 1)
    asked, real = [], publisher._writer._listener
    listener = SimpleNamespace(fileno=real.fileno, close=real.close)

    def none_left():
        asked.append(1)
        raise OSError(errno.EMFILE, "none left")

    listener.accept = none_left
    publisher._writer._listener = listener
    silent.append(connect(here))
    await asyncio.sleep(0.5)
    assert len(asked) < 5, "it spins"
    listener.accept = real.accept
    await until(lambda: len(publisher._writer._connections) == 2)
    for peer in silent:
        peer.close()


async def test_a_subscriber_refuses_hostile_datagrams_of_a_publisher(here):
    _, subscription = await pair(here, here)
    (link,) = subscription._reader._links.values()
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    near.setblocking(False)
    asyncio.get_running_loop().remove_reader(link.sock.fileno())
    real, link.sock = link.sock, near
    far.send(b"\xff" * 32)
    subscription._reader._receive(link.gid, link)
    assert subscription.get_publisher_count() == 0
    assert far.recv(10) == b""
    real.close()
    far.close()


async def test_keep_all_loses_nothing_within_the_memory_limit(here):
    publisher, subscription = await pair(here, here, qos=QoSProfile(history=History.KEEP_ALL))
    for number in range(1000):
        publisher.publish(text(number))
    assert [int((await subscription.take(60)).data) for _ in range(1000)] == list(range(1000))
    assert subscription.dropped == 0
