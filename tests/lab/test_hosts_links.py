"""Links of test hosts: rate, loss, queue, and what they count."""

from __future__ import annotations

import math
import subprocess
import sys
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.lab.hosts import Link, LinkCounters, Network
from sfglab.lab.hosts.network import FRAME_BYTES

netns = pytest.mark.netns
PYTHON = [sys.executable, "-I", "-S", "-c"]
TIMEOUT_S = 60
HEADERS_BYTES = 14 + 20 + 8  # Ethernet, IPv4, UDP
PAYLOAD_BYTES = 1000  # as in SEND

# Not connected, so that "port unreachable" from a host without a receiver does not cost a datagram.
SEND = """
import socket, sys
sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
for _ in range(int(sys.argv[2])):
    sender.sendto(bytes(1000), (sys.argv[1], 7000))
"""
# Counts until nothing has come for some seconds, or all that is expected.
RECEIVE = """
import socket, sys
receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
receiver.bind(("0.0.0.0", 7000))
print("ready", flush=True)
receiver.settimeout(3.0)
count = 0
try:
    while count < int(sys.argv[1]):
        receiver.recv(65536)
        count += 1
except TimeoutError:
    pass
print(count)
"""


@pytest.fixture(scope="module")
def network():
    with Network(grace_s=0.2) as net:
        net.add_host("edge")
        net.add_host("station")
        yield net


@pytest.fixture(autouse=True)
def _clear_links(request):
    yield
    if "network" in request.fixturenames:
        for name in request.getfixturevalue("network").hosts:
            request.getfixturevalue("network").set_link(name)


def send(network, count):
    done = network.hosts["edge"].run([*PYTHON, SEND, network.hosts["station"].address, str(count)], TIMEOUT_S)
    assert done.returncode == 0, done.stderr


def sent_and_arrived(network, count):
    """Send datagrams and return how many frames left the edge and how many reached the station."""
    edge, station = network.hosts["edge"], network.hosts["station"]
    before = edge.interface_bytes(), station.interface_bytes()
    send(network, count)
    return (
        edge.interface_bytes().tx_packets - before[0].tx_packets,
        station.interface_bytes().rx_packets - before[1].rx_packets,
    )


@netns
@pytest.mark.parametrize("limited", ["edge", "station"])
def test_nothing_passes_faster_than_the_rate_in_both_directions(network, limited):
    rate_bps, count, frame_bytes = 2e6, 150, PAYLOAD_BYTES + HEADERS_BYTES
    network.set_link(limited, rate_bps=rate_bps, queue_bytes=2 * count * FRAME_BYTES)
    station = network.hosts["station"]
    with station.popen([*PYTHON, RECEIVE, str(count)], stdout=subprocess.PIPE, text=True) as receiver:
        assert receiver.stdout.readline() == "ready\n"
        start_s = time.perf_counter()
        send(network, count)
        assert receiver.stdout.readline() == f"{count}\n"
        span_s = time.perf_counter() - start_s
    burst_bytes = Link(rate_bps=rate_bps).burst_bytes
    assert span_s > 8 * (count * frame_bytes - burst_bytes) / rate_bps
    assert span_s < 60 * 8 * count * frame_bytes / rate_bps, "and not at a rate of another order"


@netns
@pytest.mark.parametrize("lossy", ["edge", "station"])
def test_twenty_percent_loss_is_twenty_percent_and_counted(network, lossy):
    count, loss = 4000, 0.2
    network.set_link(lossy, loss=loss)
    sent, arrived = sent_and_arrived(network, count)
    assert count <= sent <= count + 3, "the datagrams, and requests for an address"
    counters = network.link_counters(lossy)
    lost = counters.lost_up_packets if lossy == "edge" else counters.lost_down_packets
    assert lost == sent - arrived
    assert lost == pytest.approx(loss * count, abs=5 * math.sqrt(count * loss * (1 - loss)))
    wire_bytes = counters.lost_up_bytes if lossy == "edge" else counters.lost_down_bytes
    assert wire_bytes == pytest.approx(lost * (PAYLOAD_BYTES + HEADERS_BYTES - 14), abs=3 * FRAME_BYTES)


@netns
def test_a_cleared_link_loses_nothing_and_forgets_its_counters(network):
    network.set_link("station", loss=1.0, rate_bps=1e6)
    _, arrived = sent_and_arrived(network, 50)
    assert arrived == 0
    assert network.link_counters("station").lost_down_packets > 0
    network.set_link("station")
    assert network.link_counters("station") == LinkCounters()
    sent, arrived = sent_and_arrived(network, 500)
    assert arrived == sent >= 500


@netns
def test_a_full_queue_drops_the_tail_and_counts_it(network):
    network.set_link("station", rate_bps=1e5, queue_bytes=5 * FRAME_BYTES)
    sent, _ = sent_and_arrived(network, 100)
    overflow = network.link_counters("station").overflow_down_packets
    # The bucket and the queue take eight frames of this size; the link empties slower than the test sends.
    assert 80 <= overflow <= sent - 8
    network.set_link("station", rate_bps=1e5, queue_bytes=50 * FRAME_BYTES)
    sent_and_arrived(network, 100)
    assert network.link_counters("station").overflow_down_packets < overflow - 30, "a longer queue drops less"


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ({"rate_bps": 0}, "rate_bps"),
        ({"rate_bps": 1e12}, "rate_bps"),
        ({"loss": -0.1}, "loss"),
        ({"loss": 1.1}, "loss"),
        ({"loss": math.nan}, "loss"),
        ({"queue_bytes": 5000}, "queue_bytes"),
        ({"rate_bps": 1e6, "queue_bytes": 100}, "queue_bytes"),
    ],
)
def test_a_link_that_cannot_be_emulated_is_refused_by_name(values, name):
    with pytest.raises(InvalidValueError, match=f"{name}: "):
        Link(**values)


@given(st.floats(1000, 34e9))
def test_every_rate_has_a_bucket_for_two_frames_and_a_queue_for_ten(rate_bps):
    link = Link(rate_bps=rate_bps)
    assert link.burst_bytes >= 2 * FRAME_BYTES
    assert link.limit_bytes >= 10 * FRAME_BYTES
    assert link.limit_bytes == pytest.approx(max(10 * FRAME_BYTES, rate_bps / 80), abs=1)


@given(st.floats(0, 1))
def test_loss_is_kept_to_a_millionth(loss):
    assert Link(loss=loss).loss_per_million == pytest.approx(loss * 1e6, abs=0.5)
