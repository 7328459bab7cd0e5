"""Hosts on one machine: what they share, what they do not, and how processes are started in them."""

import os
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager, suppress
from functools import partial
from unittest.mock import Mock

import numpy as np
import pytest

from sfglab.errors import InvalidValueError
from sfglab.lab.hosts import HostsError, HostsUnavailableError, Network
from sfglab.rtps import Medium

pytestmark = pytest.mark.netns
PYTHON = [sys.executable, "-I", "-S", "-c"]
TIMEOUT_S = 60
NOBODY = 65534

# It says one line when it listens, so that no test waits for a guessed time.
SERVER = """
import socket, sys
server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
server.bind((sys.argv[1], 7000))
print("ready", flush=True)
while True:
    data, peer = server.recvfrom(65536)
    server.sendto(data, peer)
"""
CLIENT = """
import errno, socket, sys
client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
client.settimeout(float(sys.argv[2]))
try:
    client.connect((sys.argv[1], 7000))
    for size in map(int, sys.argv[3:]):
        client.send(bytes(size))
        print(len(client.recv(65536)))
except OSError as error:
    print(errno.errorcode.get(error.errno, error))
"""


@pytest.fixture(scope="module")
def network():
    """Three hosts for all tests that do not need a network of their own."""
    with Network(grace_s=0.2) as net:
        for name in ("edge", "station", "idle"):
            net.add_host(name)
        yield net


@pytest.fixture
def edge(network):
    return network.hosts["edge"]


@pytest.fixture
def station(network):
    return network.hosts["station"]


@contextmanager
def serving(host, code, *arguments):
    command = [*PYTHON, code, *arguments]
    with host.popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "ready\n"
        yield process
        process.kill()


def say(host, code, *arguments):
    done = host.run([*PYTHON, code, *map(str, arguments)], TIMEOUT_S)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_datagrams_reach_the_other_host_and_nobody_elses_loopback_nor_the_outside(edge, station):
    with serving(station, SERVER, station.address), serving(edge, SERVER, "127.0.0.1"):
        # Small, large and fragmented.
        assert say(edge, CLIENT, station.address, 30, 1, 1472, 20000) == ["1", "1472", "20000"]
        assert say(edge, CLIENT, "127.0.0.1", 30, 3) == ["3"]
        assert say(station, CLIENT, "127.0.0.1", 5, 3) == ["ECONNREFUSED"]
        assert say(station, CLIENT, edge.address, 5, 3) == ["ECONNREFUSED"], (
            "it listens on its loopback only"
        )
        outside = subprocess.run(
            [*PYTHON, CLIENT, "127.0.0.1", "1", "3"], stdout=subprocess.PIPE, check=True
        )
        assert outside.stdout != b"3\n"
    assert say(edge, CLIENT, "192.0.2.1", 5, 3) == ["ENETUNREACH"], "there is no way out"


def test_interface_counters_equal_the_bytes_received():
    with Network() as net:  # of its own: no other process sends
        hosts = station, edge, _ = [net.add_host(name) for name in ("station", "edge", "idle")]
        with serving(station, SERVER, station.address):
            say(edge, CLIENT, station.address, 30, 1)  # resolves addresses
            before = np.array([host.interface_bytes() for host in hosts])
            say(edge, CLIENT, station.address, 30, *[100] * 50, *[1000] * 50)
            grown = np.array([host.interface_bytes() for host in hosts]) - before
    wire = 50 * (100 + 1000) + 100 * (8 + 20 + 14)  # UDP, IPv4 and Ethernet headers
    arp = 42  # an address may be checked again meanwhile
    assert all(wire <= received <= wire + 2 * arp for received in grown[:2, 0])
    assert not grown[2].any(), (
        "what is sent to one host does not reach a third, and hosts are silent"
    )


def test_tcp_goes_over_the_wire_in_frames_of_the_network(edge, station):
    receive = (
        "import socket, sys; server = socket.create_server((sys.argv[1], 7001)); print('ready', flush=True)\n"
        "peer, _ = server.accept()\nwhile peer.recv(65536): pass"
    )
    send = "import socket, sys; socket.create_connection((sys.argv[1], 7001), 5).sendall(bytes(1448000))"
    before = station.interface_bytes()
    with serving(station, receive, station.address) as receiver:
        say(edge, send, station.address)
        receiver.wait(TIMEOUT_S)
    after = station.interface_bytes()
    assert after.rx_packets - before.rx_packets >= 1000, "no offloading: 1448 B of data a frame"
    assert after.rx_bytes - before.rx_bytes >= 1448000 + 1000 * (14 + 20 + 32)


def test_two_networks_at_once_do_not_meet(network, edge):
    with Network() as other:
        theirs = [other.add_host(name) for name in ("edge", "a", "b", "c")][-1]
        with serving(theirs, SERVER, theirs.address):
            assert say(other.hosts["edge"], CLIENT, theirs.address, 30, 3) == ["3"]
            assert say(edge, CLIENT, theirs.address, 0.3, 3) != ["3"]
    assert say(edge, CLIENT, "127.0.0.1", 5, 3) == ["ECONNREFUSED"], "the first network lives on"


def test_a_started_process_is_the_command_itself_with_default_signals_and_no_stray_descriptors(
    edge,
):
    code = "import os; print(os.getpid(), os.environ['COLOUR'])"
    pipe = {"stdout": subprocess.PIPE, "text": True}
    with edge.popen([*PYTHON, code], env={"COLOUR": "green"}, **pipe) as process:
        assert process.stdout.read().split() == [str(process.pid), "green"]
    _, ignored = edge.run(["grep", "SigIgn", "/proc/self/status"], TIMEOUT_S).stdout.split()
    # Python ignores these two for itself; what our own caller ignores is inherited, as it should be.
    for number in (signal.SIGPIPE, signal.SIGXFSZ):
        assert not int(ignored, 16) >> (number - 1) & 1, "a pipeline in a shell relies on SIGPIPE"
    listing = edge.run(["ls", "/proc/self/fd"], TIMEOUT_S).stdout.split()
    assert len(listing) == 4, "0, 1, 2 and the listing"


def test_a_command_that_cannot_run_is_said_so_and_one_that_takes_too_long_ends(edge):
    missing = edge.run(["no-such-program"], TIMEOUT_S)
    assert (missing.returncode, "no-such-program" in missing.stderr) == (127, True)
    with pytest.raises(subprocess.TimeoutExpired):
        edge.run(["sleep", "100"], 0.2)


def test_a_closed_network_starts_nothing_and_a_lost_hub_takes_the_hosts_along():
    with Network() as net:
        edge = net.add_host("edge")
    starts = (lambda: edge.popen(["true"]), lambda: net.add_host("late"))
    for use in (*starts, edge.interface_bytes):
        with pytest.raises(HostsError, match="closed"):
            use()
    with Network() as net, serving(net.add_host("edge"), SERVER, "127.0.0.1") as guest:
        net._running._process.kill()
        assert guest.wait(TIMEOUT_S) == -9
        with pytest.raises(HostsError, match="hub"):
            net.add_host("late")


def test_a_hub_that_gets_no_namespace_is_closed(monkeypatch):
    channel = Mock()
    channel.receive.side_effect = HostsError("no namespace")
    monkeypatch.setattr("sfglab.lab.hosts.network.Channel", lambda: channel)
    with pytest.raises(HostsUnavailableError, match="no namespace"), Network():
        pass
    channel.close.assert_called_once_with()


@pytest.mark.parametrize("given", [{"shared": False}, {"queue_rule": "block"}])
def test_a_radio_is_shared_and_makes_no_sender_wait(network, given):
    with pytest.raises(InvalidValueError, match="queue does not block"):
        network.set_radio(Medium(**given))


def interpreter(run) -> str:
    """Return a Python of our version with which the user who runs it may import the package, or skip."""
    system = f"python{sys.version_info.major}.{sys.version_info.minor}"
    for candidate in (sys.executable, shutil.which(system, path="/usr/local/bin:/usr/bin") or ""):
        with suppress(OSError):
            if run([candidate, "-c", "import sfglab"]).returncode == 0:
                return candidate
    pytest.skip("no interpreter of this version or no package that every user may read")


ROOTLESS = """
import os, sys
from sfglab.lab.hosts import Network
with Network() as net:
    edge, station = net.add_host("edge"), net.add_host("station")
    net.set_connected("station", connected=False)
    net.set_connected("station", connected=True)
    edge.run(["sh", "-c", "true"], 10, check=True)
    command = [sys.executable, "-I", "-S", "-c", sys.argv[1]]
    server = station.popen([*command[:-1], sys.argv[2], station.address], stdout=-1, text=True)
    assert server.stdout.readline() == "ready\\n"
    done = edge.run([*command, station.address, "9", "33"], 10)
    print(os.getuid(), net.how, done.stdout.strip(), done.stderr)
    server.stdout.close()
print("closed", server.returncode)
"""


def test_an_ordinary_user_gets_hosts_without_root():
    user = {"user": NOBODY, "group": NOBODY, "extra_groups": []} if os.getuid() == 0 else {}
    environment = {"PATH": os.environ["PATH"], "PYTHONPATH": os.pathsep.join(sys.path)}
    told = {"capture_output": True, "text": True, "check": False}
    run = partial(subprocess.run, cwd="/", env=environment, timeout=TIMEOUT_S, **told, **user)
    python, probe = interpreter(run), run(["unshare", "-Urn", "true"])
    if probe.returncode:
        pytest.skip(f"no user namespaces for ordinary users: {probe.stderr.strip()}")
    done = run([python, "-c", ROOTLESS, CLIENT, SERVER])
    uid = NOBODY if user else os.getuid()
    assert done.stdout.split() == [str(uid), "rootless", "33", "closed", "-15"], done.stderr
