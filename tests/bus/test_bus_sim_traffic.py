"""The bytes that the simulated bus books: as captured of Cyclone DDS, consistent, and beside live hosts."""

import asyncio
import subprocess
import sys
from dataclasses import astuple

import pytest
from bus_messages import SERVICE, STRING, connected, text

from sfglab.bus.api import EndpointInfo, EndpointKind
from sfglab.bus.sim import HostTraffic, KindBytes, LinkModel, run_simulated, wire
from sfglab.lab.hosts import Network
from sfglab.qos import DEFAULT, LATCHED, SENSOR_DATA, History, QoSProfile

USER_DATA = b"enclave=/;sfglab.node=/n0;sfglab.host=9e52ecb2f046d1b4;"
CLIENT = b"clientid=" + b".".join([b"00"] * 16) + b";"
ALL = QoSProfile(history=History.KEEP_ALL)
PUBLISHER, SUBSCRIPTION = EndpointKind.PUBLISHER, EndpointKind.SUBSCRIPTION


@pytest.mark.parametrize(
    ("kind", "dds_topic", "type_", "qos", "data", "captured"),
    [
        (PUBLISHER, "rt/chatter", STRING, DEFAULT, b"", 366),
        (SUBSCRIPTION, "rt/chatter", STRING, DEFAULT, b"", 354),
        (PUBLISHER, "rt/be", STRING, SENSOR_DATA, b"", 378),
        (SUBSCRIPTION, "rt/be", STRING, SENSOR_DATA, b"", 334),
        (PUBLISHER, "rt/global/agent_heartbeat", STRING, LATCHED, b"", 346),
        (SUBSCRIPTION, "rt/global/agent_heartbeat", STRING, LATCHED, b"", 366),
        (PUBLISHER, "rq/global/a/get_metadataRequest", f"{SERVICE}_Request", ALL, CLIENT, 474),
    ],
)
def test_an_announcement_is_as_large_as_captured(kind, dds_topic, type_, qos, data, captured):
    info = EndpointInfo(
        kind=kind, topic="", type=type_, gid=b"", qos=qos, dds_topic=dds_topic, user_data=data
    )
    assert wire.announcement_bytes(wire.submessage_bytes(info)) == captured


def test_other_packets_are_as_large_as_captured():
    assert wire.presentation_bytes(USER_DATA) == 514
    assert wire.announcement_bytes(wire.DISCOVERY_INFO_BYTES) == 454
    assert (wire.HEARTBEAT_BYTES, wire.ACKNACK_BYTES) == (94, 106)
    assert (wire.MATCH_BYTES, wire.LIVELINESS_BYTES) == (110, 158)
    assert (wire.RETRACTION_BYTES, wire.departure_bytes()) == (138, 154)
    assert wire.history_bytes(72) == (218, 110 + 106)
    reliable = {112: 242, 1012: 1142, 1412: 1576, 3012: 3210}
    assert {size: wire.data_bytes(size, reliable=True) for size in reliable} == reliable
    assert wire.data_bytes(72, reliable=False) == 170
    for size, captured in ((20_012, 20_722), (100_012, 103_314)):
        assert wire.data_bytes(size, reliable=True) == pytest.approx(captured, rel=0.005)


async def busy(world):
    """Return the traffic of a run of three hosts, on one of which two nodes are."""
    for name in "abc":
        world.host(name)
    nodes = [world.node(name, host=name[0]) for name in ("a1", "a2", "b1", "c1")]
    publishers = [node.create_publisher(STRING, "/t", LATCHED) for node in nodes]
    readers = [node.create_subscription(STRING, "/t", qos=LATCHED) for node in nodes]
    await publishers[0].wait_for_subscriptions(4)
    for publisher in publishers:
        publisher.publish(text("x" * 100))
    await asyncio.sleep(30)
    readers[0].close()
    await nodes[2].close()
    nodes[3].crash()
    await asyncio.sleep(30)
    return world.traffic()


def total(traffic, way):
    return sum(getattr(t, way).total for t in traffic.values())


def test_without_multicast_all_that_is_sent_is_received_and_with_it_less_is_sent():
    unicast, multicast = run_simulated(busy, multicast=False), run_simulated(busy)
    # What makes a newcomer known goes by multicast even then: SPDP, and heartbeats to all.
    assert total(unicast, "tx") <= total(unicast, "rx") <= 1.3 * total(unicast, "tx")
    assert total(multicast, "tx") < total(unicast, "tx")
    for traffic in (unicast, multicast):
        assert all(
            load >= 0 for t in traffic.values() for way in (t.rx, t.tx) for load in astuple(way)
        )


async def test_nothing_is_booked_within_a_host(sim):
    for reach in ("host", "network"):
        nodes = [sim.node(f"n{i}", host="a", reach=reach) for i in range(2)]
        publisher, _ = await connected(*nodes)
        publisher.publish(text("x"))
        await asyncio.sleep(60)
    traffic = sim.traffic()["a"]
    assert traffic.rx == KindBytes()
    assert (traffic.tx.data, traffic.tx.acks) == (0, 0)


def talking(sim, hosts, **options):
    """A node on each host, all hearing the first one's publisher, which is returned with the nodes."""
    nodes = [sim.node(host, host=host, **options) for host in hosts]
    for node in nodes[1:]:
        node.create_subscription(STRING, "/t", qos=SENSOR_DATA)
    return nodes[0].create_publisher(STRING, "/t", SENSOR_DATA), nodes


async def test_a_sample_for_many_is_sent_once_and_reaches_every_host_once(sim):
    publisher, _ = talking(sim, "abcd")
    await publisher.wait_for_subscriptions(3)
    before = sim.traffic()
    publisher.publish(text("x" * 60))
    after = sim.traffic()
    assert sim.received("b") == after["b"].rx.total
    sent, received = HostTraffic(tx=KindBytes(data=170)), HostTraffic(rx=KindBytes(data=170))
    assert [after[host].since(before[host]) for host in "abcd"] == [
        sent,
        received,
        received,
        received,
    ]


async def test_the_cut_off_receive_nothing(sim):
    publisher, nodes = talking(sim, "abc", lease_s=1000.0)
    await publisher.wait_for_subscriptions(2)
    sim.partition({"c"})
    before = sim.traffic()
    nodes[0].create_publisher(STRING, "/u")
    await asyncio.sleep(100)
    after = sim.traffic()
    assert after["c"].since(before["c"]) == HostTraffic()
    assert after["b"].since(before["b"]).rx.discovery > 300


def test_lost_packets_are_sent_again_and_booked_again():
    def sent(loss):
        async def main(world):
            here, there = (world.node(host, host=host) for host in "ab")
            publisher, _ = await connected(here, there, 1000)
            await asyncio.sleep(100)
            for _ in range(300):
                publisher.publish(text("x" * 60))
            await asyncio.sleep(10)
            return world.traffic()["a"].tx.data

        return run_simulated(main, seed=3, link=LinkModel(loss=loss))

    assert sent(0.0) == 300 * 202
    assert sent(0.1) / sent(0.0) == pytest.approx(1 / 0.9**2, rel=0.1)


# --- Beside live hosts: three start at once with five publishers and five subscriptions each.

COUNT, HOSTS, WINDOW_S = 5, 3, 5.0
NODE = """
import asyncio, sys
from sfglab.bus import Node

async def main():
    print("ready", flush=True)
    input()
    async with Node(sys.argv[1], interface="eth0") as node:
        ends = [node.create_publisher("std_msgs/msg/String", f"/t{i}") for i in range(COUNT)]
        ends += [node.create_subscription("std_msgs/msg/String", f"/t{i}") for i in range(COUNT)]
        await ends[0].wait_for_subscriptions(HOSTS, 30)
        await asyncio.sleep(WINDOW_S)
        print("done", flush=True)
        await asyncio.to_thread(input)

asyncio.run(main())
"""


def live_ingress():
    with Network() as network:
        hosts = [network.add_host(f"h{i}") for i in range(HOSTS)]
        code = (
            NODE.replace("COUNT", str(COUNT))
            .replace("HOSTS", str(HOSTS))
            .replace("WINDOW_S", str(WINDOW_S))
        )
        pipe = subprocess.PIPE
        processes = [
            host.popen([sys.executable, "-c", code, f"n{i}"], stdin=pipe, stdout=pipe, text=True)
            for i, host in enumerate(hosts)
        ]
        for process in processes:
            assert process.stdout.readline() == "ready\n"
        before = [host.interface_bytes().rx_bytes for host in hosts]
        for process in processes:
            process.stdin.write("\n")
            process.stdin.flush()
        for process in processes:
            assert process.stdout.readline() == "done\n"
        received = [
            h.interface_bytes().rx_bytes - earlier for h, earlier in zip(hosts, before, strict=True)
        ]
        for process in processes:
            process.communicate("\n", timeout=60)
        return received


def simulated_ingress():
    async def main(world):
        names = [f"h{i}" for i in range(HOSTS)]
        for name in names:
            world.host(name)
        publishers = []
        for i, name in enumerate(names):
            node = world.node(f"n{i}", host=name)
            publishers += [node.create_publisher(STRING, f"/t{k}") for k in range(COUNT)]
            for k in range(COUNT):
                node.create_subscription(STRING, f"/t{k}")
        await publishers[0].wait_for_subscriptions(HOSTS)
        await asyncio.sleep(WINDOW_S)
        return [world.traffic()[name].rx.total for name in names]

    return run_simulated(main)


@pytest.mark.live
@pytest.mark.netns
@pytest.mark.slow
def test_ingress_is_that_of_live_hosts_within_a_quarter():
    live, simulated = live_ingress(), simulated_ingress()
    assert sum(simulated) == pytest.approx(sum(live), rel=0.25)
