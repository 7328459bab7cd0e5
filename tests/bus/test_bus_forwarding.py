"""Raw forwarding between nodes: unchanged, by source, in order, held until judged, and nothing leaked."""

import asyncio
import ctypes
import threading
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial
from typing import ClassVar
from unittest.mock import Mock

import psutil
import pytest
from bus_messages import IMAGE, STRING, image, text
from hypothesis import given
from hypothesis import strategies as st
from toy_bus import OtherToyBackend, ToyDomain

from sfglab import bus
from sfglab.bus import forwarding
from sfglab.bus.api import RawEndpoint
from sfglab.bus.dds import endpoints as dds_endpoints
from sfglab.bus.dds import forwarder as dds_forwarder
from sfglab.bus.dds.clib import RETCODE_TIMEOUT, MatchedStatus, library
from sfglab.bus.dds.forwarder import DdsRawWriter
from sfglab.bus.forwarding import HELD_SAMPLES, MAX_BACKLOG_BYTES, GuardedWriter, SourceGate
from sfglab.bus.sim.endpoints import Writer
from sfglab.messages import serialize
from sfglab.qos import LATCHED, SENSOR_DATA, Durability, History, Liveliness, QoSProfile

DEEP = QoSProfile(history=History.KEEP_ALL)
LEASED = QoSProfile(lease_ns=10**9)


def way(near, far, *, type_=STRING, topic="/t", qos=DEEP):
    """A forward of a topic from one node, and a raw writer at the other."""
    end = RawEndpoint(dds_topic=f"rt{topic}", type=type_, qos=qos, user_data=b"k=v;")
    forwarder = near.open_forwarder(far)
    return forwarder.open(end), forwarder.open_writer(end)


async def matched(until, outlet, count=1):
    """Wait until a writer knows its readers, which may know it earlier; earlier samples are lost."""
    status = MatchedStatus()

    def knows():
        library().dds_get_publication_matched_status(outlet._handle, ctypes.byref(status))
        return status.current_count >= count

    if isinstance(outlet, DdsRawWriter):
        await until(knows)


@given(
    st.lists(st.tuples(st.sampled_from("ABC"), st.sampled_from(["take", "open", "shut", "forget"])))
)
def test_samples_of_a_source_keep_their_order_and_none_is_both_sent_and_dropped(steps):
    sent, dropped, taken = [], [], []
    gate = SourceGate(lambda where, sample: sent.append((where, sample)), dropped.append)
    for number, (source, step) in enumerate(steps):
        if step == "take":
            taken.append((number, source))
            gate.take(source, (number, source))
        elif step == "forget":
            gate.forget(source)
        else:
            gate.set_destination(source, f"to {source}" if step == "open" else None)
    gate.close()
    samples = [sample for _, sample in sent]
    assert sorted(samples + dropped) == taken
    assert all(where == f"to {source}" for where, (_, source) in sent)
    assert sorted(samples, key=lambda sample: sample[1]) == sorted(samples, key=lambda s: s[::-1])


def test_what_waits_for_a_judgement_is_bounded_and_the_oldest_goes_first():
    sent, dropped = [], []
    gate = SourceGate(lambda _, sample: sent.append(sample), dropped.append)
    for number in range(HELD_SAMPLES + 3):
        gate.take(b"s", number)
    assert dropped == [0, 1, 2]
    gate.set_destination(b"s", "exit")
    assert sent == list(range(3, HELD_SAMPLES + 3))


class Guarded(GuardedWriter):
    """A writer under the rules, with readers that acknowledge at the test's command."""

    def __init__(self, **qos):
        super().__init__(QoSProfile(depth=100, **qos))
        self.log, self.acknowledged = [], False

    def close(self):
        pass

    def _create(self, qos):
        self.log.append(qos.depth)

    def _delete(self):
        self.log.append("deleted")

    def _has_all_acknowledged(self):
        return self.acknowledged


@pytest.mark.parametrize(
    ("qos", "wanted"),
    [
        ({"lease_ns": 10**9}, ["deleted", 100]),
        ({}, []),
        ({"lease_ns": 10**9, "durability": Durability.TRANSIENT_LOCAL}, []),
        ({"lease_ns": 10**9, "liveliness": Liveliness.MANUAL_BY_TOPIC}, []),
    ],
)
def test_only_a_volatile_writer_with_a_lease_vanishes_with_its_source(qos, wanted):
    writer = Guarded(**qos)
    for alive in (True, False, False, True, True):
        writer.show_life(alive=alive)
    writer.closed = True
    writer.show_life(alive=False)
    assert writer.log == wanted


@pytest.mark.parametrize(
    ("qos", "acknowledged", "wanted"),
    [
        ({}, False, ["deleted", 4]),
        ({}, True, []),
        ({"durability": Durability.TRANSIENT_LOCAL}, False, []),
        ({"history": History.KEEP_ALL}, False, []),
    ],
    ids=["slow", "quick", "latched", "all"],
)
def test_the_history_for_a_reader_that_stands_still_is_bounded_and_for_the_others_kept(
    monkeypatch, qos, acknowledged, wanted
):
    clock = Mock(monotonic=Mock(side_effect=range(1, 99)))
    monkeypatch.setattr(forwarding, "time", clock)
    writer = Guarded(**qos)
    writer.acknowledged = acknowledged
    for _ in range(20):
        writer.bound_backlog(MAX_BACKLOG_BYTES // 4)
    assert writer.log == wanted


def test_a_reader_that_keeps_up_is_not_taken_for_one_that_stands_still(monkeypatch):
    """Readers of Fast DDS acknowledge 5 ms after a sample, so they are asked before the next one."""
    middleware = Mock()

    def forward(*_):
        middleware.dds_wait_for_acks.return_value = RETCODE_TIMEOUT
        return 0

    middleware.dds_forwardcdr = forward
    for module in (dds_endpoints, dds_forwarder):
        monkeypatch.setattr(module, "library", lambda: middleware)
    monkeypatch.setattr(dds_forwarder.clib, "entity_guid", Mock())
    monkeypatch.setattr(dds_forwarder, "sertype_of", Mock())
    monkeypatch.setattr(forwarding, "STANDS_STILL_S", 0.0)
    create = Mock()
    outlet = DdsRawWriter(create, Mock(), QoSProfile(depth=256))
    for _ in range(20):
        middleware.dds_wait_for_acks.return_value = 0
        outlet.hand_on(0, MAX_BACKLOG_BYTES // 4)
    assert create.call_count == 1, "it was not given another history"


@asynccontextmanager
async def between(*makers):
    """Talker and router's node of one backend, router's node and listener of another."""
    names = ("talker", "near", "far", "listener")
    async with AsyncExitStack() as stack:
        yield [
            await stack.enter_async_context(makers[i // 2](name)) for i, name in enumerate(names)
        ]


def toys():
    """Between backends of different kinds, so that samples pass on the loop."""
    return between(ToyDomain().node, partial(ToyDomain().node, kind=OtherToyBackend))


@pytest.fixture
def domain_ids(free_domains):
    """Two domains that no other test uses."""
    return free_domains(2)


@pytest.fixture
def domains(domain_ids):
    """Between two domains of DDS."""
    return between(*(partial(bus.Node, domain_id=n, interface="lo") for n in domain_ids))


ZENOH = [pytest.mark.live, pytest.mark.zenoh]


@pytest.fixture(
    params=[
        "toys",
        *(pytest.param(n, marks=pytest.mark.live) for n in ("in", "out", "domains")),
        *(pytest.param(n, marks=ZENOH) for n in ("zenoh in", "zenoh out")),
    ]
)
def four(request):
    """Between toys, from a toy or to a toy, between two domains of DDS, and between DDS and Zenoh."""
    if request.param == "toys":
        return toys()
    if request.param == "domains":
        return request.getfixturevalue("domains")
    other = request.getfixturevalue("over_zenoh") if "zenoh" in request.param else ToyDomain()
    makers = other.node, request.getfixturevalue("live").node
    return between(*makers[:: -1 if request.param.endswith("in") else 1])


@pytest.mark.parametrize("qos", [QoSProfile(depth=200), DEEP, LATCHED], ids=["last", "all", "kept"])
async def test_bytes_and_source_stamps_pass_unchanged_and_wait_until_their_source_is_judged(
    four, qos, until
):
    async with four as (talker, near, far, listener):
        forward, outlet = way(near, far, qos=qos)
        publisher = talker.create_publisher(STRING, "/t", qos)
        heard = listener.create_subscription(STRING, "/t", qos=qos, raw=True)
        await publisher.wait_for_subscriptions()
        await heard.wait_for_publishers()
        await matched(until, outlet)
        at_once = 1 if qos is LATCHED else 50
        sent = [(serialize(text("x" * n)), 1_000 + n) for n in range(2 * at_once)]
        got = []
        for part in (sent[:at_once], sent[at_once:]):
            for cdr, stamp_ns in part:
                publisher.publish_raw(cdr, source_timestamp_ns=stamp_ns)
            if not got:
                await until(lambda: forward._gate._held)
                forward.admit(publisher.gid, outlet)
            for _ in part:
                cdr, info = await heard.take_with_info(60)
                assert info.publisher_gid == outlet.gid
                got.append((bytes(cdr), info.source_timestamp_ns))
        assert got == sent
        await until(lambda: [e.user_data for e in listener.graph.publishers("/t")] == [b"k=v;"])
        counts = forward.counts  # a sample is counted after it was passed on
        await until(lambda: counts.forwarded >= len(sent))
        assert (counts.forwarded, counts.dropped) == (len(sent), 0)
        assert counts.bytes == sum(len(cdr) + -len(cdr) % 4 for cdr, _ in sent)


class BlockedWriter(Writer):
    """A toy writer that waits for a slow reader in the thread that writes, and refuses a sample."""

    may_block = True
    free: ClassVar = threading.Event()

    def __init__(self, *options):
        super().__init__(*options)
        self.running = asyncio.get_running_loop()

    def write(self, cdr, source_timestamp_ns=None):
        assert threading.current_thread() is not threading.main_thread()
        if b"refused" in bytes(cdr):
            raise ValueError("refused")
        if not self.free.wait(0.01):
            raise bus.errors.WriterBlockedError("/t", code=-10, reason="slow readers")
        self.running.call_soon_threadsafe(super().write, cdr, source_timestamp_ns)


async def test_a_blocked_writer_failing_samples_and_the_source_s_end_cost_no_other_sample(
    monkeypatch, until
):
    def transform(cdr):
        if b"raises" in bytes(cdr):
            raise ValueError("raises")
        return cdr

    async with toys() as (talker, near, far, listener):
        monkeypatch.setattr("sfglab.bus.sim.backend.Writer", BlockedWriter)
        forward, outlet = way(near, far, qos=LEASED)
        monkeypatch.undo()
        heard, publisher = [], talker.create_publisher(STRING, "/t", LEASED)
        ear = listener.create_subscription(STRING, "/t", lambda m: heard.append(m.data), DEEP)
        await publisher.wait_for_subscriptions()
        await ear.wait_for_publishers()
        forward._take((b"", 0, 0, bytes(16)))  # of an unknown publisher
        for word in ("1", "raises", "2", "refused", "3"):
            publisher.publish(text(word))
        await until(lambda: forward._gate._held)
        forward.admit(publisher.gid, outlet, transform)
        await until(lambda: forward.counts.dropped == 2)
        publisher.close()
        assert heard == []
        BlockedWriter.free.set()
        await until(lambda: heard == ["1", "2", "3"] and not outlet._leaving)


@pytest.mark.live
async def test_a_transform_changes_drops_or_leaves_a_sample_and_the_stamp_stays(domains, until):
    changes = {b"b": None, b"c": serialize(text("other")), b"d": b"\0\1\0\0garbage"}
    async with domains as (talker, near, far, listener):
        forward, outlet = way(near, far)
        publisher = talker.create_publisher(STRING, "/t", DEEP)
        heard = listener.create_subscription(STRING, "/t", qos=DEEP)
        await publisher.wait_for_subscriptions()
        await matched(until, outlet)
        forward.admit(publisher.gid, outlet, lambda cdr: changes.get(cdr[8:9], cdr))
        for number, letter in enumerate("abcda"):
            publisher.publish_raw(serialize(text(letter)), source_timestamp_ns=1_000 + number)
        got = [await heard.take_with_info(60) for _ in range(3)]
        assert [(message.data, info.source_timestamp_ns) for message, info in got] == [
            ("a", 1_000),
            ("other", 1_002),
            ("a", 1_004),
        ]
        assert forward.counts.dropped == 2


@pytest.mark.live
async def test_a_reader_that_stands_still_stops_its_sender_costs_no_image_and_holds_up_no_other_topic(
    domains, domain_ids, child, until
):
    count, stopped_at, picture = 150, 0, image(7)
    listening = f"""
    sub = node.create_subscription(Image, "/t", qos=QoSProfile(history=History.KEEP_ALL))
    await sub.wait_for_publishers()
    say(ready=True)
    say(got=[(await sub.take(60)).step for _ in range({count})])
    """
    async with domains as (talker, near, far, listener):
        publishers, ways = [], []
        for topic, type_ in (("/t", IMAGE), ("/fast", STRING)):
            publishers.append(talker.create_publisher(type_, topic, DEEP))
            ways.append(way(near, far, type_=type_, topic=topic))
            ways[-1][0].admit(publishers[-1].gid, ways[-1][1])
            await publishers[-1].wait_for_subscriptions()
        fast = listener.create_subscription(STRING, "/fast")
        await matched(until, ways[1][1])
        # The reader stops for less than its lease; after a longer stop it would be a new reader.
        async with child(listening, "slow", domain_id=domain_ids[1], lease_s=60.0) as slow:
            await slow.hear()
            await matched(until, ways[0][1])
            await slow.stop()
            while picture.step < count + 1920:
                try:
                    publishers[0].publish(picture)
                    picture.step += 1
                except bus.PublishError:
                    stopped_at = stopped_at or picture.step - 1920
                    publishers[1].publish(text("passes"))
                    assert (await fast.take(60)).data == "passes"
                    slow.go_on()
            assert 0 < stopped_at < 140, "96 wait in the reader, and a few elsewhere"
            assert (await slow.hear())["got"] == list(range(1920, 1920 + count))


@pytest.mark.live
async def test_no_sample_is_leaked_whether_forwarded_dropped_held_or_transformed(domains, until):
    cdr, sizes = serialize(text("x" * 1_000_000)), []
    async with domains as (talker, near, far, listener):
        publisher = talker.create_publisher(STRING, "/t", DEEP)
        heard = listener.create_subscription(STRING, "/t", lambda _: None, SENSOR_DATA, raw=True)
        for number in range(12):
            forward, outlet = way(near, far)
            judges = (
                lambda _: None,
                forward.refuse,
                partial(forward.admit, writer=outlet),
                partial(forward.admit, writer=outlet, transform=lambda cdr: bytes(bytearray(cdr))),
            )
            judges[number % 4](publisher.gid)
            await publisher.wait_for_subscriptions()
            for _ in range(30):
                publisher.publish_raw(cdr)
            handle, counts, gate = publisher._writer.handle, forward.counts, forward._gate
            await until(lambda handle=handle: library().dds_wait_for_acks(handle, 0) >= 0)
            await until(lambda g=gate, c=counts: g._held or c.forwarded + c.dropped == 30)
            forward.close()
            outlet.close()
            await until(
                lambda: publisher.get_subscription_count() == heard.get_publisher_count() == 0
            )
            sizes.append(psutil.Process().memory_info().rss)
        assert sizes[11] - sizes[3] < 60e6, "two rounds more forward 240 MB"


@pytest.mark.live
@pytest.mark.slow
async def test_a_reader_that_stands_still_costs_bounded_memory_and_the_others_go_on(
    domains, domain_ids, child, until, monkeypatch
):
    monkeypatch.setattr(forwarding, "MAX_BACKLOG_BYTES", 4 << 20)
    monkeypatch.setattr(forwarding, "STANDS_STILL_S", 0.1)
    listening = """
    sub = node.create_subscription(String, "/t")
    await sub.wait_for_publishers()
    await asyncio.sleep(1000)
    """
    cdr = serialize(text("x" * 1_000_000))
    async with (
        domains as (talker, near, far, listener),
        child(listening, "slow", domain_id=domain_ids[1]) as slow,
    ):
        publisher = talker.create_publisher(STRING, "/t", QoSProfile(depth=4))
        forward, outlet = way(near, far, qos=QoSProfile(depth=256))
        forward.admit(publisher.gid, outlet)
        heard = listener.create_subscription(STRING, "/t", raw=True)
        await publisher.wait_for_subscriptions()
        await matched(until, outlet, count=2)
        await slow.stop()
        before = psutil.Process().memory_info().rss
        for _ in range(80):
            publisher.publish_raw(cdr)
            await asyncio.sleep(0.01)
        assert psutil.Process().memory_info().rss - before < 40e6, "half of what was sent"
        last = cdr[:-2] + b"y\0"
        while await heard.take(60) != last:
            publisher.publish_raw(last)
