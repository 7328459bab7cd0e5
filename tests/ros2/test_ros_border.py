"""The border beside real ROS 2: rclpy on both ends of two routers, each on a host of its own."""

import asyncio
from signal import SIGCONT, SIGSTOP

import numpy as np
import pytest
from beside import ANSWER_S, EMPTY, STRING, agents, asked, component, listen, publish, until

from sfglab.bus import Node
from sfglab.bus.address import BusAddress
from sfglab.fleet.decoder.config import DecoderConfig
from sfglab.messages import default_message, serialize

pytestmark = [pytest.mark.live, pytest.mark.ros, pytest.mark.netns]

IMAGE = "sensor_msgs/msg/Image"
STATE = "/global/go2/state"
MAP = "/global/go2/map"
STREAM = "/global/go2/camera_front/color/ffmpeg"
DECODED = "/local/go2/camera_front/color/image_raw"
NAMELESS = "/".join(2 * ["_CREATED_BY_BARE_DDS_APP_"])
DOMAINS = {"go2": 7, "spot": 8}


def ends(graph, topic):
    return sorted(
        (e["kind"], e["type"], e["durability"], e["node"]) for e in graph["ends"].get(topic, ())
    )


@pytest.mark.feature(
    "On demand, and in the graph before anybody subscribes (what `topic list` reads)",
    condition="agents offer it",
)
@pytest.mark.feature(
    "The node of an endpoint in `topic info -v`",
    cannot={
        "kilted": "its Fast DDS names no node for endpoints of Cyclone DDS; the cause is not known"
    },
)
async def test_what_could_be_had_is_listed_before_anybody_subscribes(network, peer, distribution):
    async with agents(network, peer, DOMAINS, advertise_unused_topics=True) as ros:
        await listed_then_opened(network, ros["go2"], ros["spot"], names=distribution == "jazzy")


async def listed_then_opened(network, go2, spot, *, names):
    await publish(go2, STATE, {})
    await publish(go2, MAP)
    local = BusAddress(domain_id=DOMAINS["spot"], interface="lo")
    config = DecoderConfig(
        remote=local, local=local, streams=(STREAM,), idle_timeout_s=0.1, spare=False
    )
    router, its_decoder = ("/router", "/agent_decoder") if names else 2 * (NAMELESS,)
    listed = {
        STATE: [("PUBLISHER", STRING, "volatile", router)],
        MAP: [("PUBLISHER", STRING, "transient_local", router)],
        DECODED: [("PUBLISHER", IMAGE, "volatile", its_decoder)],
    }
    async with component(network.hosts["spot"], "sfglab.fleet.decoder.node", config) as decoder:

        async def seen():
            graph = await asked(spot, "graph", "graph")
            return {topic: ends(graph, topic) for topic in listed} == listed

        await until(seen)
        graph = await asked(go2, "graph", "graph")
        assert [kind for kind, *_ in ends(graph, STATE) + ends(graph, MAP)] == ["PUBLISHER"] * 2, (
            "read at rest"
        )
        decoder.order(do="tell")
        assert len((await decoder.expect("processes", timeout_s=ANSWER_S))["pids"]) == 0
        for topic, kind in ((STATE, STRING), (DECODED, IMAGE)):
            await listen(spot, topic, {}, kind)
        while (await decoder.expect("status", timeout_s=ANSWER_S))["state"] != "RUNNING":
            pass

        async def heard():
            await publish(go2, STATE, {})
            return (await asked(spot, "count", "counts"))["counts"].get(STATE)

        await until(heard)


LEASE, BY_TOPIC = {"liveliness_lease_duration": 1.0}, {"liveliness": "manual_by_topic"}
LATCHED = {"durability": "transient_local", "depth": 5}
# QoS of the publisher and of the subscription, and how many of eight earlier messages the subscription receives. None:
# it receives no message, and logs the reason.
MATRIX = [
    ({"deadline": 0.5}, {"deadline": 0.1}, None),
    ({"deadline": 0.5}, {"deadline": 1.0}, 0),
    ({}, {"deadline": 1.0}, None),
    ({"lifespan": 0.2}, {}, 0),
    ({}, LEASE, None),
    (LEASE, LEASE, 0),
    (LEASE, {"liveliness_lease_duration": 0.5}, None),
    (LEASE, LEASE | BY_TOPIC, None),
    (LEASE | BY_TOPIC, LEASE | BY_TOPIC, 0),
    (LEASE | BY_TOPIC, LEASE, 0),
    ({"history": "keep_all"}, {"history": "keep_all"}, 0),
    ({"reliability": "best_effort"}, {}, None),
    ({}, LATCHED, None),
    (LATCHED, LATCHED, 5),
    (LATCHED | {"depth": 1}, LATCHED, 1),
    *3 * [(LATCHED, LATCHED, 5)],
]
TOPICS = [f"/global/go2/pair{n}" for n in range(len(MATRIX))]
LEASED = [t for t, (o, _, past) in zip(TOPICS, MATRIX, strict=True) if o | LEASE == o and past == 0]


class Told:
    """QoS events of a node's subscriptions, and how many of their publishers are alive."""

    def __init__(self, process):
        self.refused = set()
        self.alive = {}
        process.on_report = self.hear

    def hear(self, report):
        if report.get("event") == "incompatible_qos":
            self.refused.add(report["topic"])
        elif report.get("event") == "liveliness":
            self.alive[report["topic"]] = report["alive"]


@pytest.mark.feature(
    "Deadline, lifespan, liveliness and history across two routers, as without",
    condition="life asserted without a message does not cross; who joins later behind a router gets one of a "
    "latched past, for Fast DDS does not announce how deep it is",
)
async def test_qos_is_across_two_routers_what_it_is_without(network, peer):
    async with agents(
        network, peer, DOMAINS, ("beside", "go2"), advertise_unused_topics=True
    ) as ros:
        go2, hearers = ros["go2"], (ros["beside"], ros["spot"])
        told = [Told(hearer) for hearer in hearers]
        await everybody_hears(go2, hearers, told)
        go2.signal(SIGSTOP)
        try:
            await until(lambda: all(each.alive == dict.fromkeys(LEASED, 0) for each in told))
        finally:
            go2.signal(SIGCONT)

        async def alive_again():
            for topic in LEASED:
                await publish(go2, topic, {})
            return all(each.alive == dict.fromkeys(LEASED, 1) for each in told)

        await until(alive_again)


async def everybody_hears(go2, hearers, told):
    for topic, (offered, _, _) in zip(TOPICS, MATRIX, strict=True):
        await publish(go2, topic, offered, [EMPTY] * 8)
    past = {
        topic: past for topic, (_, _, past) in zip(TOPICS, MATRIX, strict=True) if past is not None
    }
    for hearer in hearers:
        for topic, (_, requested, _) in zip(TOPICS, MATRIX, strict=True):
            await listen(hearer, topic, requested, quiet=True)

    async def heard():
        return [(await asked(hearer, "count", "counts"))["counts"] for hearer in hearers]

    latched = {topic: count for topic, count in past.items() if count}

    async def all_latched():
        return await heard() == [latched, latched]

    await until(all_latched)

    async def all_heard():
        for topic in TOPICS:
            await publish(go2, topic, {})
        return all(counts.keys() >= past.keys() for counts in await heard())

    await until(all_heard)
    assert [counts.keys() for counts in await heard()] == 2 * [past.keys()]
    refused = set(TOPICS) - past.keys()
    # An event may come after the messages of other topics.
    await until(lambda: all(each.refused >= refused for each in told))
    assert [each.refused for each in told] == 2 * [refused]


# A depth that bridges a busy machine's hiccups: this is about the border.
DEEP, SECONDS, RATE_HZ = {"depth": 1000}, {"jazzy": 10, "kilted": 2}, 100


@pytest.mark.feature("Across two routers: 100 messages a second, none lost", condition="reliable")
async def test_reliable_topics_lose_nothing_across_two_routers(network, peer, distribution):
    async with agents(network, peer, DOMAINS, advertise_unused_topics=True) as ros:
        await all_arrive(ros, STRING, EMPTY, times=RATE_HZ * SECONDS[distribution], rate_hz=RATE_HZ)


IMAGES, IMAGE_BYTES = 60, 640 * 480 * 3


@pytest.mark.feature(
    "Across two routers: 30 images of 921 kB a second, as complete as direct",
    condition="reliable, or `net.core.rmem_default` raised",
)
async def test_images_arrive_across_two_routers(network, peer):
    image = default_message(IMAGE, data=np.zeros(IMAGE_BYTES, np.uint8))
    async with agents(network, peer, DOMAINS, advertise_unused_topics=True) as ros:
        await all_arrive(ros, IMAGE, serialize(image).hex(), times=IMAGES, rate_hz=30)


@pytest.mark.feature("What will never be heard is said, with the node's name: QoS and types")
async def test_a_subscription_says_which_node_it_will_never_hear(peer, domain_id, caplog):
    async with peer("whisperer") as ros, Node("us", domain_id=domain_id) as node:
        await publish(ros, "/x", {"reliability": "best_effort"}, [])
        node.create_subscription(STRING, "/x")
        await until(lambda: "publisher of node '/whisperer': reliability" in caplog.text)


async def all_arrive(ros, kind, cdr, *, times, rate_hz):
    """Send one message after the other until one arrives, then more at a rate, and wait for all of them."""
    go2, spot = ros["go2"], ros["spot"]
    await listen(spot, STATE, DEEP, kind, quiet=True)

    async def heard():
        return (await asked(spot, "count", "counts"))["counts"].get(STATE, 0)

    async def arrived():
        await publish(go2, STATE, DEEP, [cdr], kind)
        for _ in range(20):
            await asyncio.sleep(0.1)
            if await heard():
                return True
        return False

    async def complete():
        return await heard() == goal

    await until(arrived)
    goal = await heard() + times
    go2.order(do="repeat", topic=STATE, cdr=cdr, times=times, rate_hz=rate_hz)
    await until(complete)
