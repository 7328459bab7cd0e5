"""Frames between test hosts: over the Ethernet, DDS over the radio, and the radio itself, pure and live."""

import math
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import replace
from random import Random
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.lab.hosts import HostsError, Network, radio_relay
from sfglab.lab.hosts.radio import RadioCounters
from sfglab.lab.hosts.radio_relay import Air, Relay
from sfglab.qos import QoSProfile, Reliability
from sfglab.rtps import Flow, Medium, Scenario, run

netns = pytest.mark.netns
PYTHON = [sys.executable, "-I", "-S", "-c"]
TIMEOUT_S = 60
HEADERS_BYTES = 14 + 20 + 8  # Ethernet, IPv4, UDP
PAYLOAD_BYTES = 1000  # as in SEND
MODEL_BYTES = HEADERS_BYTES + 20 + 12 + 24  # what a DATA frame of the model has beside its payload
QUIET = Medium(rate_bps=1e9, loss=0.0, overhead_s=0.0, contention=0.0)

# Not connected, so that "port unreachable" from a host without a receiver does not cost a datagram.
SEND = """
import socket, sys
sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
for _ in range(int(sys.argv[2])):
    sender.sendto(bytes(1000), (sys.argv[1], 7000))
"""
# Counts until nothing has come for some seconds, or all that is expected; joins a group.
RECEIVE = """
import socket, struct, sys
receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
receiver.bind(("0.0.0.0", 7000))
group = struct.pack("4s4s", socket.inet_aton("239.1.2.3"), socket.inet_aton("0.0.0.0"))
receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
print("ready", flush=True)
count = 0
receiver.settimeout(3.0)
try:
    while count < int(sys.argv[1]):
        receiver.recv(65536)
        count += 1
except TimeoutError:
    pass
print(count)
"""


@pytest.fixture(scope="module")
def hosts():
    with Network(grace_s=0.2) as net:
        net.add_host("robot")
        # Later bursts must not wait for the address, for which the kernel's patience is short.
        assert received(net, [net.add_host("station")], net.hosts["station"].address, 1)[0] == [1]
        yield net


@pytest.fixture(scope="module")
def radio():
    with Network(grace_s=0.2) as net:
        for name in ("robot", "station", "bystander"):
            net.add_host(name)
        net.set_radio(QUIET)
        yield net


@pytest.fixture
def network(radio):
    """The network of all tests of the radio, with a medium that loses nothing."""
    radio.set_radio(QUIET)
    return radio


def send(network, target, count):
    done = network.hosts["robot"].run([*PYTHON, SEND, target, str(count)], TIMEOUT_S)
    assert done.returncode == 0, done.stderr


def received(network, hosts, target, count):
    """Send datagrams from the robot; return how many each host got, and how long it took."""
    with ExitStack() as ending:
        command = [*PYTHON, RECEIVE, str(count)]
        pipe = {"stdout": subprocess.PIPE, "text": True}
        receivers = [ending.enter_context(host.popen(command, **pipe)) for host in hosts]
        assert [r.stdout.readline() for r in receivers] == ["ready\n"] * len(hosts)
        start_s = time.perf_counter()
        send(network, target, count)
        return [int(r.stdout.readline()) for r in receivers], time.perf_counter() - start_s


@netns
@pytest.mark.parametrize("cut", ["robot", "station"])
def test_a_disconnected_host_loses_all_frames_and_a_connected_one_none(hosts, cut):
    robot, station = hosts.hosts.values()
    for is_connected in (False, True):
        hosts.set_connected(cut, connected=is_connected)
        before = robot.interface_bytes().tx_packets, station.interface_bytes().rx_packets
        send(hosts, station.address, 500)
        sent = robot.interface_bytes().tx_packets - before[0]
        assert sent >= 500
        assert station.interface_bytes().rx_packets - before[1] == is_connected * sent


# --- DDS ------------------------------------------------------------------------------------------------------

NOTES = """
import asyncio, sys
from sfglab.bus import Node
from sfglab.messages import message_type
from sfglab.qos import Durability, History, QoSProfile

async def main(name):
    async with Node(name, domain_id=7, interface="eth0") as node:
        qos = QoSProfile(history=History.KEEP_ALL, durability=Durability.TRANSIENT_LOCAL)
        if name == "reader":
            subscription = node.create_subscription("std_msgs/msg/String", "/notes", qos=qos)
            print(*[(await subscription.take(timeout_s=30.0)).data for _ in range(20)])
            return
        publisher = node.create_publisher("std_msgs/msg/String", "/notes", qos)
        for number in range(20):
            publisher.publish(message_type("std_msgs/msg/String")(data=f"hello{number}"))
        print("ready", flush=True)
        await asyncio.to_thread(input)

asyncio.run(main(sys.argv[1]))
"""


@netns
@pytest.mark.live
def test_a_reliable_writer_reaches_a_reader_on_another_host_over_a_radio_that_loses(network):
    """They find each other by multicast, as on a real network."""
    network.set_radio(replace(QUIET, loss=0.3))
    command = [sys.executable, "-c", NOTES]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with network.hosts["robot"].popen([*command, "writer"], text=True, **pipes) as writer:
        assert writer.stdout.readline() == "ready\n"
        done = network.hosts["station"].run([*command, "reader"], TIMEOUT_S)
        writer.communicate("\n", timeout=TIMEOUT_S)
    assert done.stdout.split() == [f"hello{number}" for number in range(20)], done.stderr
    assert network.radio_counters().lost > 0


# --- The radio: its medium, pure ------------------------------------------------------------------------------


def arrivals_of(air: Air, offers) -> list[tuple[int, int]]:
    """Return when the frames arrive that are offered as (time, host, frame number, size)."""
    arrived = []
    for t_ns, host, frame, size_bytes in sorted(offers):
        arrived += air.advance(t_ns)
        air.offer(host, frame, size_bytes=size_bytes, now_ns=t_ns)
    while (next_ns := air.next_ns()) is not None:
        arrived += air.advance(next_ns)
    return [(sent.frame, sent.due_ns) for sent in arrived]


@settings(max_examples=40, deadline=None)
@given(
    access_point=st.booleans(),
    rates=st.lists(st.sampled_from([90.0, 170.0, 410.0, 730.0]), min_size=2, max_size=4),
    latency_s=st.sampled_from([0.0, 0.003]),
    queue_frames=st.sampled_from([1, 3, 200]),
    queue_rule=st.sampled_from(["tail", "head"]),
    stall_s=st.sampled_from([0.0, 0.02]),
)
def test_the_radio_delivers_each_frame_when_the_model_does(rates, **given):
    medium = Medium(rate_bps=3e6, loss=0.0, overhead_s=4e-4, stall_every_s=0.1, **given)
    qos = QoSProfile(reliability=Reliability.BEST_EFFORT, depth=1000)
    sent = {"target": "sink", "qos": qos, "executor": None}
    flows = tuple(
        Flow(name=f"f{i}", source=f"h{i}", rate_hz=rate, phase_s=1.37e-4 * (i + 1), size_bytes=40 * (i + 1), **sent)
        for i, rate in enumerate(rates)
    )  # fmt: skip
    outcome = run(Scenario(flows=flows, medium=medium, duration_s=0.5, drain_s=5.0), seed=1)
    offers, expected = [], {}
    hosts = ["h0", "sink", *(f"h{i}" for i in range(1, len(rates)))]  # in the model's order
    for i, flow in enumerate(flows):
        fate, size_bytes = outcome.flows[flow.name], MODEL_BYTES + flow.size_bytes
        for k, t_ns in enumerate(fate.published_ns):
            offers.append((int(t_ns), hosts.index(flow.source), (i, k), size_bytes))
            if fate.delivered[k]:
                expected[i, k] = int(fate.received_ns[k])
    air = Air(len(hosts), medium)
    assert dict(arrivals_of(air, offers)) == expected
    assert air.counters.airtime_ns == outcome.counts["airtime_ns"]
    assert air.counters.queue_full == outcome.counts["queue_full"]


@pytest.mark.parametrize("random_turns", [False, True])
def test_chance_lets_every_host_through_a_full_access_point_where_turns_let_one(random_turns):
    """As in the model: tests/rtps/test_channel.py."""
    medium = Medium(access_point=True, queue_frames=50, random_turns=random_turns, loss=0.0)
    air = Air(4, medium, chance=Random(1))
    offers = [
        (500_000 * k + host, host, host, MODEL_BYTES + 24) for k in range(6000) for host in range(3)
    ]
    arrived = [host for host, due_ns in arrivals_of(air, offers) if due_ns < 3e9]
    assert (min(map(arrived.count, range(3))) > 0.1 * len(arrived)) is random_turns


def test_a_late_look_lowers_no_rate_and_a_change_keeps_frames():
    air = Air(1, Medium(rate_bps=8e6, overhead_s=0.0, contention=0.0))
    for k in range(10):
        air.offer(0, k, size_bytes=1000, now_ns=0)
    due_ms = [sent.due_ns / 1e6 for sent in air.advance(10_000_000)]
    assert due_ms == [*range(1, 11)]
    air = Air(2, Medium(queue_frames=5))
    for k in range(3):
        air.offer(0, k, size_bytes=100, now_ns=0)
    air.change(Medium(queue_frames=1, overhead_s=0.0))
    assert [frame for frame, _ in arrivals_of(air, [])] == [0, 1, 2]


def test_a_frame_that_the_access_point_does_not_get_is_counted_and_not_sent_again():
    air = Air(2, Medium(access_point=True), lose=lambda host: host == 0)
    for host in range(2):
        air.offer(host, f"of {host}", size_bytes=100, now_ns=0)
    assert [frame for frame, _ in arrivals_of(air, [])] == ["of 1"]
    assert (air.counters.lost, air.counters.frames) == (1, 3)


def test_a_frame_arrives_at_its_time_also_if_an_earlier_one_has_a_longer_latency():
    air = Air(1, Medium(latency_s=0.1))
    air.offer(0, "slow", size_bytes=100, now_ns=0)
    air.advance(10_000_000)
    air.change(Medium())
    air.offer(0, "fast", size_bytes=100, now_ns=10_000_000)
    assert [sent.frame for sent in air.advance(50_000_000)] == ["fast"]
    assert air.next_ns() > 100_000_000, "nothing is due before the slow frame"
    assert [frame for frame, _ in arrivals_of(air, [])] == ["slow"]


def test_a_radio_that_did_not_keep_up_says_so():
    counted = [{"late": 10}, {"late": 11}, {"overrun": 1}]
    kept_up = [RadioCounters(delivered=1000, **counts).kept_up for counts in counted]
    assert kept_up == [True, False, False]
    assert "11 of them more than 2 ms late" in RadioCounters(delivered=9, late=11).said()


class Cable:
    """A host's cable with these frames of the host; a full one takes no frame."""

    def __init__(self, frames=(), *, full=False):
        self._frames = list(frames)
        self._full = full

    def recvmsg(self, *_):
        if not self._frames:
            raise BlockingIOError
        return self._frames.pop(), [(0, 0, bytes(16))], 0, None

    def send(self, _frame):
        if self._full:
            raise BlockingIOError

    def getsockopt(self, *_):
        return bytes(8)


def test_a_frame_that_a_host_does_not_take_is_an_overrun_and_not_delivered(monkeypatch):
    cables = {"sender": Cable([b"\xff" * 60]), "full": Cable(full=True), "ready": Cable()}
    monkeypatch.setattr(radio_relay, "_open", cables.get)
    monkeypatch.setattr(radio_relay.gc, "freeze", lambda: None)
    monkeypatch.setattr(radio_relay.ctypes, "CDLL", lambda _: SimpleNamespace(prctl=max))
    ports = {name: SimpleNamespace(outer=name, mac="02:00") for name in cables}
    relay = Relay(ports, QUIET)
    relay.relay(cables.values())
    counters = relay.counters()
    assert (counters.frames, counters.overrun, counters.delivered) == (1, 1, 1)


# --- The radio, live ------------------------------------------------------------------------------------------


@netns
@pytest.mark.parametrize("queue_frames", [50, 2000])
def test_frames_pass_at_the_rate_of_the_medium_and_a_full_queue_drops_and_counts(
    network, queue_frames
):
    medium = Medium(loss=0.0, contention=0.0, queue_frames=queue_frames)
    network.set_radio(medium)
    station = network.hosts["station"]
    [count], span_s = received(network, [station], station.address, 800)
    airtime_s = medium.overhead_s + (1000 + HEADERS_BYTES) * 8 / medium.rate_bps
    counters = network.radio_counters()
    # How much longer it takes, and whether the relay takes every frame, depends on the machine's other work.
    assert (counters.queue_full > 100) == (queue_frames < 800)
    assert count + counters.queue_full + counters.overrun == 800
    assert span_s > count * airtime_s
    surplus_s = counters.airtime_ns / 1e9 - count * airtime_s
    assert -0.001 * span_s < surplus_s < 5 * airtime_s, "a few frames of address resolution"


@netns
def test_a_group_is_sent_once_and_each_receiver_loses_by_itself(network):
    network.set_radio(Medium(rate_bps=1e9, overhead_s=0.0, loss=0.2, queue_frames=3000), seed=4)
    receivers = [network.hosts[name] for name in ("station", "bystander")]
    counts, _ = received(network, receivers, "239.1.2.3", 2000)
    counters = network.radio_counters()
    assert 2000 <= counters.frames <= 2010, "the datagrams, and the group's management"
    bound = 5 * math.sqrt(2000 * 0.2 * 0.8)
    assert np.allclose(counts, 1600, atol=bound)
    assert counts[0] != counts[1], "losses are drawn for each receiver"
    assert counters.lost == pytest.approx(2 * 2000 - sum(counts), abs=10)


@netns
def test_a_radio_takes_no_more_hosts_and_an_ethernet_has_no_counters(hosts, network):
    with pytest.raises(HostsError, match="radio"):
        network.set_connected("robot", connected=False)
    with pytest.raises(HostsError, match="radio"):
        network.add_host("late")
    with pytest.raises(HostsError, match="no radio"):
        hosts.radio_counters()
