"""The pure parts of the bus: queue, slots, fan-out, datagrams, configuration."""

import asyncio
import time
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.bus.api import entries, user_data
from sfglab.bus.dds.clib import endpoint_qos, profile_from_dds
from sfglab.bus.dds.domain import DomainConfig, domain_xml
from sfglab.bus.endpoints import Inbox, SampleQueue
from sfglab.bus.errors import DomainError
from sfglab.bus.loop import CallbackRunner, LoopBridge
from sfglab.bus.shm import wire
from sfglab.bus.shm.fanout import (
    KEEP_ALL_BYTES,
    MAX_CREDITS,
    Fanout,
    SlotPool,
    credits_of,
    slot_capacity,
)
from sfglab.qos import Durability, History, QoSProfile

ARENA = wire.HEADER_BYTES + 64 * wire.PAGE_BYTES
LAST, ROOM = ARENA - wire.PAGE_BYTES, wire.PAGE_BYTES - wire.DATA_OFFSET_BYTES


def sample(data):
    return (data, 1, 2, bytes(16))


def test_keep_all_is_bounded_by_bytes_and_keeps_at_least_one():
    queue = SampleQueue(QoSProfile(history=History.KEEP_ALL, depth=1), limit_bytes=4 * (1000 + 256))
    queue.push([sample(bytes(1000))] * 10)
    assert (len(queue), queue.dropped) == (4, 6)
    queue.push([sample(bytes(10**6))])
    assert (len(queue), queue.dropped) == (1, 10)


async def test_slow_callbacks_run_one_per_turn_of_the_loop_however_often_it_is_woken():
    bridge, turns, seen = LoopBridge(asyncio.get_running_loop()), 0, []

    def slow(_):
        seen.append(turns)
        time.sleep(0.006)

    calls = CallbackRunner(set(), "slow")
    qos = QoSProfile(depth=20)
    inbox = Inbox(bridge, qos, decode=lambda one: one, callback=slow, calls=calls)
    while len(seen) < 20:
        if turns < 4:
            inbox.push_from_thread([sample(b"")] * 5)
            bridge.flush()
        await asyncio.sleep(0)
        turns += 1
    assert max(Counter(seen).values()) == 1


@given(st.integers(0, 100_000_000))
def test_a_slot_fits_its_message_and_wastes_at_most_a_fifth_or_a_page(size):
    capacity = slot_capacity(size)
    assert capacity % wire.PAGE_BYTES == 0
    assert 0 <= capacity - size - wire.DATA_OFFSET_BYTES < 0.26 * size + wire.PAGE_BYTES


@given(st.lists(st.tuples(st.integers(0, 40_000), st.integers(0, 10))))
def test_slots_in_use_never_overlap_whatever_is_acquired_and_released(steps):
    pool, used = SlotPool(ARENA), {}
    for size, index in steps:
        for offset in sorted(used)[index : index + 1]:
            del used[offset]
            pool.release(offset)
        slot = pool.acquire(size)
        if slot is not None:
            assert slot[0] not in used
            used[slot[0]] = slot[0] + size + wire.DATA_OFFSET_BYTES
        ends = [wire.HEADER_BYTES, *sorted(used.values())]
        assert all(end <= begin for end, begin in zip(ends, [*sorted(used), ARENA], strict=True))


class Subscribers:
    """Subscribers of a fan-out that join it, hold messages and return them, and go."""

    def __init__(self):
        self.pool = SlotPool(wire.HEADER_BYTES + 10_000 * wire.PAGE_BYTES)
        self.fanout = Fanout(self.pool, history=2)
        self.depths, self.held, self.last = {}, {}, {}

    def deliver(self, key, announcements):
        for announcement in announcements:
            assert announcement.sequence > self.last[key]
            assert announcement.offset not in self.held[key]
            self.last[key] = announcement.sequence
            self.held[key].append(announcement.offset)

    def publish(self, number, *_):
        offset, _ = self.pool.acquire(100)
        assert all(offset not in held for held in self.held.values()), "nothing is overwritten"
        announcement = wire.Announcement(number, offset, 100, 0)
        for key in self.fanout.publish(announcement):
            self.deliver(key, [announcement])

    def join(self, key, _, depth, wants_history):
        self.depths[key], self.held[key], self.last[key] = depth, [], 0
        self.deliver(key, self.fanout.join(key, depth, wants_history=wants_history))

    def give_back(self, _, pick, *__):
        for key in [key for key in self.depths if self.held[key]][pick : pick + 1]:
            offset = self.held[key].pop(pick % len(self.held[key]))
            self.deliver(key, self.fanout.returned(key, offset))

    def leave(self, _, pick, *__):
        for key in [*self.depths][pick : pick + 1]:
            del self.depths[key]
            self.fanout.leaving(key)

    def hang_up(self, _, pick, *__):
        for key in [*self.held][pick : pick + 1]:
            self.depths.pop(key, None)
            del self.held[key]
            self.fanout.gone(key)

    def check(self):
        for key, depth in self.depths.items():
            assert len(self.held[key]) <= credits_of(depth) <= MAX_CREDITS
            assert depth == 0 or self.fanout.backlog(key) <= depth
        if all(self.depths.values()):
            # The history, what is held, and backlogs, which are all among the newest three.
            held = sum(map(len, self.held.values()))
            assert len(self.pool._users) <= 2 + held + max(self.depths.values(), default=0)


STEPS = [*["publish"] * 6, *["give_back"] * 3, "join", "join", "leave", "hang_up"]


@given(
    st.lists(
        st.tuples(st.sampled_from(STEPS), st.integers(0, 2), st.integers(0, 3), st.booleans()),
        min_size=40,
        max_size=80,
    )
)
@settings(max_examples=50)
def test_subscribers_get_messages_in_order_and_hold_them_and_all_memory_comes_back(steps):
    subscribers = Subscribers()
    for number, (step, *arguments) in enumerate(steps, start=1):
        getattr(subscribers, step)(number, *arguments)
        subscribers.check()
    for key in subscribers.held:
        subscribers.fanout.gone(key)
    while subscribers.fanout.shed():
        pass
    assert len(subscribers.pool._users) <= 1, "the newest of the history"


def test_hoarders_of_the_largest_messages_leave_room_for_the_others_and_backlogs_are_bounded():
    size = 2**26 - wire.PAGE_BYTES
    pool = SlotPool(wire.HEADER_BYTES + 64 * slot_capacity(size))
    fanout = Fanout(pool, history=0)
    for key, depth in enumerate((0, 0, 64, 10)):  # the last one returns what it gets
        fanout.join(key, depth, wants_history=False)
    for number in range(200):
        while (slot := pool.acquire(size)) is None:
            assert fanout.shed(), "nobody can publish"
        assert 3 in fanout.publish(wire.Announcement(number, slot[0], size, 0))
        assert fanout.returned(3, slot[0]) == []
        assert fanout.backlog(0) * size <= KEEP_ALL_BYTES
    with pytest.raises(KeyError):
        fanout.returned(3, slot[0])  # which it does not hold any more
    fanout.gone(2)
    assert pool.used_bytes <= 3 * KEEP_ALL_BYTES


def test_datagrams_have_this_layout():
    announcement = wire.Announcement(sequence=1, offset=8192, size=100, source_timestamp_ns=-1)
    twin = bytes.fromhex("010000000000000000200000000000006400000000000000ffffffffffffffff")
    assert wire.pack_announcement(announcement) == twin
    assert wire.unpack_announcement(twin, ARENA) == announcement
    hello, twin = wire.Hello(5, wants_history=True), bytes.fromhex("736667730100010005000000")
    assert wire.pack_hello(hello) == twin
    assert wire.unpack_hello(twin) == hello
    welcome = bytes.fromhex("7366677301000000" + "67" * 16)
    assert wire.pack_welcome(b"g" * 16) == welcome
    assert wire.unpack_welcome(welcome) == b"g" * 16
    for count in (1, 3, 8):
        offsets = tuple(range(4096, 4096 * (count + 1), 4096))
        assert wire.unpack_returns(wire.pack_returns(offsets)) == offsets


@pytest.mark.parametrize(
    ("offset", "size", "is_inside"),
    [
        (wire.HEADER_BYTES, 0, True),
        (wire.HEADER_BYTES - wire.PAGE_BYTES, 0, False),
        (wire.HEADER_BYTES + 1, 0, False),
        (LAST, ROOM, True),
        (LAST, ROOM + 1, False),
        (2**64 - wire.PAGE_BYTES, 10, False),
        (wire.HEADER_BYTES, 2**64 - 1, False),
    ],
)
def test_an_announcement_is_refused_exactly_if_it_is_outside_the_arena(offset, size, is_inside):
    announcement = wire.Announcement(1, offset, size, 0)
    datagram = wire.pack_announcement(announcement)
    if is_inside:
        assert wire.unpack_announcement(datagram, ARENA) == announcement
    else:
        with pytest.raises(wire.ProtocolError, match="inside the"):
            wire.unpack_announcement(datagram, ARENA)


def test_user_data_is_read_as_it_is_written_and_strangers_do_not_disturb():
    assert entries(user_data({"enclave": "/", "sfglab.node": "/a"})) == {
        "enclave": "/",
        "sfglab.node": "/a",
    }
    assert entries(b"\xff;;=x;typehash=RIHS01_0=1;") == {"": "x", "typehash": "RIHS01_0=1"}


@pytest.mark.parametrize("history", History)
def test_a_latched_profile_says_what_late_joiners_get_not_what_waits_for_acknowledgement(history):
    latched = QoSProfile(durability=Durability.TRANSIENT_LOCAL, history=history, depth=1)
    with endpoint_qos(latched, unacknowledged=256) as qos:
        assert profile_from_dds(qos) == latched


def test_loopback_gets_large_datagrams_and_real_links_do_not(monkeypatch):
    for name in ("CYCLONEDDS_URI", "ROS_DISTRO", "RMW_IMPLEMENTATION"):
        monkeypatch.delenv(name, raising=False)
    alone = domain_xml(DomainConfig(interface="lo"))
    assert "<MaxMessageSize>65500B</MaxMessageSize>" in alone
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    assert "<MaxMessageSize>14720B</MaxMessageSize>" in domain_xml(DomainConfig(interface="lo"))
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    assert domain_xml(DomainConfig(interface="lo")) == alone
    assert "MessageSize" not in domain_xml(DomainConfig(interface="eth0"))
    monkeypatch.setenv("CYCLONEDDS_URI", "file:///site.xml")
    assert domain_xml(DomainConfig()).startswith("file:///site.xml,<CycloneDDS>")


def test_an_interface_that_is_asked_for_is_the_only_one_whatever_the_environment_says(
    monkeypatch, tmp_path
):
    other, kept = "<NetworkInterface name='eth0'/>", "<DontRoute>true</DontRoute>"
    general = f"<General><Interfaces>{other}</Interfaces>{kept}</General>"
    piece, site = f"<CycloneDDS><Domain>{general}</Domain></CycloneDDS>", tmp_path / "site.xml"
    site.write_text(piece)
    monkeypatch.setenv("CYCLONEDDS_URI", f"{site},{piece} , file://{site}")
    xml = domain_xml(DomainConfig(interface="lo"))
    assert [xml.count(part) for part in ("eth0", kept, "<NetworkInterface ")] == [0, 3, 1]
    assert "eth0" in domain_xml(DomainConfig())
    for broken in ("<CycloneDDS>", str(tmp_path / "missing.xml")):
        monkeypatch.setenv("CYCLONEDDS_URI", broken)
        with pytest.raises(DomainError, match="CYCLONEDDS_URI: given"):
            domain_xml(DomainConfig(interface="lo"))
