"""Raw forwarding between nodes: unchanged, by source, in order, held until judged, and nothing leaked."""

import asyncio
import ctypes
import threading
import time
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial
from typing import ClassVar

import psutil
import pytest
import toy_bus
from bus_messages import IMAGE, STRING, connected, image, text
from hypothesis import given
from hypothesis import strategies as st
from toy_bus import OtherToyBackend, ToyDomain, ToyWriter

from sfglab import bus
from sfglab.bus import forwarding
from sfglab.bus.api import RawEndpoint
from sfglab.bus.dds import forwarder as dds_forwarder
from sfglab.bus.dds.clib import RETCODE_TIMEOUT, MatchedStatus, library
from sfglab.bus.forwarding import HELD_SAMPLES, MAX_BACKLOG_BYTES, GuardedWriter, SourceGate
from sfglab.messages import serialize
from sfglab.qos import LATCHED, SENSOR_DATA, Durability, History, Liveliness, QoSProfile

DEEP = QoSProfile(history=History.KEEP_ALL)


async def all_acked(publisher, until):
    await until(lambda: library().dds_wait_for_acks(publisher._writer.handle, 0) >= 0)


async def matched(until, *outlets, count=1):
    """Wait until outlets know their readers, which may know them earlier: what is sent before is lost."""

    def readers(outlet):
        status = MatchedStatus()
        library().dds_get_publication_matched_status(outlet._handle, ctypes.byref(status))
        return status.current_count

    for outlet in outlets:
        await until(lambda outlet=outlet: readers(outlet) >= count)


@given(
    st.lists(st.tuples(st.sampled_from("ABC"), st.sampled_from(["take", "open", "shut", "forget"])))
)
def test_samples_of_a_source_keep_their_order_and_none_is_both_sent_and_dropped(steps):
    sent, dropped, taken = [], [], []
    switch = SourceGate(
        lambda destination, sample: sent.append((destination, sample)), dropped.append
    )
    for number, (source, step) in enumerate(steps):
        if step == "take":
            taken.append((source, number))
            switch.take(source.encode(), (source, number))
        elif step == "forget":
            switch.forget(source.encode())
        else:
            switch.set_destination(source.encode(), f"to {source}" if step == "open" else None)
    switch.close()
    samples = [sample for _, sample in sent]
    assert sorted(samples + dropped, key=lambda s: s[1]) == taken
    assert all(destination == f"to {source}" for destination, (source, _) in sent)
    for source in "ABC":
        numbers = [n for s, n in samples if s == source]
        assert numbers == sorted(numbers)


def test_what_waits_for_a_judgement_is_bounded_and_the_oldest_goes_first():
    sent, dropped = [], []
    switch = SourceGate(lambda _, sample: sent.append(sample), dropped.append)
    for number in range(HELD_SAMPLES + 3):
        switch.take(b"s", number)
    assert dropped == [0, 1, 2]
    switch.set_destination(b"s", "exit")
    assert sent == list(range(3, HELD_SAMPLES + 3))


class Guarded(GuardedWriter):
    """A writer under the rules, with readers that acknowledge at the test's command."""

    def __init__(self, qos):
        super().__init__(qos)
        self.log, self.acknowledged = [], False

    def _create(self, qos):
        self.log.append(qos.depth)

    def _delete(self):
        self.log.append("deleted")

    def _has_all_acknowledged(self):
        return self.acknowledged


def test_only_a_volatile_writer_with_a_lease_vanishes_with_its_source():
    lease = {"depth": 5, "lease_ns": 10**9}
    for qos, wanted in (
        (QoSProfile(**lease), ["deleted", 5]),
        (QoSProfile(depth=5), []),
        (QoSProfile(**lease, durability=Durability.TRANSIENT_LOCAL), []),
        (QoSProfile(**lease, liveliness=Liveliness.MANUAL_BY_TOPIC), []),
    ):
        writer = Guarded(qos)
        for alive in (True, False, False, True, True):
            writer.show_life(alive=alive)
        assert writer.log == wanted
        writer.closed = True
        writer.show_life(alive=False)
        assert writer.log == wanted


def test_the_history_for_a_reader_that_stands_still_is_bounded_and_for_the_others_kept(monkeypatch):
    now_s = [1.0]
    monkeypatch.setattr(forwarding.time, "monotonic", lambda: now_s[0])
    size = MAX_BACKLOG_BYTES // 4
    writers = {
        name: Guarded(QoSProfile(depth=100, **qos))
        for name, qos in {
            "slow": {},
            "quick": {},
            "latched": {"durability": Durability.TRANSIENT_LOCAL},
            "all": {"history": History.KEEP_ALL},
        }.items()
    }
    writers["quick"].acknowledged = True
    for _ in range(20):
        now_s[0] += 0.1
        for writer in writers.values():
            writer.bound_backlog(size)
    logs = {name: writer.log for name, writer in writers.items()}
    assert logs == {"slow": ["deleted", 4], "quick": [], "latched": [], "all": []}


@asynccontextmanager
async def between(*makers):
    """Talker and router's node of one backend, router's node and listener of another."""
    names = ("talker", "near", "far", "listener")
    async with AsyncExitStack() as stack:
        yield [
            await stack.enter_async_context(makers[i // 2](name)) for i, name in enumerate(names)
        ]


@pytest.fixture(params=["toys", pytest.param("live", marks=pytest.mark.live)])
def backends(request):
    """Make nodes of a toy backend, and nodes of another: of its kind, or of DDS."""
    toy = ToyDomain().node
    if request.param == "live":
        return toy, request.getfixturevalue("live").node
    return toy, partial(ToyDomain().node, kind=OtherToyBackend)


@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize("qos", [QoSProfile(depth=50), DEEP, LATCHED])
async def test_samples_pass_between_backends_of_different_kinds(backends, qos, back):
    async with between(*backends[:: -1 if back else 1]) as (talker, near, far, listener):
        forwarder = near.open_forwarder(far)
        forward, outlet = (
            forwarder.open(endpoint(qos=qos)),
            forwarder.open_writer(endpoint(qos=qos)),
        )
        publisher = talker.create_publisher(STRING, "/t", qos)
        heard = listener.create_subscription(STRING, "/t", qos=qos, raw=True)
        await publisher.wait_for_subscriptions()
        await heard.wait_for_publishers()
        count = 1 if qos is LATCHED else 50
        cdrs = [serialize(text(str(number))) for number in range(count)]
        for number, cdr in enumerate(cdrs):
            publisher.publish_raw(cdr, source_timestamp_ns=1_000 + number)
        forward.admit(publisher.gid, outlet)
        got = [await heard.take_with_info(60) for _ in cdrs]
        assert [bytes(cdr) for cdr, _ in got] == cdrs
        assert [info.source_timestamp_ns for _, info in got] == [1_000 + n for n in range(count)]
        assert {info.publisher_gid for _, info in got} == {outlet.gid}
        assert (forward.counts.forwarded, forward.counts.dropped) == (count, 0)


class BlockedWriter(ToyWriter):
    """A toy writer that keeps all and waits for a slow reader in the thread that writes."""

    may_block = True
    free = threading.Event()
    threads: ClassVar = set()

    def write(self, cdr, source_timestamp_ns=None):
        self.threads.add(threading.current_thread())
        if not self.free.wait(0.01):
            raise bus.errors.WriterBlockedError("/t", code=-10, reason="slow readers")
        self.backend.loop.call_soon_threadsafe(super().write, cdr, source_timestamp_ns)


async def test_a_blocked_writer_holds_up_its_own_topic_only_and_loses_nothing(monkeypatch, until):
    async with between(ToyDomain().node, partial(ToyDomain().node, kind=OtherToyBackend)) as nodes:
        talker, near, far, listener = nodes
        forwarder, heard, publishers = near.open_forwarder(far), {"t": [], "fast": []}, {}
        for topic, messages in heard.items():
            kind = BlockedWriter if topic == "t" else ToyWriter
            monkeypatch.setattr(toy_bus, "ToyWriter", kind)
            end = endpoint(topic=f"rt/{topic}")
            forward, outlet = forwarder.open(end), forwarder.open_writer(end)
            monkeypatch.undo()
            publishers[topic] = talker.create_publisher(STRING, f"/{topic}", DEEP)
            forward.admit(publishers[topic].gid, outlet)
            listener.create_subscription(STRING, f"/{topic}", messages.append, DEEP)
        for number in range(20):
            for publisher in publishers.values():
                publisher.publish(text(number))
        await until(lambda: len(heard["fast"]) == 20)
        assert heard["t"] == []
        BlockedWriter.free.set()
        await until(lambda: len(heard["t"]) == 20)
        assert [message.data for message in heard["t"]] == [str(number) for number in range(20)]
        assert threading.current_thread() not in BlockedWriter.threads


class RefusingWriter(BlockedWriter):
    """Refuses one sample, as DDS refuses wrong CDR."""

    def write(self, cdr, source_timestamp_ns=None):
        if b"refused" in bytes(cdr):
            raise ValueError("refused")
        super().write(cdr, source_timestamp_ns)


def changed(cdr):
    if b"raises" in bytes(cdr):
        raise ValueError("raises")
    return cdr


async def test_a_sample_that_fails_and_a_source_that_ends_cost_no_other_sample(monkeypatch, until):
    BlockedWriter.free.clear()
    qos = QoSProfile(lease_ns=10**9)
    async with between(ToyDomain().node, partial(ToyDomain().node, kind=OtherToyBackend)) as nodes:
        talker, near, far, listener = nodes
        forwarder, heard = near.open_forwarder(far), []
        monkeypatch.setattr(toy_bus, "ToyWriter", RefusingWriter)
        end = endpoint(qos=qos)
        forward, outlet = forwarder.open(end), forwarder.open_writer(end)
        monkeypatch.undo()
        publisher = talker.create_publisher(STRING, "/t", qos)
        listener.create_subscription(STRING, "/t", heard.append, DEEP)
        await until(lambda: forward._reader)
        words = ("1", "raises", "2", "refused", "3")
        for word in words:
            publisher.publish(text(word))
        forward._take((b"", 0, 0, bytes(16)))  # of an unknown publisher
        assert forward.counts.dropped == 1
        await until(lambda: forward._gate._held)
        forward.admit(publisher.gid, outlet, changed)
        await until(lambda: forward.counts.dropped == 2)
        outlet.show_life(alive=False)
        BlockedWriter.free.set()
        await until(lambda: len(heard) == 3)
        assert [message.data for message in heard] == ["1", "2", "3"]
        await until(lambda: not outlet._leaving)


async def test_a_forwarded_writer_lives_and_dies_with_its_source(until):
    qos = QoSProfile(lease_ns=10**9)
    async with between(ToyDomain().node, partial(ToyDomain().node, kind=OtherToyBackend)) as nodes:
        talker, near, far, listener = nodes
        forwarder = near.open_forwarder(far)
        forward, outlet = (
            forwarder.open(endpoint(qos=qos)),
            forwarder.open_writer(endpoint(qos=qos)),
        )
        publisher = talker.create_publisher(STRING, "/t", qos)
        forward.admit(publisher.gid, outlet)
        await until(lambda: listener.graph.publishers("/t"))
        publisher.close()
        await until(lambda: not listener.graph.publishers("/t"))
        outlet.show_life(alive=True)
        await until(lambda: listener.graph.publishers("/t"))
        outlet.close()
        outlet.close()
        outlet.show_life(alive=True)
        await until(lambda: not listener.graph.publishers("/t"))


@asynccontextmanager
async def two_domains(ids):
    """Talker and router in one domain, router and listener in the other."""
    names = ("talker", "near", "far", "listener")
    nodes = [bus.Node(n, domain_id=ids[i // 2], interface="lo") for i, n in enumerate(names)]
    async with nodes[0], nodes[1], nodes[2], nodes[3]:
        yield nodes


@pytest.fixture
def pair_ids(free_domains):
    """Two domains that nobody else uses."""
    return free_domains(2)


def endpoint(type_=STRING, topic="rt/t", qos=DEEP, user_data=b""):
    return RawEndpoint(dds_topic=topic, type=type_, qos=qos, user_data=user_data)


@pytest.mark.live
async def test_bytes_and_source_stamps_pass_unchanged_and_wait_until_their_source_is_judged(
    pair_ids, until
):
    async with two_domains(pair_ids) as (talker, near, far, listener):
        forwarder = near.open_forwarder(far)
        forward, outlet = (
            forwarder.open(endpoint()),
            forwarder.open_writer(endpoint(user_data=b"k=v;")),
        )
        publisher, subscription = await connected(talker, listener, 200, raw=True)
        await matched(until, outlet)
        cdrs = [serialize(text(str(number) * (number % 9))) for number in range(100)]
        for number, cdr in enumerate(cdrs[:50]):
            publisher.publish_raw(cdr, source_timestamp_ns=1_000 + number)
        await all_acked(publisher, until)
        forward.admit(publisher.gid, outlet)
        for number, cdr in enumerate(cdrs[50:]):
            publisher.publish_raw(cdr, source_timestamp_ns=1_050 + number)
        got = [await subscription.take_with_info(60) for _ in cdrs]
        assert [cdr for cdr, _ in got] == cdrs
        assert [info.source_timestamp_ns for _, info in got] == list(range(1_000, 1_100))
        assert {info.publisher_gid for _, info in got} == {outlet.gid}
        assert listener.graph.publishers("/t")[0].user_data == b"k=v;"
        await until(
            lambda: forward.counts.forwarded >= 100
        )  # a sample is counted after it was passed on
        assert (forward.counts.forwarded, forward.counts.dropped) == (100, 0)
        assert forward.counts.bytes == sum(len(cdr) + -len(cdr) % 4 for cdr in cdrs)


@pytest.mark.live
async def test_each_source_has_its_own_way_and_a_refused_one_none(pair_ids, until):
    async with two_domains(pair_ids) as (talker, near, far, listener):
        latched = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=256)
        publishers = [talker.create_publisher(STRING, "/t", LATCHED) for _ in range(3)]
        for number, publisher in enumerate(publishers):
            publisher.publish(text(number))
        forwarder = near.open_forwarder(far)
        forward = forwarder.open(endpoint(qos=latched))
        outlets = [forwarder.open_writer(endpoint(qos=LATCHED)) for _ in range(2)]
        for publisher, outlet in zip(publishers, outlets, strict=False):
            forward.admit(publisher.gid, outlet)
        forward.refuse(publishers[2].gid)
        await until(lambda: forward.counts.forwarded == 2 and forward.counts.dropped == 1)
        late = listener.create_subscription(STRING, "/t", qos=latched)
        assert sorted([(await late.take(60)).data for _ in range(2)]) == ["0", "1"]
        outlets[0].close()
        await until(lambda: late.get_publisher_count() == 1)
        later = listener.create_subscription(STRING, "/t", qos=latched)
        assert (await later.take(60)).data == "1"
        with pytest.raises(bus.BusTimeoutError):
            await later.take(0.1)


@pytest.mark.live
async def test_a_transform_changes_drops_or_leaves_a_sample_and_the_stamp_stays(pair_ids, until):
    def transform(cdr):
        return {b"a": cdr, b"b": None, b"c": serialize(text("other")), b"d": b"\0\1\0\0garbage"}[
            cdr[8:9]
        ]

    async with two_domains(pair_ids) as (talker, near, far, listener):
        forwarder = near.open_forwarder(far)
        forward, outlet = forwarder.open(endpoint()), forwarder.open_writer(endpoint())
        publisher, subscription = await connected(talker, listener)
        await matched(until, outlet)
        forward.admit(publisher.gid, outlet, transform)
        for number, letter in enumerate("abcda"):
            publisher.publish_raw(serialize(text(letter)), source_timestamp_ns=1_000 + number)
        got = [await subscription.take_with_info(60) for _ in range(3)]
        assert [m.data for m, _ in got] == ["a", "other", "a"]
        assert [info.source_timestamp_ns for _, info in got] == [1_000, 1_002, 1_004]
        await until(
            lambda: forward.counts.forwarded >= 3
        )  # a sample is counted after it was passed on
        assert (forward.counts.forwarded, forward.counts.dropped) == (3, 2)


@pytest.mark.live
async def test_a_reader_that_stands_still_stops_its_sender_costs_no_image_and_holds_up_no_other_topic(
    pair_ids, child, until
):
    count = 150
    listening = f"""
    sub = node.create_subscription(Image, "/t", qos=QoSProfile(history=History.KEEP_ALL))
    await sub.wait_for_publishers()
    say(ready=True)
    say(got=[(await sub.take(60)).step for _ in range({count})])
    """
    picture = image(7)
    async with two_domains(pair_ids) as (talker, near, far, listener):
        forwarder, ways = near.open_forwarder(far), []
        for topic, type_, qos in (("/t", IMAGE, DEEP), ("/fast", STRING, QoSProfile())):
            publisher, end = (
                talker.create_publisher(type_, topic, qos),
                endpoint(type_, f"rt{topic}", qos),
            )
            forward, outlet = forwarder.open(end), forwarder.open_writer(end)
            forward.admit(publisher.gid, outlet)
            await publisher.wait_for_subscriptions()
            ways.append((publisher, forward, outlet))
        (publisher, forward, deep), (other, _, beside) = ways
        fast = listener.create_subscription(STRING, "/fast")
        await matched(until, beside)
        # Stands still for less than its lease: who is gone for longer has no claim to what it missed.
        async with child(listening, "slow", domain_id=pair_ids[1], lease_s=60.0) as slow:
            await slow.hear()
            await matched(until, deep)
            await slow.stop()
            stopped_at = 0
            for picture.step in range(count):
                while True:
                    try:
                        publisher.publish(picture)
                        break
                    except bus.PublishError:
                        stopped_at = stopped_at or picture.step
                        other.publish(text("passes"))
                        assert (await fast.take(60)).data == "passes"
                        slow.go_on()
            assert 0 < stopped_at < 140, "96 wait in the reader, and a few elsewhere"
            assert (await slow.hear())["got"] == list(range(count))
            await until(lambda: forward.counts.forwarded == count)
            assert forward.counts.dropped == 0


@pytest.mark.live
async def test_no_sample_is_leaked_whether_forwarded_dropped_held_or_transformed(pair_ids, until):
    cdr = serialize(text("x" * 1_000_000))

    def copied(cdr):
        return bytes(bytearray(cdr))

    async with two_domains(pair_ids) as (talker, near, far, listener):
        publisher = talker.create_publisher(STRING, "/t", DEEP)
        forwarder = near.open_forwarder(far)
        outlet = forwarder.open_writer(endpoint(qos=SENSOR_DATA))
        listener.create_subscription(STRING, "/t", lambda _: None, SENSOR_DATA, raw=True)
        sizes = []
        for _ in range(3):
            for judge in ("hold", "admit", "refuse", "transform"):
                forward = forwarder.open(endpoint())
                if judge == "refuse":
                    forward.refuse(publisher.gid)
                elif judge != "hold":
                    forward.admit(publisher.gid, outlet, copied if judge == "transform" else None)
                await publisher.wait_for_subscriptions()
                for _ in range(30):
                    publisher.publish_raw(cdr)
                await all_acked(publisher, until)
                counts = forward.counts
                if judge != "hold":
                    await until(lambda c=counts: c.forwarded + c.dropped == 30)
                forward.close()
                await until(lambda: publisher.get_subscription_count() == 0)
            sizes.append(psutil.Process().memory_info().rss)
        assert sizes[2] - sizes[0] < 60e6, "two rounds more forward 240 MB"


@asynccontextmanager
async def forwarded(pair_ids, heard):
    """A publisher of a topic that is forwarded to a listener, and the writer that does so."""
    async with two_domains(pair_ids) as (talker, near, far, listener):
        publisher = talker.create_publisher(STRING, "/t", QoSProfile(depth=4))
        forwarder = near.open_forwarder(far)
        outlet = forwarder.open_writer(endpoint(qos=QoSProfile(depth=256)))
        forwarder.open(endpoint()).admit(publisher.gid, outlet)
        listener.create_subscription(STRING, "/t", lambda _: heard.append(1), raw=True)
        await publisher.wait_for_subscriptions()
        yield publisher, outlet


@pytest.mark.live
async def test_a_reader_that_stands_still_costs_bounded_memory_and_the_others_go_on(
    pair_ids, child, until
):
    listening = """
    sub = node.create_subscription(String, "/t")
    await sub.wait_for_publishers()
    say(ready=True)
    await asyncio.sleep(1000)
    """
    heard, cdr = [], serialize(text("x" * 2_000_000))
    async with (
        forwarded(pair_ids, heard) as (publisher, outlet),
        child(listening, "slow", domain_id=pair_ids[1]) as other,
    ):
        await other.hear()
        await matched(until, outlet, count=2)
        await other.stop()
        before = psutil.Process().memory_info().rss
        for _ in range(200):  # 400 MB
            publisher.publish_raw(cdr)
            await asyncio.sleep(0.02)
        assert psutil.Process().memory_info().rss - before < 250e6
        count = len(heard)
        publisher.publish_raw(cdr)
        await until(lambda: len(heard) > count)


class LateAcknowledgements:
    """Cyclone DDS beside readers that acknowledge after 5 ms, as Fast DDS's do (heartbeatResponseDelay)."""

    def __init__(self):
        self.sent_s = 0.0

    def __getattr__(self, name):
        return getattr(library(), name)

    def dds_forwardcdr(self, *arguments):
        self.sent_s = time.monotonic()
        return library().dds_forwardcdr(*arguments)

    def dds_wait_for_acks(self, *arguments):
        late = time.monotonic() - self.sent_s < 0.005
        return RETCODE_TIMEOUT if late else library().dds_wait_for_acks(*arguments)


@pytest.mark.live
async def test_a_reader_that_keeps_up_is_not_taken_for_one_that_stands_still(
    pair_ids, until, monkeypatch
):
    middleware = LateAcknowledgements()
    monkeypatch.setattr(dds_forwarder, "library", lambda: middleware)
    monkeypatch.setattr(forwarding, "MAX_BACKLOG_BYTES", 200_000)
    monkeypatch.setattr(forwarding, "STANDS_STILL_S", 0.2)
    heard, cdr = [], serialize(text("x" * 50_000))
    async with forwarded(pair_ids, heard) as (publisher, outlet):
        await matched(until, outlet)
        gid, handle = outlet.gid, outlet._handle
        for number in range(1, 21):
            publisher.publish_raw(cdr)
            await until(lambda number=number: len(heard) >= number)
            await until(lambda: library().dds_wait_for_acks(handle, 0) >= 0)
            await asyncio.sleep(0.02)
        assert (outlet.gid, outlet._handle) == (gid, handle), "it was not given another history"


@pytest.mark.live
async def test_both_ways_at_once_there_is_no_echo(pair_ids, until):
    async with two_domains(pair_ids) as (talker, near, far, listener):
        out, back = near.open_forwarder(far), far.open_forwarder(near)
        outward, inward = out.open(endpoint()), back.open(endpoint())
        outlets = out.open_writer(endpoint()), back.open_writer(endpoint())
        publisher = talker.create_publisher(STRING, "/t")
        own, other = (n.create_subscription(STRING, "/t") for n in (talker, listener))
        outward.admit(publisher.gid, outlets[0])
        inward.admit(outlets[0].gid, outlets[1])
        outward.admit(outlets[1].gid, outlets[0])
        await publisher.wait_for_subscriptions(2)
        await matched(until, outlets[0])
        publisher.publish(text("x"))
        assert (await other.take(60)).data == "x"
        assert (await own.take(60)).data == "x"
        publisher.publish(text("y"))
        assert (await other.take(60)).data == (await own.take(60)).data == "y"
        assert inward.counts.forwarded == inward.counts.dropped == 0
