"""The DDS back-end between real processes on the loopback interface."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from sfglab import bus
from sfglab.messages import message_type, serialize
from sfglab.qos import LATCHED, SENSOR_DATA, QoSProfile

pytestmark = pytest.mark.live

STRING = "std_msgs/msg/String"
String = message_type(STRING)
Image = message_type("sensor_msgs/msg/Image")
Header = message_type("std_msgs/msg/Header")
Time = message_type("builtin_interfaces/msg/Time")


def node(domain_id, name="here", **options):
    return bus.Node(name, domain_id=domain_id, interface="lo", **options)


def image(fill):
    data = np.full(640 * 360 * 3, fill, np.uint8)
    header = Header(stamp=Time(sec=1, nanosec=2), frame_id="camera")
    return Image(header=header, height=360, width=640, encoding="rgb8", is_bigendian=0, step=1920, data=data)


def test_a_message_and_its_info_cross_to_another_process_and_back(domain_id, child):
    async def scenario():
        echo = f"""
        async with Node("echo", domain_id={domain_id}, interface="lo") as node:
            out = node.create_publisher(String, "/pong")
            node.create_subscription("{STRING}", "/ping", lambda m: out.publish(String(data=m.data + "!")))
            await out.wait_for_subscriptions()
            say(ready=True)
            await asyncio.to_thread(sys.stdin.readline)
        """
        async with child(echo) as other, node(domain_id) as here:
            pong = here.create_subscription(String, "/pong")
            ping = here.create_publisher(STRING, "ping")
            await other.hear()
            await ping.wait_for_subscriptions()
            await pong.wait_for_publishers()
            ping.publish(String(data="marco"))
            message, info = await pong.take_with_info(60)
            assert message.data == "marco!"
            assert info.source_timestamp_ns <= info.received_timestamp_ns
            assert info.publisher_gid == here.graph.publishers("/pong")[0].gid
            await other.end()

    asyncio.run(scenario())


def test_a_late_joiner_gets_the_latched_message_and_an_image_arrives_whole(domain_id, child):
    async def scenario():
        reader = f"""
        async with Node("late", domain_id={domain_id}, interface="lo") as node:
            sub = node.create_subscription(Image, "/image", qos=LATCHED)
            message = await sub.take(60)
            data = message.data
            say(sum=int(data.sum()), shape=[message.height, message.width], writeable=data.flags.writeable)
        """
        async with node(domain_id) as here:
            publisher = here.create_publisher(Image, "/image", LATCHED)
            publisher.publish(image(1))
            publisher.publish(image(3))
            async with child(reader) as late:
                heard = await late.hear()
        assert heard == {"sum": 3 * 640 * 360 * 3, "shape": [360, 640], "writeable": False}

    asyncio.run(scenario())


def test_a_slow_subscription_drops_the_oldest_and_a_fast_one_gets_all(domain_id, until):
    async def scenario():
        gate = asyncio.Event()
        slow_got = []

        async def slow(message):
            slow_got.append(message.data)
            await gate.wait()

        async with node(domain_id) as here, node(domain_id, "there") as there:
            publisher = here.create_publisher(STRING, "/numbers", 5)
            slow_sub = there.create_subscription(STRING, "/numbers", slow, 5)
            fast_sub = there.create_subscription(STRING, "/numbers", qos=5)
            await publisher.wait_for_subscriptions(2)
            for number in range(40):  # in lock step with the fast one, so only the slow one can drop
                publisher.publish(String(data=str(number)))
                assert (await fast_sub.take(60)).data == str(number)
            await until(lambda: slow_sub.dropped == 40 - 5 - 1)
            gate.set()
            await until(lambda: len(slow_got) == 6)
            assert slow_got[1:] == ["35", "36", "37", "38", "39"]
            assert (slow_sub.dropped, fast_sub.dropped) == (34, 0)

    asyncio.run(scenario())


def test_an_exception_in_a_callback_is_reported_and_stops_nobody(domain_id, until):
    async def scenario():
        reported, received = [], asyncio.Event()

        def bad(message):
            raise LookupError(message.data)

        def on_error(error, where):
            reported.append((type(error), where))

        async with node(domain_id, on_error=on_error) as here:
            publisher = here.create_publisher(STRING, "/t")
            broken = here.create_subscription(STRING, "/t", bad)
            here.create_subscription(STRING, "/t", lambda m: received.set() if m.data == "2" else None)
            await publisher.wait_for_subscriptions(2)
            publisher.publish(String(data="1"))
            publisher.publish(String(data="2"))
            await asyncio.wait_for(received.wait(), 60)
            await until(lambda: len(reported) == 2)
            assert reported == [(LookupError, "subscription '/t'")] * 2
            assert isinstance(broken.last_error, LookupError)

    asyncio.run(scenario())


def test_bytes_that_are_no_message_are_refused_by_name(domain_id):
    async def scenario():
        async with node(domain_id) as here:
            publisher = here.create_publisher(STRING, "/t")
            whole = serialize(String(data="hello"))
            for garbage in (b"", b"\0\1", whole[:9], b"\0\1\0\0\xff\xff\xff\xffabcd"):
                with pytest.raises(bus.InvalidMessageError, match=r"'/t'.*std_msgs/msg/String") as caught:
                    publisher.publish_raw(garbage)
                assert caught.value.size_bytes == len(garbage)
            with pytest.raises(bus.WrongTypeError, match=r"given a std_msgs/msg/Header"):
                publisher.publish(Header(stamp=Time(sec=0, nanosec=0), frame_id=""))

    asyncio.run(scenario())


def test_raw_cdr_passes_unchanged_with_its_source_time_stamp(domain_id):
    async def scenario():
        async with node(domain_id) as here:
            publisher = here.create_publisher(STRING, "/t")
            raw = here.create_subscription(STRING, "/t", raw=True)
            await publisher.wait_for_subscriptions()
            cdr = serialize(String(data="four"))
            for data in (cdr, bytearray(cdr), memoryview(cdr), np.frombuffer(cdr, np.uint8)):
                publisher.publish_raw(data, source_timestamp_ns=1_234_567_890)
                received, info = await raw.take_with_info(60)
                assert received == cdr
                assert info.source_timestamp_ns == 1_234_567_890

    asyncio.run(scenario())


def test_incompatible_qos_does_not_match(domain_id):
    async def scenario():
        async with node(domain_id) as here:
            publisher = here.create_publisher(STRING, "/t", SENSOR_DATA)
            here.create_subscription(STRING, "/t", qos=QoSProfile())
            matching = here.create_subscription(STRING, "/t", qos=SENSOR_DATA)
            await matching.wait_for_publishers()
            assert publisher.get_subscription_count() == 1

    asyncio.run(scenario())


def test_a_wait_that_is_in_vain_says_what_to_check(domain_id):
    async def scenario():
        async with node(domain_id) as here:
            publisher = here.create_publisher(STRING, "/t")
            subscription = here.create_subscription(STRING, "/t")
            await publisher.wait_for_subscriptions()
            with pytest.raises(bus.ReceiveTimeoutError, match=r"'/t'.*0\.01 s; 1 matching"):
                await subscription.take(0.01)
            with pytest.raises(bus.DiscoveryTimeoutError, match=r"3 matching.*found 1"):
                await publisher.wait_for_subscriptions(3, 0.01)

    asyncio.run(scenario())


def test_cancelling_a_take_loses_no_message(domain_id):
    async def scenario():
        async with node(domain_id) as here:
            publisher = here.create_publisher(STRING, "/t", 200)
            subscription = here.create_subscription(STRING, "/t", qos=200)
            await publisher.wait_for_subscriptions()
            got = []
            for number in range(100):
                waiting = asyncio.create_task(subscription.take())
                await asyncio.sleep(0)
                publisher.publish(String(data=str(number)))
                await asyncio.sleep(number % 3 * 1e-4)  # so that it is cancelled before, while and after
                waiting.cancel()
                (result,) = await asyncio.gather(waiting, return_exceptions=True)
                if not isinstance(result, asyncio.CancelledError):
                    got.append(int(result.data))
            while len(got) < 100:
                got.append(int((await subscription.take(60)).data))
            assert got == list(range(100))

    asyncio.run(scenario())


def test_closing_ends_readers_and_further_use_is_an_error(domain_id):
    async def scenario():
        async with node(domain_id) as here:
            publisher = here.create_publisher(STRING, "/t")
            subscription = here.create_subscription(STRING, "/t")
            taking = asyncio.create_task(subscription.take())
            listing = asyncio.create_task(_all(subscription))
            await asyncio.sleep(0)
        with pytest.raises(bus.ClosedError, match=r"subscription '/t' is closed"):
            await taking
        assert await listing == []
        with pytest.raises(bus.ClosedError):
            publisher.publish(String(data=""))
        with pytest.raises(bus.ClosedError, match=r"node 'here' is closed"):
            here.create_timer(1.0, lambda: None)
        await here.close()

    async def _all(subscription):
        return [message async for message in subscription]

    asyncio.run(scenario())


def test_all_data_is_acknowledged_before_a_short_lived_publisher_leaves(domain_id):
    async def scenario():
        async with node(domain_id) as here, node(domain_id, "there") as there:
            subscription = there.create_subscription(STRING, "/t", qos=100)
            publisher = here.create_publisher(STRING, "/t", 100)
            await publisher.wait_for_subscriptions()
            for number in range(100):
                publisher.publish(String(data=str(number)))
            assert await publisher.wait_for_all_acked(60)
            await here.close()
            assert [int((await subscription.take(60)).data) for _ in range(100)] == list(range(100))

    asyncio.run(scenario())
